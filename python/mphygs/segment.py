"""`python -m mphygs.segment`."""

import sys

from mphygs.commands.segment import main

if __name__ == "__main__":
    sys.exit(main())

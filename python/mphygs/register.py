"""`python -m mphygs.register`."""

import sys

from mphygs.commands.register import main

if __name__ == "__main__":
    sys.exit(main())

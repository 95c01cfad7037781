"""`python -m mphygs.init`."""

import sys

from mphygs.commands.init import main

if __name__ == "__main__":
    sys.exit(main())

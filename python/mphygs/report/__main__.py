"""`python -m mphygs.report`."""

import sys

from mphygs.commands.report import main

if __name__ == "__main__":
    sys.exit(main())

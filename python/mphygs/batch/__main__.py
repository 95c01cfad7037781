"""`python -m mphygs.batch`."""

import sys

from mphygs.commands.batch import main

if __name__ == "__main__":
    sys.exit(main())

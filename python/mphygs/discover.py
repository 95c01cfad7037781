"""`python -m mphygs.discover`."""

import sys

from mphygs.commands.discover import main

if __name__ == "__main__":
    sys.exit(main())

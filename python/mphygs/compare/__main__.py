"""`python -m mphygs.compare`."""

import sys

from mphygs.commands.compare import main

if __name__ == "__main__":
    sys.exit(main())

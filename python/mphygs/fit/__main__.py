"""`python -m mphygs.fit`."""

import sys

from mphygs.commands.fit import main

if __name__ == "__main__":
    sys.exit(main())

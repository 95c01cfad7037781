"""`python -m mphygs.extend`."""

import sys

from mphygs.commands.extend import main

if __name__ == "__main__":
    sys.exit(main())

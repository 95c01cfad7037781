"""`python -m mphygs.view`."""

import sys

from mphygs.commands.view import main

if __name__ == "__main__":
    sys.exit(main())

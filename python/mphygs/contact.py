"""`python -m mphygs.contact`."""

import sys

from mphygs.commands.contact import main

if __name__ == "__main__":
    sys.exit(main())

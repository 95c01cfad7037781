"""`python -m mphygs.reconstruct`."""

import sys

from mphygs.commands.reconstruct import main

if __name__ == "__main__":
    sys.exit(main())

"""`python -m mphygs.doctor`."""

import sys

from mphygs.commands.doctor import main

if __name__ == "__main__":
    sys.exit(main())

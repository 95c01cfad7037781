"""`python -m mphygs.predict`."""

import sys

from mphygs.commands.predict import main

if __name__ == "__main__":
    sys.exit(main())

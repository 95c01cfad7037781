"""`python -m mphygs.track`."""

import sys

from mphygs.commands.track import main

if __name__ == "__main__":
    sys.exit(main())

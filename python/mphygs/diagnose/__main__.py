"""`python -m mphygs.diagnose`."""

import sys

from mphygs.commands.diagnose import main

if __name__ == "__main__":
    sys.exit(main())

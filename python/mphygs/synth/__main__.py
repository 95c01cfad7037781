"""`python -m mphygs.synth`."""

import sys

from mphygs.commands.synth import main

if __name__ == "__main__":
    sys.exit(main())

"""`python -m mphygs.synth.flower`."""

import sys

from mphygs.commands.synth_flower import main

if __name__ == "__main__":
    sys.exit(main())

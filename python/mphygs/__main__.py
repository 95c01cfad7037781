"""`python -m mphygs COMMAND`, and `mphygs COMMAND` of an installed package."""

import sys

from mphygs.commands.command_table import main

if __name__ == "__main__":
    sys.exit(main())

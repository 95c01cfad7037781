"""Stands in for the compiled core in a portable wheel: importing it gives the variant for this processor."""

import sys

from mphygs._load_core import load

sys.modules[__name__] = load()

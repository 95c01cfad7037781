"""Captures with known truth: objects, motions, hidden effects, noise and faults of measurement."""

from mphygs.synth.embedded import embedded_capture
from mphygs.synth.make import Made, make_capture
from mphygs.synth.recipe import Recipe

__all__ = ["Made", "Recipe", "embedded_capture", "make_capture"]

"""Flowers: grown from a species and a seed, moved by a hand, recorded in pictures with their truth."""

from mphygs.synth.flower.catalogue import SPECIES
from mphygs.synth.flower.flower_capture import make_flower
from mphygs.synth.flower.growth import Flower, grow
from mphygs.synth.flower.recording_settings import Shoot
from mphygs.synth.flower.species import Species

__all__ = ["SPECIES", "Flower", "Shoot", "Species", "grow", "make_flower"]

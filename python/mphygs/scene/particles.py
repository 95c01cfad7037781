"""From part meshes to what the simulation needs of them at rest: one door to the files that do it."""

from mphygs.scene.quadrature import Quadrature, fill
from mphygs.scene.rays import inside

__all__ = ["Quadrature", "fill", "inside"]

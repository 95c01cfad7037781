"""From part meshes to what the simulation needs of them at rest: one door to the files that do it."""

from mphygs.scene.closest import MaterialAnchor, closest_material
from mphygs.scene.holding import HoldFace, hold_face
from mphygs.scene.quadrature import Quadrature, fill
from mphygs.scene.rays import inside

__all__ = ["HoldFace", "MaterialAnchor", "Quadrature", "closest_material", "fill", "hold_face", "inside"]

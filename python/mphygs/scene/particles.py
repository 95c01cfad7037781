"""From part meshes to what the simulation needs of them at rest: one door to the files that do it."""

from mphygs.scene.closest import MaterialAnchor, closest_material
from mphygs.scene.curved_quadrature import cell_count, chosen_shape, lay_chart, rods_doubled
from mphygs.scene.holding import HoldFace, hold_face
from mphygs.scene.joints import Joint, find_joints
from mphygs.scene.quadrature import Quadrature, fill, fill_each
from mphygs.scene.rays import inside
from mphygs.scene.surface import SurfaceSamples, exposed_surface

__all__ = [
    "HoldFace",
    "Joint",
    "MaterialAnchor",
    "Quadrature",
    "SurfaceSamples",
    "cell_count",
    "chosen_shape",
    "closest_material",
    "exposed_surface",
    "fill",
    "fill_each",
    "find_joints",
    "hold_face",
    "inside",
    "lay_chart",
    "rods_doubled",
]

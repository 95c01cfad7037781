"""Whether loads that are given frame by frame suit the object that they act on."""

from __future__ import annotations

import numpy as np

from mphygs.capture.actuators import Actuator, Force, Pressure, Tendon
from mphygs.capture.errors import fault
from mphygs.capture.material_checks import check_force, check_material, check_names, span
from mphygs.capture.overlap import box_meets_solid, triangles_in_box
from mphygs.capture.record import Capture

ON_OBJECT = 1e-3  # of the object's size: so far beside its material a point still stands on it


def check_actuators(where: str, capture: Capture, actuators: tuple[Actuator, ...]) -> None:
    """Raise CaptureError at the first one that cannot act. where: of the sequence."""
    check_names(f"{where}.loads", [actuator.name for actuator in actuators], dots=False)
    parts = [part.name for part in capture.parts]
    for actuator in actuators:
        at = f'{where}.loads "{actuator.name}"'
        if actuator.name in parts:
            raise fault(f"{at}.name", "is the name of a part", "a name of its own")
        if not parts:
            continue
        if isinstance(actuator, Force):
            check_material(f"{at}.box", capture, actuator.box)
            check_force(f"{at}.force", capture, float(np.linalg.norm(actuator.values, axis=1).max()))
        elif isinstance(actuator, Pressure):
            _check_patch(f"{at}.patch", capture, actuator)
        elif isinstance(actuator, Tendon):
            check_force(f"{at}.tension", capture, float(actuator.values.max()))
            _check_path(f"{at}.tendon", capture, actuator.path)


def _check_patch(where: str, capture: Capture, actuator: Pressure) -> None:
    parts = [part.name for part in capture.parts]
    if actuator.part is not None and actuator.part not in parts:
        raise fault(where, f'the object has no part "{actuator.part}"', f"one of {', '.join(parts)}")
    own = [part for part in capture.parts if actuator.part in (None, part.name)]
    box = actuator.box
    if box is not None and not any(triangles_in_box(p.vertices[p.faces], box).any() for p in own):
        raise fault(where, "no surface of the object lies in its box", f"some of {span(capture)}")


def _check_path(where: str, capture: Capture, path: np.ndarray) -> None:
    reach = ON_OBJECT * (capture.diagonal or 0.0)
    for index, point in enumerate(path):
        box = point + np.array([[-reach], [reach]])
        if not any(box_meets_solid(box, part.vertices, part.faces) for part in capture.parts):
            raise fault(
                f"{where}[{index}]",
                f"({', '.join(f'{x:.4g}' for x in point)}) lies outside the object",
                f'points in the material of {span(capture)}, or one outside as "anchor"',
            )

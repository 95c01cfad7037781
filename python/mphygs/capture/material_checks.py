"""What names, places and forces of a capture have to be, wherever they stand in it."""

from __future__ import annotations

import re

import numpy as np

from mphygs.capture.errors import fault
from mphygs.capture.holds import Load
from mphygs.capture.overlap import box_meets_solid
from mphygs.capture.record import Capture

LONGEST_NAME = 100  # bytes, of a part, a sequence or a load
ACCELERATION = 1e5  # [m/s^2], by a load
_USUAL_DENSITY = 1000.0  # [kg/m^3]


def check_names(where: str, names: list[str], *, dots: bool) -> None:
    """Names are keys of results, options and file names. A dot would split "<part>.<parameter>"."""
    inner = r"[\w .+-]" if dots else r"[\w +-]"
    for index, name in enumerate(names):
        if not re.fullmatch(rf"\w(?:{inner}*\w)?", name):
            marks = '"_", "-", "+"' + (', "."' if dots else "")
            raise fault(
                f"{where}[{index}].name",
                f'is "{name}"',
                f"letters, digits and, between them, {marks} or spaces",
            )
        if len(name.encode()) > LONGEST_NAME:
            raise fault(
                f"{where}[{index}].name", f'is "{name}"', f"at most {LONGEST_NAME} bytes: files are named so"
            )
        if name in names[:index]:
            raise fault(f"{where}[{index}].name", f'"{name}" is given twice', "every name once")


def check_material(where: str, capture: Capture, box: np.ndarray) -> None:
    if not capture.parts:
        return
    if not any(box_meets_solid(box, part.vertices, part.faces) for part in capture.parts):
        raise fault(where, "no material of the object lies in it", f"a box [m] that meets {span(capture)}")


def check_load(where: str, capture: Capture, load: Load) -> None:
    """A force that would throw the object out of sight is none in N."""
    if not capture.parts:
        return
    check_force(where, capture, float(np.linalg.norm(load.force)))


def check_force(where: str, capture: Capture, force: float) -> None:
    known = capture.known
    mass = known.mass or sum(known.density.get(p.name, _USUAL_DENSITY) * p.volume for p in capture.parts)
    if force > ACCELERATION * mass:
        raise fault(
            where,
            f"{force:.3g} N on an object of about {mass:.2g} kg, {force / mass / 9.81:.2g} times its weight",
            f"at most {ACCELERATION * mass:.2g} N (is it in N?)",
        )


def span(capture: Capture) -> str:
    """The object's bounding box in words."""
    bounds = capture.bounds
    assert bounds is not None
    low, high = (", ".join(f"{value:.4g}" for value in corner) for corner in bounds)
    return f"the object, which spans ({low}) to ({high}) m"

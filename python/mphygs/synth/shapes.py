"""Objects of closed convex prisms or of blocks that touch exactly where they meet; all objects by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from mphygs.capture.meshes import Part
from mphygs.synth.prisms import blocks, polygon, prism, rectangle
from mphygs.synth.shape import Shape
from mphygs.synth.thin_shapes import branched_cable, cable, strip, thin_flower


def leaf_polygon(
    root: float, length: float, half_width: float, root_half_width: float, side: int
) -> np.ndarray:
    """(7, 2) outline in x and y of a leaf that starts at x = side * root and points along x [m]."""
    along = root + length * np.array([0.0, 0.35, 0.75, 1.0, 0.75, 0.35, 0.0])
    across = np.array(
        [-root_half_width, -half_width, -0.7 * half_width, 0.0, 0.7 * half_width, half_width, root_half_width]
    )
    outline = np.stack([side * along, across], axis=1)
    return outline if side > 0 else outline[::-1]


def bar(*, length: float = 0.09, width: float = 0.018, height: float = 0.02) -> Shape:
    """A bar along x, held at its lower end."""
    part = prism("bar", rectangle(width, height), 0, 0.0, length)
    return _along_x("bar", (part,), length, width, height, {"bar": 1.1e5}, {"bar": 550.0})


def two_part_bar(
    *, length: float = 0.09, width: float = 0.018, height: float = 0.02, split: float = 0.55
) -> Shape:
    """A bar along x of two materials, held in the stiffer; split: share of the length where they meet."""
    middle = split * length
    parts = (
        prism("lower", rectangle(width, height), 0, 0.0, middle),
        prism("upper", rectangle(width, height), 0, middle, length),
    )
    return _along_x(
        "two-part-bar",
        parts,
        length,
        width,
        height,
        {"lower": 1.4e5, "upper": 9e4},
        {"lower": 600.0, "upper": 500.0},
    )


def _along_x(
    name: str,
    parts: tuple[Part, ...],
    length: float,
    width: float,
    height: float,
    youngs_modulus: Mapping[str, float],
    density: Mapping[str, float],
) -> Shape:
    gap = 1e-3
    return Shape(
        name=name,
        parts=parts,
        hold=np.array(
            [[-gap, -width / 2 - gap, -height / 2 - gap], [0.08 * length, width / 2 + gap, height / 2 + gap]]
        ),
        pivot=np.zeros(3),
        axis=np.array([1.0, 0.0, 0.0]),
        tip=np.array([0.97 * length, 0.0, 0.0]),
        gravity=np.array([0.0, 0.0, -9.81]),
        rest="stress-free",
        youngs_modulus=youngs_modulus,
        density=density,
    )


def flower(
    *,
    stem: float = 0.006,
    height: float = 0.075,
    head: float = 0.016,
    head_height: float = 0.014,
    leaf_length: float = 0.036,
    leaf_half_width: float = 0.010,
    leaf_thickness: float = 0.005,
) -> Shape:
    """An upright flower on z: stem (apothem `stem`), head, two leaves; its rest shape carries its weight."""
    flat = stem * np.tan(np.pi / 8.0)  # half a side of the octagon: a leaf's root lies wholly on it
    parts = [
        prism("stem", polygon(stem, 8), 2, 0.0, height),
        prism("head", polygon(head, 8), 2, height, height + head_height),
    ]
    for name, side, level in (("leaf1", 1, 0.45 * height), ("leaf2", -1, 0.65 * height)):
        outline = leaf_polygon(stem, leaf_length, leaf_half_width, flat, side)
        parts.append(prism(name, outline, 2, level, level + leaf_thickness))
    gap = 1e-3
    return Shape(
        name="flower",
        parts=tuple(parts),
        hold=np.array([[-2 * stem, -2 * stem, -gap], [2 * stem, 2 * stem, 0.08 * height]]),
        pivot=np.zeros(3),
        axis=np.array([0.0, 0.0, 1.0]),
        tip=np.array([0.0, 0.0, height + 0.9 * head_height]),
        gravity=np.array([0.0, 0.0, -9.81]),
        rest="equilibrium",
        youngs_modulus={"stem": 3.2e5, "head": 6e4, "leaf1": 1.2e5, "leaf2": 9e4},
        density={"stem": 400.0, "head": 300.0, "leaf1": 300.0, "leaf2": 280.0},
    )


def hanging_flower(*, leaf_length: float = 0.045, leaf_half_width: float = 0.014, **sizes: float) -> Shape:
    """The flower hanging from its hold (gravity points from the hold to the head), with broad leaves."""
    upright = flower(leaf_length=leaf_length, leaf_half_width=leaf_half_width, **sizes)
    values = {**upright.__dict__, "name": "hanging-flower", "gravity": -upright.gravity}
    return Shape(**values)


def block_flower(
    *, cell: float = 0.006, height: int = 12, head: int = 3, leaf: int = 7, levels: tuple[int, int] = (5, 8)
) -> Shape:
    """An upright flower on z of cubes, which bricks of finite elements fill exactly; rest as of `flower`.

    cell: size of a cube [m]; in cells: height of the stem, half the width of the head, length of a leaf, and
    the levels of the two leaves.
    """

    def box(x: range, y: range, z: range) -> np.ndarray:
        return np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)

    ball = box(range(-head, head), range(-head, head), range(height, height + 4))
    level = (ball[:, 2] + 0.5 - height - 2.0) / 2.6
    ball = ball[((ball[:, :2] + 0.5) ** 2).sum(1) / (head + 0.2) ** 2 + level**2 < 1.0]
    cells = {"stem": box(range(-1, 1), range(-1, 1), range(height)), "head": ball}
    for name, sign, at in (("leaf1", 1, levels[0]), ("leaf2", -1, levels[1])):
        own = box(range(1, 1 + leaf), range(-2, 2), range(at, at + 1))
        tapered = (own[:, 0] > 1) & (own[:, 0] < leaf)
        own = own[tapered | (np.abs(own[:, 1] + 0.5) < 1.0)]
        if sign < 0:
            own[:, 0] = -1 - own[:, 0]
        cells[name] = own
    low, high = -(2 + leaf) * cell, (2 + leaf) * cell
    return Shape(
        name="block-flower",
        parts=tuple(blocks(name, own, cell, np.zeros(3)) for name, own in cells.items()),
        hold=np.array([[low, low, -1e-3], [high, high, cell]]),
        pivot=np.zeros(3),
        axis=np.array([0.0, 0.0, 1.0]),
        tip=np.array([0.0, 0.0, (height + 3.5) * cell]),
        gravity=np.array([0.0, 0.0, -9.81]),
        rest="equilibrium",
        youngs_modulus={"stem": 3.2e5, "head": 6e4, "leaf1": 6e4, "leaf2": 5e4},
        density={"stem": 400.0, "head": 300.0, "leaf1": 300.0, "leaf2": 280.0},
    )


def hanging_block_flower(**sizes: object) -> Shape:
    """The block flower hanging from its hold."""
    upright = block_flower(**sizes)
    return Shape(**{**upright.__dict__, "name": "hanging-block-flower", "gravity": -upright.gravity})


SHAPES: Mapping[str, Callable[..., Shape]] = {
    "bar": bar,
    "two-part-bar": two_part_bar,
    "flower": flower,
    "hanging-flower": hanging_flower,
    "block-flower": block_flower,
    "hanging-block-flower": hanging_block_flower,
    "cable": cable,
    "branched-cable": branched_cable,
    "strip": strip,
    "thin-flower": thin_flower,
}


def shape(name: str, **sizes: float) -> Shape:
    """The object called `name`; sizes [m]. Raises ValueError for names that there are not."""
    if name not in SHAPES:
        raise ValueError(f"object '{name}': expected one of {', '.join(SHAPES)}")
    try:
        return SHAPES[name](**sizes)
    except TypeError as error:
        raise ValueError(f"object '{name}': {error}") from error

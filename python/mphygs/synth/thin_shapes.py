"""Cables, strips and a flower at true stiffness and thickness.

A cable hangs as a U between two hands; a branched one forks below the first hand at a stiff block, one branch
to the second hand and one free. A flower has a stem of 3 mm and petals of 0.25 mm.
"""

from __future__ import annotations

import numpy as np

from mphygs.capture.meshes import Part
from mphygs.synth.prisms import polygon, prism, rectangle
from mphygs.synth.rod_net import Line
from mphygs.synth.rod_section import regular_polygon
from mphygs.synth.shape import Shape
from mphygs.synth.shell_sheet import Sheet

SIDES = 24
# Between rings of a cable's mesh, in its radii; length of cable in a hand [m].
RINGS, GRIPPED = 1.0, 0.01
GRAVITY = np.array([0.0, 0.0, -9.81])


def tube_mesh(
    line: np.ndarray, radius: float, sides: int = SIDES, tangent: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a closed round rod along a curve.

    line: (n, 3) in a plane square to y [m]; tangent: (n, 3), where it is not as of the line alone.
    """
    tangent = np.gradient(line, axis=0) if tangent is None else tangent.copy()
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    across = np.array([0.0, 1.0, 0.0])
    up = np.cross(tangent, across)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * up[:, None]
    vertices = np.concatenate([(line[:, None] + radius * ring).reshape(-1, 3), line[[0, -1]]])
    count, faces = len(line), []
    for i in range(count - 1):
        for j in range(sides):
            a, b = i * sides + j, i * sides + (j + 1) % sides
            faces += [[a, b, a + sides], [b, b + sides, a + sides]]
    for j in range(sides):
        last, ahead = (count - 1) * sides, (j + 1) % sides
        faces += [[count * sides, ahead, j], [count * sides + 1, last + j, last + ahead]]
    return vertices, np.array(faces, dtype=np.int64)


def sheet_mesh(place: np.ndarray, thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a closed sheet about its middle. place: (a, b, 3) [m]; thickness [m]."""
    normal = np.cross(np.gradient(place, axis=0), np.gradient(place, axis=1))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    shape, count = place.shape[:2], place.shape[0] * place.shape[1]
    middle, step = place.reshape(-1, 3), 0.5 * thickness * normal.reshape(-1, 3)
    number = np.arange(count).reshape(shape)
    a, b, c, d = (x.ravel() for x in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    top = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    ahead = np.roll(rim, -1)
    corner = (rim, rim + count, ahead + count, ahead)
    side = np.concatenate([np.stack([corner[0], corner[k], corner[k + 1]], axis=1) for k in (1, 2)])
    faces = np.concatenate([top, top[:, ::-1] + count, side])
    return np.concatenate([middle + step, middle - step]), faces.astype(np.int64)


def cable(*, radius: float = 0.002, bend: float = 0.08, leg: float = 0.02, split: float = 0.5) -> Shape:
    """A cable of two materials that hangs as a U between two hands.

    bend: radius of the U, leg: straight length below either hand [m]; split: share of the free length that is
    of the first material.
    """
    free = 2.0 * leg + np.pi * bend
    along = _stations(0.0, free, radius) - leg
    turn = np.clip(along / bend, 0.0, np.pi)
    beyond = np.maximum(along - np.pi * bend, 0.0)
    x = bend * (1.0 - np.cos(turn))
    z = -leg - np.minimum(along, 0.0) - bend * np.sin(turn) + beyond
    line = np.stack([x, np.zeros_like(x), z], axis=1)
    middle = int(np.argmin(np.abs(along + leg - split * free)))
    line = np.concatenate([[[0.0, 0.0, GRIPPED]], line, [[2.0 * bend, 0.0, GRIPPED]]])
    tangent = np.gradient(line, axis=0)
    ranges = slice(0, middle + 2), slice(middle + 1, None)
    section = regular_polygon(radius, SIDES)
    return Shape(
        name="cable",
        parts=tuple(
            Part(f"cable{k + 1}", *tube_mesh(line[own], radius, tangent=tangent[own]), shape="rod")
            for k, own in enumerate(ranges)
        ),
        hold=_hand(np.zeros(3), radius),
        pivot=np.zeros(3),
        axis=np.array([0.0, 0.0, -1.0]),
        tip=line[middle + 1],
        gravity=GRAVITY,
        rest="stress-free",
        youngs_modulus={"cable1": 3e7, "cable2": 1.2e7},
        density={"cable1": 1200.0, "cable2": 1100.0},
        far_hold=_hand(np.array([2.0 * bend, 0.0, 0.0]), radius),
        far_pivot=np.array([2.0 * bend, 0.0, 0.0]),
        lines=tuple(Line(k, line[own], section) for k, own in enumerate(ranges)),
        simulator="rod",
    )


def branched_cable(
    *, radius: float = 0.002, bend: float = 0.04, leg: float = 0.05, size: float = 0.01
) -> Shape:
    """A cable that forks at a block: trunk from the first hand, one branch to the second, one hanging free.

    size: of the block, a cube [m]; leg: of the trunk and of the free branch, bend: radius of the other [m].
    """
    half = 0.5 * size
    middle = np.array([0.0, 0.0, -leg - half])
    down = _stations(0.0, leg, radius)
    trunk = np.stack([0.0 * down, 0.0 * down, -down], axis=1)
    trunk = np.concatenate([[[0.0, 0.0, GRIPPED]], trunk])
    loose = np.stack([0.0 * down, 0.0 * down, -leg - size - down], axis=1)
    quarter = _stations(0.0, 0.5 * np.pi * bend, radius) / bend
    turned = np.stack(
        [half + bend * np.sin(quarter), 0.0 * quarter, middle[2] + bend * (1.0 - np.cos(quarter))], axis=1
    )
    rise = -turned[-1, 2]
    up = _stations(0.0, rise, radius)[1:]
    ends = np.stack([np.full(len(up), half + bend), 0.0 * up, turned[-1, 2] + up], axis=1)
    branch = np.concatenate([turned, ends, [[half + bend, 0.0, GRIPPED]]])
    block = prism("block", rectangle(size, size), 2, -leg - size, -leg)
    section = regular_polygon(radius, SIDES)
    pieces = {"trunk": trunk, "branch": branch, "loose": loose}
    # The block's arms share its mass out; they are so thick that it is as good as rigid.
    arm = regular_polygon(size / np.sqrt(1.5 * np.pi), 64)
    arms = [np.stack([middle, end]) for end in (trunk[-1], branch[0], loose[0])]
    return Shape(
        name="branched-cable",
        parts=(*(_tube(name, line, radius) for name, line in pieces.items()), block),
        hold=_hand(np.zeros(3), radius),
        pivot=np.zeros(3),
        axis=np.array([0.0, 0.0, -1.0]),
        tip=loose[-2],
        gravity=GRAVITY,
        rest="stress-free",
        youngs_modulus={"trunk": 3e7, "branch": 1.2e7, "loose": 1.2e7, "block": 3e8},
        density={"trunk": 1200.0, "branch": 1100.0, "loose": 1100.0, "block": 1000.0},
        far_hold=_hand(np.array([half + bend, 0.0, 0.0]), radius),
        far_pivot=np.array([half + bend, 0.0, 0.0]),
        lines=(*(Line(k, line, section) for k, line in enumerate(pieces.values())),
               *(Line(3, line, arm) for line in arms)),
        simulator="rod",
    )  # fmt: skip


def strip(
    *, length: float = 0.08, width: float = 0.016, thickness: float = 4e-4, held: float = 0.01
) -> Shape:
    """A flat strip along x, gripped at its lower end. thickness [m]."""
    step = 0.5 * width / 4.0
    x = np.r_[-held, _stations(0.0, length, step)]
    y = np.linspace(-0.5 * width, 0.5 * width, 9)
    place = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((len(x), len(y)))], axis=2)
    gap = 1e-3
    return Shape(
        name="strip",
        parts=(Part("strip", *sheet_mesh(place, thickness), shape="shell"),),
        hold=np.array([[-held - gap, -0.5 * width - gap, -gap], [0.0, 0.5 * width + gap, gap]]),
        pivot=np.zeros(3),
        axis=np.array([1.0, 0.0, 0.0]),
        tip=np.array([length - step, 0.0, 0.0]),
        gravity=GRAVITY,
        rest="stress-free",
        youngs_modulus={"strip": 1e8},
        density={"strip": 1000.0},
        sheet=Sheet(place[1:], thickness),
        simulator="shell",
    )


def petal_places(length: float, width: float, curl: float, cup: float) -> np.ndarray:
    """(33, 21, 3) [m] of the middle of a pointed sheet from x = 0, curled up along x and cupped [1/m]."""
    u, w = np.linspace(0, 1, 33), np.linspace(-1, 1, 21)
    half = width / 2 * (0.25 + 0.75 * np.sin(np.pi * (0.9 * u + 0.05)) ** 0.7)
    s, y = np.meshgrid(u * length, w, indexing="ij")
    y = y * half[:, None]
    return np.stack([np.sin(s * curl) / curl, y, (1 - np.cos(s * curl)) / curl + cup * y**2 / 2], axis=2)


def thin_flower(
    *,
    petals: int = 6,
    radius: float = 0.0015,
    thickness: float = 2.5e-4,
    stem: float = 0.1,
    head: float = 0.006,
    grown: float = 0.5,
) -> Shape:
    """An upright flower on z that carries its weight: a stem as a rod, a head, petals as shells.

    radius: of the stem, head: half width and height of the head [m]; grown: how far petals reach into the
    head, of its half width: at 0.1 they are fastened over 5 mm, at 0.5 over 10 mm.
    """
    line = np.linspace(-GRIPPED, stem, 56)
    line = np.stack([0.0 * line, 0.0 * line, line], axis=1)
    parts = [_tube("stem", line, radius, 16), prism("head", polygon(head, 16), 2, stem, stem + head)]
    vertices, faces = sheet_mesh(petal_places(0.035, 0.02, 15.0, 15.0), thickness)
    for k in range(petals):
        c, s = np.cos(2.0 * np.pi * k / petals), np.sin(2.0 * np.pi * k / petals)
        place = vertices + [(1.0 - grown) * head, 0.0, stem + 0.5 * head]
        turned = place @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        parts.append(Part(f"petal{k + 1}", turned, faces, shape="shell"))
    names = [part.name for part in parts[2:]]
    return Shape(
        name="thin-flower",
        parts=tuple(parts),
        hold=np.array([[-0.01, -0.01, -GRIPPED - 1e-3], [0.01, 0.01, 0.0]]),
        pivot=np.zeros(3),
        axis=np.array([0.0, 0.0, 1.0]),
        tip=np.array([0.0, 0.0, stem + 0.9 * head]),
        gravity=GRAVITY,
        rest="equilibrium",
        youngs_modulus={"stem": 3e8, "head": 1e7} | dict.fromkeys(names, 5e6),
        density={"stem": 800.0, "head": 400.0} | dict.fromkeys(names, 800.0),
    )


def _stations(begin: float, end: float, radius: float) -> np.ndarray:
    """Evenly from begin to end [m], as far apart as rings of a cable's mesh are."""
    return np.linspace(begin, end, int(np.ceil((end - begin) / (RINGS * radius))) + 1)


def _tube(name: str, line: np.ndarray, radius: float, sides: int = SIDES) -> Part:
    return Part(name, *tube_mesh(line, radius, sides), shape="rod")


def _hand(at: np.ndarray, radius: float) -> np.ndarray:
    """The box (2, 3) [m] of a hand that grips what is above a place (3,)."""
    wide = 2.0 * radius
    return at + np.array([[-wide, -wide, 0.0], [wide, wide, GRIPPED + 1e-3]])

"""The parts of an object: closed surface meshes in metres, outward, each bounding a positive volume."""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path

import numpy as np
import trimesh

from mphygs.capture.document import Entry
from mphygs.capture.errors import fault
from mphygs.capture.files import file_inside
from mphygs.capture.overlap import just_inside, winding_number
from mphygs.capture.sheets import read_sheet
from mphygs.capture.triangles import directed_edges, loaded, merge, numbered
from mphygs.capture.written import replace_file

# What a part may be simulated as, as files state it.
_SHAPES = ("solid", "shell", "rod", "auto")
_THIN = ("shell", "rod")
_MOST_BODIES = 500
_PROBED = 20  # corners of a body that are looked at
# Of the whole volume, that bodies may share: where they are stuck into one another a little.
_SHARED = 0.02
# Points in the unit box, evenly spread (Roberts 2018).
_SPREAD = (0.5 + np.outer(np.arange(400), [0.8191725134, 0.6710436067, 0.5497004779])) % 1.0


@dataclass(frozen=True, eq=False)
class Part:
    """One visible part of the object.

    vertices: (V, 3) float64 [m], merged; faces: (F, 3) int64, closed, outward, volume above zero; boundary:
    standard deviation of where all of its surface lies along its normal [m], 0 where the mesh is given;
    shape: what it is simulated as, "solid", "rod", "shell" or "auto"; thickness_std: of a rod or a shell, how
    far its thickness may be from the mesh's, one standard deviation [m], 0 where it is known.
    Raises ValueError for another shape, and for a thickness_std of what is neither a rod nor a shell.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    boundary: float = 0.0
    shape: str = "solid"
    thickness_std: float = 0.0

    def __post_init__(self) -> None:
        if self.shape not in _SHAPES:
            expected = ", ".join(_SHAPES)
            raise ValueError(f"part '{self.name}': shape is {self.shape!r}; expected one of {expected}")
        unsure = self.thickness_std
        if not (isinstance(unsure, Real) and 0.0 <= unsure < np.inf):
            raise ValueError(f"part '{self.name}': thickness_std is {unsure!r}; expected a length [m]")
        if unsure > 0.0 and self.shape not in _THIN:
            what = f"thickness_std is {unsure:g} m, of a part that is \"{self.shape}\""
            raise ValueError(f"part '{self.name}': {what}; expected a rod or a shell")

    @property
    def area(self) -> float:
        """Of the surface [m^2]."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())

    @property
    def volume(self) -> float:
        """Enclosed volume [m^3]."""
        return enclosed_volume(self.vertices, self.faces)

    @property
    def bounds(self) -> np.ndarray:
        """Lower and upper corner, (2, 3) [m]."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])


def read_part(folder: Path, entry: Entry) -> Part:
    """The part that an element of `object.parts` describes: `name`, `mesh`, `scale` (1 when absent), `as`
    ("solid" when absent), `thickness` [m] where the mesh is the middle surface of a sheet, `thickness_std`
    [m] of what is a rod or a shell."""
    entry.check_keys(required=("name", "mesh"), optional=("scale", "as", "thickness", "thickness_std"))
    name = entry["name"].name()
    shape = given.choice(_SHAPES) if (given := entry.get("as")) else "solid"
    scale = 1.0
    if given := entry.get("scale"):
        scale = given.within(1e-12, 1e12, "a number above zero (file unit -> metre)")
    path = file_inside(folder, entry["mesh"])
    if thickness := entry.get("thickness"):
        if shape == "rod":
            raise thickness.fault("a rod's mesh is closed", '"as": "shell" or "auto" beside it')
        thick = thickness.within(1e-7, 1.0, "a length above zero [m]")
        vertices, faces = read_sheet(path, thick / scale)
        part = Part(name, vertices * scale, faces, shape=shape if entry.get("as") else "shell")
        # Of a sheet w wide and t thick twice the volume over the area is w t / (w + t).
        if 4.0 * part.volume < thick * part.area:
            wide = 2.0 * part.volume / (part.area - 2.0 * part.volume / thick)
            what = f"is {thick:g} m, of a sheet that is {wide:.2g} m wide"
            raise thickness.fault(what, "less than its width (is it in m?)")
    else:
        vertices, faces = read_mesh(path)
        part = Part(name, vertices * scale, faces, shape=shape)
    if std := entry.get("thickness_std"):
        if part.shape not in _THIN:
            raise std.fault(f'the part is "as": "{part.shape}"', '"as": "rod" or "shell" beside it')
        part = replace(part, thickness_std=std.within(0.0, 1.0, "a length, zero or more [m]"))
    return part


def read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) [file unit] and faces (F, 3) of a mesh file, closed and outward.

    Raises CaptureError when the file cannot be read, is not finite, or is not a closed surface.
    """
    expected = "a closed triangle mesh that trimesh reads (.ply, .stl, .obj, .off, ...)"
    vertices, faces = loaded(path, expected)
    if not is_closed(faces):
        vertices, faces = merge(vertices, faces)
    if not is_closed(faces):
        faces = _wind(path, vertices, faces)
    _check_twice(path, vertices, faces)
    faces = _turn_outward(path, vertices, faces)
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if not enclosed_volume(vertices, faces) > 1e-9 * size**3:
        raise fault(str(path), "encloses no volume", expected)
    return vertices, faces


def write_mesh(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write a binary .ply that keeps vertices (V, 3) as float64; `faces`: (F, 3)."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), dtype=[("count", "u1"), ("index", "<i4", (3,))])
    rows["count"] = 3
    rows["index"] = faces
    replace_file(path, header.encode("ascii") + vertices.astype("<f8").tobytes() + rows.tobytes())


def is_closed(faces: np.ndarray) -> bool:
    """Whether every edge is walked as often one way as the other: no boundary, one winding.

    Edges shared by four faces, as where two voxels touch along one, are allowed.
    """
    edges = directed_edges(faces)
    _, index = np.unique(numbered(np.sort(edges, axis=1)), return_inverse=True)
    return not np.bincount(index, weights=np.where(edges[:, 0] < edges[:, 1], 1, -1)).any()


def _same_rows(rows: np.ndarray) -> np.ndarray:
    """(N,) counted from 0, the same for rows (N, 3), below 2^31, that are the same."""
    pairs = np.unique(numbered(rows[:, :2]), return_inverse=True)[1]
    return np.unique(numbered(np.stack([pairs, rows[:, 2]], axis=1)), return_inverse=True)[1]


def _wind(path: Path, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The faces turned to one winding; CaptureError when the surface has a boundary."""
    numbers, count = np.unique(numbered(np.sort(directed_edges(faces), axis=1)), return_counts=True)
    open_edges = np.stack([numbers >> 31, numbers & (1 << 31) - 1], axis=1)[count % 2 == 1]
    expected = "a closed surface, every edge shared by two faces"
    if len(open_edges):
        at = ", ".join(f"{x:.4g}" for x in vertices[open_edges[0]].mean(axis=0))
        raise fault(str(path), f"is not closed: {len(open_edges)} open edges, one at ({at})", expected)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    trimesh.repair.fix_winding(mesh)
    faces = np.array(mesh.faces, dtype=np.int64)
    if not is_closed(faces):
        raise fault(str(path), "has no inside and outside: its faces cannot be wound alike", expected)
    return faces


def _check_twice(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Raises CaptureError where triangles stand there twice, wound alike: what they enclose counts twice.

    Triangles that are no wider than corners are told apart by enclose nothing, however often.
    """
    step = 1e-6 * max(float(np.ptp(vertices, axis=0).max()), 1e-300)
    corners = _same_rows(np.round((vertices - vertices.min(axis=0)) / step).astype(np.int64))[faces]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    # the smallest corner first, the order kept: one that is wound the other way is another triangle
    first = np.argmin(corners, axis=1)
    turned = np.take_along_axis(corners, (first[:, None] + np.arange(3)) % 3, axis=1)
    count = np.bincount(_same_rows(turned))
    twice = int((count > 1).sum())
    if twice:
        what = f"{twice} of its {len(faces)} triangles stand there twice"
        raise fault(str(path), f"{what}, so that a body's volume counts double", "every body once")


def _turn_outward(path: Path, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The faces with every body that encloses material turned outward; cavities stay inward.

    Raises CaptureError for a body inside another that is turned outward as well, and for too many bodies.
    """
    if enclosed_volume(vertices, faces) < 0:
        faces = faces[:, ::-1]
    label = trimesh.graph.connected_component_labels(directed_edges(faces), node_count=len(vertices))[
        faces[:, 0]
    ]
    bodies = np.unique(label)
    if len(bodies) > _MOST_BODIES:
        raise fault(str(path), f"holds {len(bodies)} separate bodies", f"at most {_MOST_BODIES} in a part")
    for number, body in enumerate(bodies):
        own = label == body
        if len(bodies) == 1:
            break
        corners = np.unique(faces[own])
        some = corners[:: max(1, len(corners) // _PROBED)]
        inside = np.abs(winding_number(vertices[some], vertices, faces[~own])) > 0.5
        if enclosed_volume(vertices, faces[own]) < 0:
            if not inside[0]:
                faces = np.where(own[:, None], faces[:, ::-1], faces)
        elif inside.all():
            at = ", ".join(f"{x:.4g}" for x in vertices[corners].mean(axis=0))
            what = f"body {number + 1} of {len(bodies)}, about ({at}), is turned outward inside another one"
            raise fault(str(path), what, "a cavity's wall turned inward, every piece of material once")
    _check_overlap(path, vertices, [faces[label == body] for body in bodies])
    return np.ascontiguousarray(faces)


def _check_overlap(path: Path, vertices: np.ndarray, bodies: list[np.ndarray]) -> None:
    """Raises CaptureError where bodies (F, 3) of faces share so much of their volume that it counts double,
    or one goes round its own volume twice."""
    expected = "every piece of material once (unite the bodies, or make them parts)"
    for body in bodies:
        winding = winding_number(just_inside(vertices, body), vertices, body)
        if len(winding) and np.median(winding) > 1.5:
            what = f"goes {np.median(winding):.0f} times round its volume, so that it counts as often"
            raise fault(str(path), what, expected)
    boxes = np.array([[vertices[body].min(axis=(0, 1)), vertices[body].max(axis=(0, 1))] for body in bodies])
    shared = {}
    for k, body in enumerate(bodies):
        low, high = np.maximum(boxes[:, 0], boxes[k, 0]), np.minimum(boxes[:, 1], boxes[k, 1])
        near = (high > low).all(axis=1)
        near[k] = False
        if not near.any() or enclosed_volume(vertices, body) < 0:
            continue
        low, high = low[near].min(axis=0), high[near].max(axis=0)
        points = low + (high - low) * _SPREAD
        own = winding_number(points, vertices, body) > 0.5
        others = np.concatenate([bodies[other] for other in np.flatnonzero(near)])
        twice = winding_number(points[own], vertices, others) > 0.5
        shared[k] = float(np.prod(high - low)) * np.count_nonzero(twice) / len(points)
    whole = sum(enclosed_volume(vertices, body) for body in bodies)
    # what two bodies share was found in both
    if 0.5 * sum(shared.values()) <= _SHARED * whole:
        return
    shares = {k: min(volume / enclosed_volume(vertices, bodies[k]), 1.0) for k, volume in shared.items()}
    worst = max(shares, key=shares.__getitem__)
    at = ", ".join(f"{x:.4g}" for x in boxes[worst].mean(axis=0))
    body = f"body {worst + 1} of {len(bodies)}, about ({at})"
    what = f"{body}, overlaps others with {shares[worst]:.0%} of its volume"
    raise fault(str(path), what, expected)


def enclosed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Of a closed mesh with outward faces [m^3], by the divergence theorem about its own centre, which keeps
    digits."""
    a, b, c = np.moveaxis(vertices[faces] - vertices.mean(axis=0), 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)

"""Thin parts on curved grids: which are thin, the grids laid along them, and their quadrature points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from mphygs.capture.meshes import Part
from mphygs.scene.cell_blocks import CORNERS, SMALLEST, CellBlocks, Grid, fitting, moments, spread
from mphygs.scene.columns import Segments, cut_axis, split_columns
from mphygs.scene.curved_charts import Chart
from mphygs.scene.fastenings import Grading, middle_surface_of
from mphygs.scene.finer_meshes import finer
from mphygs.scene.middle_surface import MiddleSurface, chords
from mphygs.scene.rays import inside
from mphygs.scene.rod_chart import centre_line, rod_chart
from mphygs.scene.shell_chart import shell_chart

if TYPE_CHECKING:
    from mphygs.scene.quadrature import Quadrature

# Columns to a cell that it spans alone, and pieces that a column is tested in for being held.
_ACROSS, _PIECES = 64, 8
# A part that reaches this many times as far from its chart's middle as half its thickness is lost to it.
_FURTHEST = 2.0
# Strain of compression up to which patterns that alternate from node to node do not buckle.
_UNBUCKLED = 0.1
# Eighth of a turn about a cell's first axis.
_TURN = np.array([[1.0, 0.0, 0.0], [0.0, np.sqrt(0.5), np.sqrt(0.5)], [0.0, -np.sqrt(0.5), np.sqrt(0.5)]])
# Of a cell: a hold's face that lies so evenly along a cell's boundary is made one.
_EVEN = 0.25


def chosen_shape(part: Part, spacing: float) -> tuple[str, str]:
    """What a part that says "auto" is simulated as, and why, in words.

    A cell is made to fit material down to `SMALLEST` of the spacing. What is thinner than that one way is a
    shell, what is thinner than two cells the other way as well a rod; what cannot be one is a solid still.
    """
    shape, why = _by_size(part, spacing)
    if part.shape != "auto" or shape == "solid":
        return shape, why
    unfit = _unfit(part, shape, spacing)
    return (shape, why) if unfit is None else ("solid", f"{why}; but {unfit}")


def _by_size(part: Part, spacing: float) -> tuple[str, str]:
    if part.shape != "auto":
        return part.shape, "as its capture says"
    thickness, width, _ = _sizes(part)
    told = f"{1e3 * thickness:.3g} mm thick, {thickness / spacing:.2g} of a cell"
    if thickness >= SMALLEST * spacing:
        return "solid", told
    if width < 2.0 * spacing:
        return "rod", f"{told}, {1e3 * width:.3g} mm wide"
    return "shell", told


@lru_cache(maxsize=256)
def _unfit(part: Part, shape: str, spacing: float) -> str | None:
    """Why a part is no rod or no shell, in words; None where it is."""
    try:
        _lay(part, shape, spacing, (), None)
    except ValueError as error:
        return str(error).removeprefix(f"part '{part.name}': ").split(", expected")[0]
    return None


def thickness_of(part: Part) -> float:
    """How thick a sheet's mesh is, or how wide a rod's the narrow way: the usual chord [m]."""
    return _sizes(part)[0]


@lru_cache(maxsize=256)
def _sizes(part: Part) -> tuple[float, float, float]:
    """Thickness, width and length of a thin part [m]: the usual chord, and of the longest way through its
    bounds what its volume leaves for the third one."""
    thickness = chords(part).usual
    length = float(np.linalg.norm(np.ptp(part.vertices, axis=0)))
    return thickness, part.volume / (thickness * length), length


def cell_count(part: Part, spacing: float, graded: Grading | None = None) -> float:
    """Cells of a spacing [m] that a part's material is worth: of its volume, its sheet or its line, as which
    its size has it. graded: how much shorter those of a sheet are."""
    shape = _by_size(part, spacing)[0]
    if shape == "solid":
        return part.volume / spacing**3
    thickness, _, length = _sizes(part)
    if shape == "rod":
        return length / spacing
    times = graded.times(middle_surface_of(part), spacing) if graded else 1.0
    return times * part.volume / (thickness * spacing**2)


def lay_chart(
    part: Part, spacing: float, gripped: Sequence[np.ndarray] = (), graded: Grading | None = None
) -> Chart | None:
    """The curved grid of a part, or None where it is a solid.

    spacing: of its cells along the part, as near to it as makes a whole number of them [m]; gripped: for each
    hold places (n, 3) where it grips the part [m]: a boundary between cells lies there where that can be;
    graded: how much shorter cells of a sheet are.
    Raises ValueError where the part is not what it is to be simulated as.
    """
    shape = chosen_shape(part, spacing)[0]
    return None if shape == "solid" else _lay(part, shape, spacing, gripped, graded)


def _lay(
    part: Part, shape: str, spacing: float, gripped: Sequence[np.ndarray], graded: Grading | None
) -> Chart:
    chart = _rod(part, spacing, gripped) if shape == "rod" else _shell(part, spacing, gripped, graded)
    vertices = _finer(part, chart)
    # What the chart left out at its thin ends is brought in: nothing may be beyond the one cell.
    reach = 2.0 * np.abs(chart.to_cells(vertices) - 1.0)[:, 3 - chart.thin :].max(axis=0)
    if reach.max() > _FURTHEST:
        raise ValueError(
            f"part '{part.name}': as a {shape} it bends more sharply than cells of {spacing:g} m can follow, "
            'expected a finer spacing, or "as": "solid"'
        )
    chart = replace(chart, control=_widened(chart.control, np.maximum(reach, 1e-3)))
    chart.check(part.name)
    return chart


def _widened(control: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Nodes further from the middle by factors along the thin axes."""
    middle = control[:, :, 1:2] if len(reach) == 1 else control[:, 1:2, 1:2]
    if len(reach) == 1:
        return middle + reach[0] * (control - middle)
    one, two = control[:, 2:3, 1:2] - middle, control[:, 1:2, 2:3] - middle
    step = np.array([-1.0, 0.0, 1.0])
    return (
        middle
        + reach[0] * step[None, :, None, None] * one
        + reach[1] * step[None, None, :, None] * two
    )


def _rod(part: Part, spacing: float, gripped: Sequence[np.ndarray]) -> Chart:
    line = centre_line(part)
    plane = _boundary([line.along_of(points) for points in gripped if len(points)], spacing)
    low, size, count = fitting(line.low, line.high, spacing, plane, least=2)
    return rod_chart(line, low, size, count)


def _shell(part: Part, spacing: float, gripped: Sequence[np.ndarray], graded: Grading | None) -> Chart:
    surface = middle_surface_of(part)

    def laid(
        surface: MiddleSurface, low: np.ndarray, high: np.ndarray, planes: Sequence[float | None]
    ) -> tuple[Chart, np.ndarray, np.ndarray]:
        cells = [fitting(low[a], high[a], spacing, planes[a], least=2) for a in range(2)]
        corner, size, count = (np.array(values) for values in zip(*cells, strict=True))
        return shell_chart(surface, corner, size, count), corner, size

    chart, corner, size = laid(surface, surface.flat.min(axis=0), surface.flat.max(axis=0), (None, None))

    def flat(points: np.ndarray) -> np.ndarray:
        return corner + (chart.to_cells(points)[:, :2] - 0.5) * size

    # No sample is on the rim itself.
    rim = flat(part.vertices)
    held = [flat(points) for points in gripped if len(points)]
    planes = [_boundary([each[:, a] for each in held], spacing) for a in range(2)]
    low, high = rim.min(axis=0), rim.max(axis=0)
    if graded is None:
        return laid(surface, low, high, planes)[0]
    # Cells of one length along axes that are stretched where they are to be shorter.
    axes = [graded.stretched(a, low[a], high[a], spacing) for a in range(2)]
    flat_by_axis = [axes[a](surface.flat[:, a]) for a in range(2)]
    ends = [axes[a](np.array([low[a], high[a]])) for a in range(2)]
    planes = [None if planes[a] is None else float(axes[a](planes[a])) for a in range(2)]
    stretched = surface._replace(flat=np.stack(flat_by_axis, axis=1))
    return laid(stretched, *np.transpose(ends), planes)[0]


def _boundary(along: Sequence[np.ndarray], spacing: float) -> float | None:
    """The first place along an axis where a hold's face lies evenly."""
    return next((float(np.mean(a)) for a in along if np.std(a) < _EVEN * spacing), None)


def _finer(part: Part, chart: Chart) -> np.ndarray:
    """(V, 3) corners of the part's mesh and, where the chart bends, of its triangles' pieces [m]."""
    return finer(part.vertices, part.faces, _edge(chart))[0]


def _edge(chart: Chart) -> float:
    """Half a cell along the chart [m]."""
    return 0.5 * float(np.median(np.linalg.norm(np.diff(chart.control[:, 1, 1], axis=0), axis=1)))


def fill_curved(
    part: Part,
    number: int,
    count: int,
    chart: Chart,
    boxes: np.ndarray,
    earlier: Sequence[Part],
    samples: int,
) -> CellBlocks:
    """Blocks of one part on its chart, less what holds carry and earlier parts own.

    number: of the part among `count`; boxes: (H, 2, 3) [m]; samples: columns per cell along the part.
    Columns stand across the thinnest axis, and the mesh is told in cells: its heights are exact, so a
    sheet's thickness is, whatever the columns; volumes are those of space by the chart's determinant.
    """
    vertices, faces = finer(part.vertices, part.faces, _edge(chart))
    told = Part(part.name, chart.to_cells(vertices), faces)
    x, y = (
        cut_axis(0.5, 1.0, int(n), samples if n > 1 else _ACROSS, np.empty(0)) for n in chart.count[:2]
    )
    segments = split_columns([told], np.empty((0, 2, 3)), x, y)

    def measure(s: np.ndarray) -> np.ndarray:
        return np.abs(np.linalg.det(chart.jacobian(s + 0.5)))

    def volume(of: Segments) -> np.ndarray:
        middle = np.stack([x.middle[of.x], y.middle[of.y], 0.5 * (of.low + of.high)], axis=1)
        return x.width[of.x] * y.width[of.y] * (of.high - of.low) * measure(middle - 0.5)

    seen = np.zeros(count)
    seen[number] = volume(segments).sum()
    segments = _free(segments, chart, x.middle, y.middle, boxes, earlier)
    grid = Grid(np.full(3, 0.5), np.ones(3), chart.count)
    cell, _, share, mean, covariance = moments(segments, x, y, grid, measure)
    steps = spread(mean, covariance) * _drawn_in(chart, cell, covariance)[:, :, None]
    points = cell[:, None] + 1.0 + mean[:, None] + np.einsum("kc,bac->bka", CORNERS, steps)
    placed = chart.to_space(points.reshape(-1, 3)).reshape(points.shape)
    own = share / measure(cell + 0.5)
    return CellBlocks(cell, np.full(len(cell), number), own, share, placed, seen)


def _drawn_in(chart: Chart, cell: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(B, 3) what points' distances from the middle of their cell are multiplied with: along a part f, its
    thickness over the cell's length where that is below 1, but not in the cells at its ends and rims.

    Stretch and shear of splines change linearly over a cell, and what is thin cannot bend where they are held
    to nothing at two places of each cell: it locks, the more the longer its cells are and the more curved it
    is. At the middle alone they are held to nothing once for each node, and bending is seen there as well;
    but then patterns that alternate from node to node meet nothing. With f = t / h those swing 1.6 times as
    fast as the shortest bending that the nodes can show: w^2 = 16 E f^2 / (12 rho h^2) beside
    (pi / 2 h)^4 E t^2 / (12 rho). They buckle where the part is compressed by f^2: not below `_UNBUCKLED`.
    At ends and rims, where nodes have few cells, all of the distance is kept. Reduced integration of splines:
    Adam, Hughes, Bouabdallah, Zarroug and Maitournam 2015.
    """
    slopes = chart.jacobian(cell + 1.0)
    length = np.linalg.norm(slopes, axis=1)  # (B, 3), of a cell along each of its axes
    extent = np.sqrt(12.0 * np.diagonal(covariance, axis1=1, axis2=2)) * length
    thin = 3 - chart.thin
    share = extent[:, thin:].min(axis=1) / length.T  # (3, B)
    filled = np.zeros(chart.count + 2, bool)
    filled[tuple(cell.T + 1)] = True
    found = np.ones((len(cell), 3))
    for axis in range(thin):
        step = np.eye(3, dtype=np.int64)[axis]
        within = filled[tuple((cell + 1 + step).T)] & filled[tuple((cell + 1 - step).T)]
        found[within, axis] = np.clip(share[axis, within], np.sqrt(_UNBUCKLED), 1.0)
    return found


def rods_doubled(quadrature: Quadrature) -> Quadrature:
    """Sixteen points for each cell of a rod, in two blocks: one's points, and as many turned about the rod.

    Eight see too little of a section: its quarters may turn against each other without any strain at four
    points. Both blocks have the same moments of order 0, 1 and 2, those of the material across it.
    """
    rods = [n for n, chart in enumerate(quadrature.charts) if chart is not None and chart.kind == "rod"]
    mine = np.isin(quadrature.part, rods)
    if not mine.any():
        return quadrature
    points, volumes = quadrature.points[mine], quadrature.volumes[mine] / 2.0
    for number in rods:
        own = quadrature.part[mine] == number
        told = quadrature.in_cells(points[own], number)
        # Half the sum and difference of two steps across, in which the eight are all signs of three.
        mean = told.mean(axis=1, keepdims=True)
        steps = np.einsum("qa,bqc->bac", CORNERS, told - mean) / 8.0
        turned = mean + np.einsum("qa,bac->bqc", CORNERS @ _TURN, steps)
        points[own] = quadrature.from_cells(turned.reshape(-1, 3), number).reshape(turned.shape)
    both = quadrature.volumes.copy()
    both[mine] = volumes
    return replace(
        quadrature,
        cell=np.concatenate([quadrature.cell, quadrature.cell[mine]]),
        part=np.concatenate([quadrature.part, quadrature.part[mine]]),
        points=np.concatenate([quadrature.points, points]),
        volumes=np.concatenate([both, volumes]),
    )


def _free(
    segments: Segments, chart: Chart, x: np.ndarray, y: np.ndarray, boxes: np.ndarray, earlier: Sequence[Part]
) -> Segments:
    """The pieces of segments that no hold carries and no earlier part owns."""
    if not len(boxes) and not earlier:
        return segments
    share = np.arange(_PIECES + 1) / _PIECES
    cuts = segments.low[:, None] + (segments.high - segments.low)[:, None] * share
    low, high = cuts[:, :-1].ravel(), cuts[:, 1:].ravel()
    at_x, at_y = np.repeat(segments.x, _PIECES), np.repeat(segments.y, _PIECES)
    place = chart.to_space(np.stack([x[at_x], y[at_y], 0.5 * (low + high)], axis=1))
    kept = np.ones(len(place), bool)
    for box in boxes:
        kept &= ~((place > box[0]) & (place < box[1])).all(axis=1)
    for other in earlier:
        asked = np.flatnonzero(kept)
        kept[asked] = ~inside(other, place[asked])
    return Segments(
        at_x[kept], at_y[kept], low[kept], high[kept], np.zeros(int(kept.sum()), int), segments.full_volume
    )

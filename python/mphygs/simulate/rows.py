"""Rows of the constraint: what holds the object, and what ties the grids of its parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csc_matrix

from mphygs.scene.closest import closest_on_mesh
from mphygs.scene.particles import HoldFace, Joint, find_joints
from mphygs.simulate.joint_constraints import tie_rows

if TYPE_CHECKING:
    from mphygs.simulate.body import Body

# Of the mean square of the leading pattern of a trace: what has less is not held.
LEAST_TRACE = 1e-4


def constraint_rows(
    body: Body, faces: Sequence[Sequence[HoldFace]], spacing: float, *, carried: bool = True
) -> dict:
    """Rows of the holds: the trace of the spline on every held face moves with the hold.

    On a plane across an axis the trace has one coefficient for each column of nodes; a rigid motion
    is reproduced when each coefficient equals the motion of its Greville point, the column's place
    in the plane; on a curved grid the trace's patterns move with the hold. Below them the rows that tie the
    parts' grids, numbered -1, -2, ... by joint in `row_hold`.

    faces: of every hold (see `hold_face`); spacing: that the grids were made for [m]; carried: whether every
    part has to hang together with one that a hold grips, where there is any hold.
    Raises ValueError where a hold touches no free material, or a part is not carried.
    """
    q = body.quadrature
    steps = np.indices((3, 3, 3)).reshape(3, -1).T - 1
    nodes_of = {p: {tuple(c + d) for c in cells for d in steps} for p, cells in body.cells_of_part.items()}
    begin, node, weight, target, hold = [0], [], [], [], []
    for index, group in enumerate(faces):
        rows = 0
        for face, part in ((f, p) for f in group for p in nodes_of if (f.part == p).any()):
            nodes, mine = nodes_of[part], face.part == part
            if q.chart(part) is not None:
                for own, values, place in _curved_hold(body, face, mine, part):
                    node += own.tolist()
                    weight += values.tolist()
                    begin.append(len(weight))
                    target.append(place)
                    hold.append(index)
                    rows += 1
                continue
            across = [a for a in range(3) if a != face.axis]
            origin, size = q.origins[part], q.spacings[part]
            position = body.in_cells(face.points[mine], part)
            base = np.rint(position).astype(int)
            height = (face.coordinate - origin[face.axis]) / size[face.axis]
            share: dict[tuple[int, int], float] = {}
            for p, b, area in zip(position, base, face.area[mine], strict=True):
                w0, w1 = _spline(p[across[0]] - b[across[0]]), _spline(p[across[1]] - b[across[1]])
                for i in range(3):
                    for j in range(3):
                        key = (b[across[0]] + i - 1, b[across[1]] + j - 1)
                        share[key] = share.get(key, 0.0) + area * w0[i] * w1[j]
            full = size[across[0]] * size[across[1]]
            for key, area in sorted(share.items()):
                if area < 1e-4 * full:
                    continue
                stencil = _column(nodes, face.axis, across, key, height)
                if stencil is None:
                    continue
                span, column = stencil
                node += body.on_grid(column, part).tolist()
                weight += _spline(height - span).tolist()
                begin.append(len(weight))
                greville = np.empty(3)
                greville[face.axis] = face.coordinate
                greville[across] = origin[across] + np.array(key) * size[across]
                target.append(greville)
                hold.append(index)
                rows += 1
        if rows == 0:
            raise ValueError(
                f"hold {index}: its box {body.boxes[index].tolist()} has no face with free material "
                "beyond it, expected a box that holds a part of the object and leaves the rest free"
            )
    for joint, nodes, values in _ties(body, faces, spacing, carried):
        node += nodes.tolist()
        weight += values.tolist()
        begin.append(len(weight))
        target.append(np.zeros(3))
        hold.append(-1 - joint)
    return {
        "row_begin": np.array(begin, np.int32),
        "row_node": np.array(node, np.int32).reshape(-1, 3),
        "row_weight": np.array(weight, float),
        "row_target": np.array(target, float).reshape(-1, 3),
        "row_hold": np.array(hold, np.int32),
        "hold_count": len(faces),
    }


def _curved_hold(
    body: Body, face: HoldFace, mine: np.ndarray, part: int
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Nodes (W, 3), weights (W,) and target (3,) of the rows by which a held face moves a part on a curved
    grid.

    Such a grid has no plane of nodes in the face. Held are all patterns of the displacement over it that the
    splines can make there and that are not next to nothing: the leading ones of the trace. What a rigid
    motion does to the nodes it does to the patterns. To each is added as much of the one that is most like
    the mean as makes its weights add up to one.
    """
    chart = body.quadrature.chart(part)
    points, area = face.points[mine], face.area[mine]
    nodes, shares = _carried_by(body, points, part)
    index, column = np.unique(nodes.reshape(-1, 3), axis=0, return_inverse=True)
    trace = np.zeros((len(points), len(index)))
    row = np.repeat(np.arange(len(points)), shares.shape[1])
    np.add.at(trace, (row, column.ravel()), shares.ravel())
    gram = (trace * (area / area.sum())[:, None]).T @ trace
    strength, pattern = np.linalg.eigh(gram)
    rows = pattern[:, strength > LEAST_TRACE * strength[-1]].T
    rows = rows[np.argsort(-np.abs(rows.sum(axis=1)), kind="stable")]
    rows[0] /= rows[0].sum()
    rows[1:] += (1.0 - rows[1:].sum(axis=1))[:, None] * rows[0]
    own = index - [part * body.geometry["grid_width"], 0, 0]
    place = chart.control[tuple(own.T)]
    return [(index, each, each @ place) for each in rows]


def _ties(
    body: Body, faces: Sequence[Sequence[HoldFace]], spacing: float, carried: bool
) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Rows of the joints between parts that both have free material."""
    cells = body.cells_of_part
    if len(cells) < 2:
        return []
    grounded = sorted({int(p) for group in faces for face in group for p in face.part} & set(cells))
    joints = [
        joint
        for joint in find_joints(
            body.parts,
            spacing=spacing,
            exclude_boxes=body.boxes if len(body.boxes) else None,
            grounded=grounded,
        )
        if set(joint.parts) <= set(cells)
    ]
    if carried and grounded:
        _check_carried(body, joints, grounded, spacing)
    weights = [tuple(_carried_by(body, joint.points, p) for p in joint.parts) for joint in joints]
    return tie_rows(joints, weights, spacing)


def _check_carried(body: Body, joints: Sequence[Joint], grounded: Sequence[int], spacing: float) -> None:
    """Raises ValueError for a part that hangs together with none that a hold grips."""
    reached, found = set(grounded), set()
    while reached != found:
        found = set(reached)
        reached |= {part for joint in joints if reached & set(joint.parts) for part in joint.parts}
    for number in sorted(set(body.cells_of_part) - reached):
        part, others = body.parts[number], [body.parts[p] for p in sorted(reached)]
        gap = min(closest_on_mesh(p.vertices, p.faces, part.vertices)[1].min() for p in others)
        raise ValueError(
            f"part '{part.name}' hangs on nothing: it is {gap:.2g} m from what holds carry, expected meshes "
            f"that touch, or are less than a cell of {spacing:.3g} m apart, or a hold of its own"
        )


def _carried_by(body: Body, points: np.ndarray, part: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (Q, 27, 3) on a part's grid and shares (Q, 27) that carry points (Q, 3) as its material."""
    cell = body.nearest_of(part, points)
    x, y, z = np.moveaxis(_spline(body.in_cells(points, part) - cell), 2, 0)  # each (3, Q)
    shares = np.einsum("iq,jq,kq->qijk", x, y, z).reshape(-1, 27)
    nodes = cell[:, None] + np.indices((3, 3, 3)).reshape(3, -1).T - 1
    return body.on_grid(nodes, part), shares


def _column(nodes: set, axis: int, across: list[int], key: tuple[int, int], height: float) -> tuple | None:
    """The span along `axis` nearest to `height` whose three nodes carry material, and these nodes."""
    nearest = round(height)
    for span in sorted(range(nearest - 1, nearest + 2), key=lambda s: abs(s - height)):
        column = []
        for k in (span - 1, span, span + 1):
            index = [0, 0, 0]
            index[axis], index[across[0]], index[across[1]] = k, key[0], key[1]
            column.append(tuple(index))
        if all(c in nodes for c in column):
            return span, column
    return None


def _spline(s: np.ndarray | float) -> np.ndarray:
    return np.array([0.5 * (0.5 - s) ** 2, 0.75 - s * s, 0.5 * (0.5 + s) ** 2])


def held_rows(body: Body, index: np.ndarray) -> csc_matrix:
    """(R, N) weights of the nodes that every held column of them fixes and every joint ties."""
    geometry = body.geometry
    if not len(geometry["row_hold"]):
        return csc_matrix((0, len(index)))
    number = {tuple(i): n for n, i in enumerate(index)}
    begin = geometry["row_begin"]
    row = np.repeat(np.arange(len(begin) - 1), np.diff(begin))
    column = [number[tuple(i)] for i in geometry["row_node"]]
    return csc_matrix((geometry["row_weight"], (row, column)), shape=(len(begin) - 1, len(index)))

"""How a pull at markers is spread over the material: accelerations of carriers for what markers ask for.

Where markers are nearer than a cell each pulls collocated: the force H^T W acts, W the material that is
nearest to each, no more of it than what a marker moves by itself. Where they are few their pulls are spread
by the body's own least-energy extension: G = P H^T (H P H^T + R)^-1, P the compliance of a uniform elastic
medium with holds and ties in it, R what two markers at one place may differ by. It carries rotation and
parts without markers along. Neither drives anything: the eigenvalues of H G are real and not negative, for
W and (H P H^T + R)^-1 are symmetric and positive.
Sources: collocated feedback after Preumont, "Vibration control of active structures", 2011; kriging after
Cressie, "Statistics for spatial data", 1993.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import bsr_matrix, coo_matrix, csc_matrix, csr_matrix, diags, identity, kron, vstack
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from mphygs.simulate.body import LANES, Body
from mphygs.simulate.rows import held_rows

# Variance of what two markers at one place may ask for differently, over that of what one asks for.
NUGGET = 1e-3
# Of the body's size, the length over which a body without holds is still carried along.
FAR = 10.0
# Poisson's ratio of the uniform medium.
POISSON = 0.3
# How stiff holds and ties are beside the medium.
HELD = 1e4
# Blocks of G that are smaller than this, beside the largest of their node, are left out.
SMALL = 1e-3


def on_nodes(
    model: object, body: Body, rows: csr_matrix, markers: np.ndarray, spacing: float
) -> csr_matrix | bsr_matrix:
    """G of the nodes: (N, M) numbers, or (3 N, 3 M) in blocks of 3 x 3 [-].

    model: of the core, for its nodes; rows: (M, N) H; markers: (M, 3) [m]; spacing: of the grid [m].
    """
    if not are_dense(markers, spacing):
        return in_blocks(extension(model, body, rows), len(markers))
    points, volumes = body.quadrature.points.reshape(-1, 3), body.quadrature.volumes.ravel()
    node, value, _ = model.weights(points, body.point_cell)
    volume = np.bincount(node.ravel(), (value * volumes[:, None]).ravel(), minlength=model.node_count)
    return collocated(rows, volume, markers, points, volumes)


def on_particles(
    model: object,
    body: Body,
    weights: csr_matrix,
    rows: csr_matrix,
    markers: np.ndarray,
    particles: tuple[np.ndarray, np.ndarray, int],
    spacing: float,
) -> tuple[csr_matrix | bsr_matrix, np.ndarray | None]:
    """G of the particles, or of their blocks of eight, which lie in one cell each and are pulled alike where
    markers are few; and (N,) the block of each then, -1 of those that holds carry.

    model, body: the grid on which the extension is solved for; weights: (N, N') of its nodes at the
    particles; rows: (M, N) H; particles: their places (N, 3) [m], volumes (N,) [m^3], and how many are
    free, those first.
    """
    points, volumes, free = particles
    if are_dense(markers, spacing):
        return collocated(rows, volumes, markers, points, volumes), None
    block = np.arange(free) // LANES
    share = np.full(free, 1.0 / LANES)
    mean = csr_matrix((share, (block, np.arange(free))), shape=(free // LANES, len(points)))
    gain = kron(mean @ weights, identity(3)) @ extension(model, body, csr_matrix(rows @ weights))
    return in_blocks(gain, len(markers)), np.concatenate([block, np.full(len(points) - free, -1)])


def are_dense(markers: np.ndarray, spacing: float) -> bool:
    """Whether markers (M, 3) [m] are nearer to each other than the cells are wide."""
    return 0.0 < _usual_distance(markers) < spacing


def collocated(
    rows: csr_matrix, volume: np.ndarray, markers: np.ndarray, points: np.ndarray, volumes: np.ndarray
) -> csr_matrix:
    """(N, M) of a force at each marker. volume: (N,) of the carriers; points: (Q, 3) [m] of the material,
    with volumes (Q,) [m^3]."""
    own = np.bincount(cKDTree(markers).query(points)[1], volumes, minlength=len(markers))
    local = np.asarray(rows.power(2) @ (1.0 / volume)).ravel()
    return (diags(1.0 / volume) @ rows.T @ diags(np.minimum(own, 1.0 / local))).tocsr()


def extension(model: object, body: Body, rows: csr_matrix) -> np.ndarray:
    """(3 N, 3 M) least-energy displacements of the nodes for those of markers."""
    if not rows.shape[0]:
        return np.zeros((3 * model.node_count, 0))
    points, volumes = body.quadrature.points.reshape(-1, 3), body.quadrature.volumes.ravel()
    node, value, gradient = model.weights(points, body.point_cell)
    volume = np.bincount(node.ravel(), (value * volumes[:, None]).ravel(), minlength=model.node_count)
    far = FAR * float(np.ptp(points, axis=0).max())
    smooth = csc_matrix(diags(np.repeat(volume / far**2, 3)))
    smooth += _stiffness(node, gradient, volumes, model.node_count)
    held = kron(held_rows(body, model.node_index), identity(3))
    smooth += HELD * smooth.diagonal().mean() * (held.T @ held)
    reads = kron(rows, identity(3)).toarray()
    moved = splu(csc_matrix(smooth)).solve(reads.T)
    compliance = reads @ moved
    nugget = NUGGET * compliance.diagonal().mean() * np.eye(len(compliance))
    return np.linalg.solve(compliance + nugget, moved.T).T


def _usual_distance(markers: np.ndarray) -> float:
    """Median distance of a marker from its neighbours [m]: the mean of the two nearest."""
    count = min(3, len(markers))
    if count < 2:
        return 0.0
    return float(np.median(cKDTree(markers).query(markers, k=count)[0][:, 1:].mean(1)))


def _stiffness(node: np.ndarray, gradient: np.ndarray, volumes: np.ndarray, count: int) -> csc_matrix:
    """(3 N, 3 N) of small strains in a medium with Young's modulus 1 [m].

    node: (Q, K); gradient: (Q, K, 3) [1/m] of their weights at the points; volumes: (Q,) [m^3].
    """
    shear = 0.5 / (1.0 + POISSON)
    lame = POISSON / ((1.0 + POISSON) * (1.0 - 2.0 * POISSON))
    row = np.repeat(np.arange(len(node)), node.shape[1])
    slope = [
        [
            coo_matrix(
                (gradient[..., axis].ravel(), (row, 3 * node.ravel() + part)), shape=(len(node), 3 * count)
            ).tocsr()
            for axis in range(3)
        ]
        for part in range(3)
    ]
    spread_out = slope[0][0] + slope[1][1] + slope[2][2]
    turned = [np.sqrt(0.5) * (slope[a][b] + slope[b][a]) for a, b in ((0, 1), (1, 2), (2, 0))]
    strains = vstack([slope[0][0], slope[1][1], slope[2][2], *turned])
    energy = lame * (spread_out.T @ diags(volumes) @ spread_out)
    return csc_matrix(energy + 2.0 * shear * (strains.T @ diags(np.tile(volumes, 6)) @ strains))


def in_blocks(gain: np.ndarray, markers: int) -> bsr_matrix:
    """The blocks of a (3 N, 3 M) matrix that are not small beside the largest of their node."""
    blocks = gain.reshape(-1, 3, markers, 3).swapaxes(1, 2)
    size = np.linalg.norm(blocks, axis=(2, 3))
    kept = size > SMALL * size.max(1, keepdims=True)
    begin = np.concatenate([[0], np.cumsum(kept.sum(1))])
    return bsr_matrix((blocks[kept], np.nonzero(kept)[1], begin), shape=gain.shape, blocksize=(3, 3))

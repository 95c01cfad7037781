"""Where a point mass sits, between the places that were tried."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from mphygs.diagnose.candidates import Way, mass_way, place_digits
from mphygs.model.belief import Belief
from mphygs.simulate.body import Body

# Of the largest mass: what is less is no second place.
NEGLIGIBLE = 0.02
# Of a cell: what is nearer to a place that was tried is that place.
SAME_PLACE = 0.1


def mass_between(
    belief: Belief,
    body: Body,
    ways: Sequence[Way],
    tangents: np.ndarray,
    residual: np.ndarray,
    jacobian: np.ndarray,
) -> Way | None:
    """One more way of `attached_mass`: at the centre of the masses that explain most together.

    Small masses at several places move a body, to first order in them and but for their spin, as their sum at
    their centre does. The masses, none negative, are those that fit the residual best, with what the fitted
    parameters absorb left out (Lawson & Hanson, Solving Least Squares Problems, chapter 23).
    tangents: (N, Q) by all columns of the ways in order; residual: (N,); jacobian: (N, P). None where a
    single place does as well.
    """
    chosen, at = [], 0
    for way in ways:
        if way.effect == "attached_mass" and set(way.settings) == {"place"}:
            chosen.append((at, np.asarray(way.settings["place"], float)))
        at += len(way.columns)
    if len(chosen) < 2:
        return None
    columns = tangents[:, [k for k, _ in chosen]]
    absorbed = np.linalg.qr(jacobian)[0] if jacobian.shape[1] else np.zeros((len(residual), 0))
    columns = columns - absorbed @ (absorbed.T @ columns)
    left = residual - absorbed @ (absorbed.T @ residual)
    size = np.linalg.norm(columns, axis=0)
    if not np.all(size > 0.0):
        return None
    masses = nnls(columns / size, left)[0] / size
    if np.count_nonzero(masses > NEGLIGIBLE * masses.max(initial=0.0)) < 2:
        return None
    places = np.array([place for _, place in chosen])
    centre = masses @ places / masses.sum()
    points = body.quadrature.points[: body.free_block_count].reshape(-1, 3)
    away = np.linalg.norm(points - centre, axis=1)
    # Two leaves have their centre in the air: then the material nearest to it.
    cell = float(np.max(body.quadrature.spacing))
    place = centre if away.min() < 0.5 * cell else points[away.argmin()]
    if np.linalg.norm(places - place, axis=1).min() < SAME_PLACE * cell:
        return None
    # One digit more than the labels of the places tried: it may round to one of them.
    return mass_way(belief, place, place_digits(body) + 1)

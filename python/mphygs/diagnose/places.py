"""Where a point mass sits, between the places that were tried; where a wind blows, between the axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from mphygs.diagnose.candidates import LATE, Way, mass_way, place_digits, wind_way
from mphygs.model.belief import Belief
from mphygs.simulate.body import Body

# Of the largest mass: what is less is no second place.
NEGLIGIBLE = 0.02
# Of a cell: what is nearer to a place that was tried is that place.
SAME_PLACE = 0.1
# Cosine of the angle to a direction that was tried from which a wind blows in that direction.
SAME_DIRECTION = 0.999


def _together(columns: np.ndarray, residual: np.ndarray, jacobian: np.ndarray) -> np.ndarray | None:
    """Amounts of the columns, none negative, that fit a residual best together, what the fitted parameters
    absorb left out (Lawson & Hanson, Solving Least Squares Problems, chapter 23). None where one does as
    well alone."""
    absorbed = np.linalg.qr(jacobian)[0] if jacobian.shape[1] else np.zeros((len(residual), 0))
    columns = columns - absorbed @ (absorbed.T @ columns)
    left = residual - absorbed @ (absorbed.T @ residual)
    size = np.linalg.norm(columns, axis=0)
    if not np.all(size > 0.0):
        return None
    amounts = nnls(columns / size, left)[0] / size
    return amounts if np.count_nonzero(amounts > NEGLIGIBLE * amounts.max(initial=0.0)) > 1 else None


def wind_between(
    belief: Belief,
    ways: Sequence[Way],
    tangents: np.ndarray,
    residual: np.ndarray,
    jacobian: np.ndarray,
    *,
    late: bool = False,
) -> Way | None:
    """One more way of `wind`: in the direction of the steady drag that flows along the axes explain together
    (see `mass_between`). Light drags in several flows move a body that is slow beside them as their sum does.
    None where one axis does as well."""
    chosen, at = [], 0
    for way in ways:
        if way.effect == "wind" and way.settings == (LATE if late else {}):
            chosen.append((at, np.array([way.values[f"w_{a}"] for a in "xyz"])))
        at += len(way.columns)
    if len(chosen) < 2:
        return None
    drags = _together(tangents[:, [k for k, _ in chosen]], residual, jacobian)
    if drags is None:
        return None
    flows = np.array([flow for _, flow in chosen])
    flow = drags @ flows
    length = float(np.linalg.norm(flow))
    if length == 0.0 or (flows @ flow / length / np.linalg.norm(flows, axis=1)).max() > SAME_DIRECTION:
        return None  # opposite ones may leave a flow along an axis, which was tried
    return wind_way(belief, flow / length, late=late)


def mass_between(
    belief: Belief,
    body: Body,
    ways: Sequence[Way],
    tangents: np.ndarray,
    residual: np.ndarray,
    jacobian: np.ndarray,
    *,
    late: bool = False,
) -> Way | None:
    """One more way of `attached_mass`: at the centre of the masses that explain most together, of those that
    came after the published shape was taken (late) or of the others.

    Small masses at several places move a body, to first order in them and but for their spin, as their sum at
    their centre does. tangents: (N, Q) by all columns of the ways in order; residual: (N,); jacobian:
    (N, P). None where a single place does as well.
    """
    chosen, at = [], 0
    for way in ways:
        if way.effect == "attached_mass" and set(way.settings) == ({"place", *LATE} if late else {"place"}):
            chosen.append((at, np.asarray(way.settings["place"], float)))
        at += len(way.columns)
    if len(chosen) < 2:
        return None
    masses = _together(tangents[:, [k for k, _ in chosen]], residual, jacobian)
    if masses is None:
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
    return mass_way(belief, place, place_digits(body) + 1, late=late)


def ways_between(
    belief: Belief,
    body: Body,
    ways: Sequence[Way],
    tangents: np.ndarray,
    residual: np.ndarray,
    jacobian: np.ndarray,
) -> list[Way]:
    """Further ways between those that were tried (see `mass_between`, `wind_between`), of loads that the
    published shape bears and of those that came after it."""
    explained = tangents, residual, jacobian
    found: list[Way | None] = []
    for late in (False, True):
        found.append(mass_between(belief, body, ways, *explained, late=late))
        found.append(wind_between(belief, ways, *explained, late=late))
    return [way for way in found if way is not None]

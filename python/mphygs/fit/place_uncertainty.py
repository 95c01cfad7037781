"""How surely the places of effects are known, and what that they are fitted does to all else that is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from mphygs.capture.meshes import Part
from mphygs.fit.place_fit import CONCLUDED, movable, object_size, place_columns
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Of the object's size, the standard deviation from which a place is not determined.
ANYWHERE = 0.25


@dataclass(frozen=True, eq=False)
class KnownPlaces:
    """What fitted places do to what is known of the P coordinates. covariance, information: as without,
    (P, P); shift: (P,) of the coordinates by the grid's error, None where that is not known; std: (3,) of
    each place by name [m], the grid's error included."""

    covariance: np.ndarray
    information: np.ndarray
    shift: np.ndarray | None
    std: dict[str, np.ndarray]


def with_place_uncertainty(
    problem: Problem,
    belief: Belief,
    evaluation: Evaluation,
    noise: np.ndarray,
    information: np.ndarray,
    change: np.ndarray | None = None,
) -> KnownPlaces:
    """How surely coordinates and places are known when both are fitted.

    noise, information: covariance of the free coordinates and information of the measurements, (P, P) each,
    of the evaluation as if the places were known; change: (N,) of its data rows by the grid's error,
    whitened. A place beside which the model cannot be simulated counts as known.
    """
    known = {}
    for name in movable(belief):
        with suppress(SimulationError):
            known[name] = place_columns(problem, belief, name)
    data = slice(evaluation.data_rows)
    rows = evaluation.jacobian[data]
    columns = np.hstack([np.zeros((len(rows), 0)), *(found.columns[data] for found in known.values())])
    told = rows.T @ columns
    prior = np.concatenate([[], *(found.prior**-2.0 for found in known.values())])
    own = columns.T @ columns + np.diag(prior)
    # The coordinates' covariance with the places fitted: Schur complement of what is known without.
    moved_by = noise @ told
    of_place = np.linalg.inv(own - told.T @ moved_by)
    covariance = noise + moved_by @ of_place @ moved_by.T
    shift = moves = None
    if change is not None:
        # Least squares of the change by both: places give way first, coordinates to what is left of it.
        moves = of_place @ (columns.T @ change - moved_by.T @ (rows.T @ change))
        shift = noise @ (rows.T @ change) - moved_by @ moves
    std, first = {}, 0
    for name, found in known.items():
        mine = slice(first, first + len(found.moves))
        variance = np.einsum("ka,kl,lb->ab", found.moves, of_place[mine, mine], found.moves).diagonal()
        by_grid = 0.0 if moves is None else (moves[mine] @ found.moves) ** 2
        std[name] = np.sqrt(variance + by_grid + found.room**2 / 12.0)
        first = mine.stop
    return KnownPlaces(covariance, information - told @ np.linalg.solve(own, told.T), shift, std)


def located(belief: Belief, spread: Mapping[str, np.ndarray], parts: Sequence[Part]) -> Belief:
    """The belief with how surely the places of its effects are known, (3,) [m] each, among their settings."""
    terms = []
    for term in belief.terms:
        if term.name in spread:
            std = np.asarray(spread[term.name], float)
            values = (std.tolist(), (std < ANYWHERE * object_size(parts)).tolist())
            term = replace(term, settings={**term.settings, **dict(zip(CONCLUDED, values, strict=True))})
        terms.append(term)
    return replace(belief, terms=tuple(terms))


def places_document(belief: Belief) -> dict[str, dict[str, object]]:
    """Value, std, unit and whether it is determined, of each coordinate of each place that was fitted."""
    out: dict[str, dict[str, object]] = {}
    for term in belief.terms:
        if not set(CONCLUDED) <= set(term.settings):
            continue
        told = (term.settings[key] for key in ("place", *CONCLUDED))
        for axis, value, std, determined in zip("xyz", *told, strict=True):
            entry = {"value": value, "std": std, "unit": "m", "determined": determined}
            note = {} if determined else {"note": "anywhere on the object"}
            out[f"{term.name}.place_{axis}"] = entry | note
    return out

"""Where an effect acts, between the places that were tried; where a flow goes, between the axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from mphygs.diagnose.effect_variants import EffectVariant, flow_variant, place_digits, placed_variant
from mphygs.model.belief import Belief
from mphygs.model.descriptor import EffectSpec
from mphygs.model.registry import effect
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


def _along(variants: Sequence[EffectVariant], wanted: Sequence[EffectVariant]) -> list[int]:
    """First column of each of some variants, among the columns of all."""
    first = dict(
        zip((id(w) for w in variants), np.cumsum([0, *(len(w.columns) for w in variants)]), strict=False)
    )
    return [int(first[id(w)]) for w in wanted]


def flow_between(
    belief: Belief,
    spec: EffectSpec,
    variants: Sequence[EffectVariant],
    amounts: np.ndarray,
) -> EffectVariant | None:
    """One more variant of what acts in a flow: in the direction of the steady drag that flows along the axes
    explain together. Light drags in several flows move a body that is slow beside them as their sum does.
    None where one axis does as well."""
    flows = np.array([[variant.values[p.name] for p in spec.of_role("flow")] for variant in variants])
    flow = amounts @ flows
    length = float(np.linalg.norm(flow))
    if length == 0.0 or (flows @ flow / length / np.linalg.norm(flows, axis=1)).max() > SAME_DIRECTION:
        return None  # opposite ones may leave a flow along an axis, which was tried
    return flow_variant(belief, spec, flow / length, variants[0].settings)


def placed_between(
    belief: Belief, body: Body, spec: EffectSpec, variants: Sequence[EffectVariant], amounts: np.ndarray
) -> EffectVariant | None:
    """One more variant of what acts at a place: at the centre of those that explain most together.

    Small masses at several places move a body, to first order in them and but for their spin, as their sum at
    their centre does. None where a single place does as well.
    """
    places = np.array([variant.settings["place"] for variant in variants], float)
    centre = amounts @ places / amounts.sum()
    points = body.quadrature.points[: body.free_block_count].reshape(-1, 3)
    away = np.linalg.norm(points - centre, axis=1)
    # Two leaves have their centre in the air: then the material nearest to it.
    cell = float(np.max(body.quadrature.spacing))
    place = centre if away.min() < 0.5 * cell else points[away.argmin()]
    if np.linalg.norm(places - place, axis=1).min() < SAME_PLACE * cell:
        return None
    rest = {k: v for k, v in variants[0].settings.items() if k != "place"}
    # One digit more than the labels of the places tried: it may round to one of them.
    return placed_variant(belief, spec, place, place_digits(body) + 1, rest)


def variants_between(
    belief: Belief,
    body: Body,
    variants: Sequence[EffectVariant],
    tangents: np.ndarray,
    residual: np.ndarray,
    jacobian: np.ndarray,
) -> list[EffectVariant]:
    """Further variants between those that were tried (see `placed_between`, `flow_between`), of loads that
    the published shape bears and of those that came after it.

    tangents: (N, Q) by all columns of the variants in order; residual: (N,); jacobian: (N, P).
    """
    alike: dict[tuple, list[EffectVariant]] = {}
    for variant in variants:
        spec = effect(variant.effect)
        tried = (
            variant.values if spec.of_role("flow") else {"place": 0} if "place" in variant.settings else {}
        )
        one = len(variant.columns) == 1 and tried and "sequences" not in variant.settings
        if one:
            alike.setdefault((variant.effect, variant.settings.get("at_rest", True)), []).append(variant)
    found: list[EffectVariant | None] = []
    for (name, _late), own in alike.items():
        if len(own) < 2:
            continue
        amounts = _together(tangents[:, _along(variants, own)], residual, jacobian)
        if amounts is None:
            continue
        spec = effect(name)
        if spec.of_role("flow"):
            found.append(flow_between(belief, spec, own, amounts))
        else:
            found.append(placed_between(belief, body, spec, own, amounts))
    return [variant for variant in found if variant is not None]

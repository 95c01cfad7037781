"""Where a refit of an effect begins: the belief with it as its score says."""

from __future__ import annotations

import numpy as np

from mphygs.diagnose.effect_variants import EffectVariant, strengths
from mphygs.diagnose.score_table import Score
from mphygs.model.belief import Belief
from mphygs.model.registry import effect

# What is tied is tied as stiffly as an estimate says that is so many standard deviations from nothing; else
# with so many times the stiffness at which its pull comes from as far as the object is large. Never slacker
# than the last, of its usual strength.
SURE, NEARER, SLACKEST = 2.0, (1.0, 3.0), 1e-3
# Of the speed that a flow was tried with, the standard deviation of its prior: only the product of drag and
# flow is told at first.
FLOW_PRIOR = 2.5


def refit_start(variant: EffectVariant, estimate: np.ndarray, belief: Belief) -> Belief:
    """The belief with a variant's effect at an estimate (q,), ready for a refit."""
    if variant.form == "anchor":
        return _tied(variant, _stiffness(estimate), estimate, belief)
    if variant.form == "axis":
        return _graded(variant, estimate, belief)
    if variant.form == "swing":
        return _swinging(variant, estimate, belief)
    spec = effect(variant.effect)
    there = variant.columns[0][0]
    values = {p.name: there[f"{spec.name}.{p.name}"].value for p in spec.parameters}
    for name, value in zip(strengths(spec), estimate, strict=True):
        own = there[f"{spec.name}.{name}"]
        values[name] = float(np.clip(value, own.lower, own.upper))
    result = belief.with_effect(spec.name, values, variant.settings)
    for p in spec.of_role("flow"):
        result = result.with_parameter(f"{spec.name}.{p.name}", prior_std=FLOW_PRIOR * p.range[1])
    for name in strengths(spec) if spec.of_role("flow") else ():
        own = next(p for p in spec.parameters if p.name == name)
        result = result.with_parameter(f"{spec.name}.{name}", prior_mean=own.scale, prior_std=own.scale)
    return result


def other_starts(variant: EffectVariant, score: Score, belief: Belief) -> tuple[Belief, ...]:
    """Further beliefs for a refit to start from: along each principal axis of its part alone; tied as hard
    from nearer by, where the estimate does not tell how stiffly.

    Across a thin part a slope of any size changes little but the linear prediction, and may lead it astray.
    """
    if variant.form == "anchor":
        of_total = float(np.linalg.pinv(score.information, hermitian=True).sum())  # its variance
        if score.estimate.sum() > SURE * np.sqrt(max(of_total, 0.0)):
            return ()
        afar, first = float(np.linalg.norm(score.estimate[1:])), _stiffness(score.estimate)
        return tuple(_tied(variant, k * afar, score.estimate, belief) for k in NEARER if k * afar != first)
    if variant.form != "axis":
        return ()
    starts = []
    for axis in np.asarray(variant.settings["axes"]).T:
        known = float(axis @ score.information @ axis)
        if known > 0.0:
            starts.append(_graded(variant, float(axis @ score.score) / known * axis, belief))
    return tuple(starts)


def _stiffness(estimate: np.ndarray) -> float:
    """Of all springs together [N/m]; where none came out, with the anchor of their pull as far away as the
    object is large."""
    total = float(estimate.sum())
    return total if total > 0.0 else float(np.linalg.norm(estimate[1:]))


def _tied(variant: EffectVariant, stiffness: float, estimate: np.ndarray, belief: Belief) -> Belief:
    """Tied with a stiffness [N/m], pulling where the object was published as the springs of an estimate do:
    of k_j to anchors p + L e_j."""
    spec, (strength,) = effect(variant.effect), strengths(effect(variant.effect))
    place, size, anchors = np.array(variant.settings["place"]), variant.scale, spec.of_role("anchor")
    least = SLACKEST * next(p.scale for p in spec.parameters if p.name == strength)
    stiffness = max(stiffness, least)
    anchor = np.clip(place + size * estimate[1:] / stiffness, place - 10 * size, place + 10 * size)
    values = {p.name: float(x) for p, x in zip(anchors, anchor, strict=True)}
    result = belief.with_effect(spec.name, {strength: stiffness, **values}, variant.settings)
    for p in anchors:
        result = result.with_parameter(f"{spec.name}.{p.name}", free=True, scale=size)
    return result


def _graded(variant: EffectVariant, slope: np.ndarray, belief: Belief) -> Belief:
    """slope: (3,) [1/m]; its length at most as the effect allows."""
    spec, (strength,) = effect(variant.effect), strengths(effect(variant.effect))
    length = float(np.linalg.norm(slope))
    axis = slope / length if length > 0 else np.eye(3)[0]
    upper = next(p.upper for p in spec.parameters if p.name == strength)
    settings = {"part": variant.settings["part"], "axis": axis.tolist()}
    return belief.with_effect(spec.name, {strength: min(length, upper)}, settings)


def _swinging(variant: EffectVariant, estimate: np.ndarray, belief: Belief) -> Belief:
    """One phase for all strengths: that of the largest amplitude."""
    spec = effect(variant.effect)
    (phase,) = (p.name for p in spec.of_role("phase"))
    own = [p for p in spec.of_role("strength") if p.fitted]
    sine, cosine = estimate[: len(own)], estimate[len(own) :]
    k = int(np.hypot(sine, cosine).argmax())
    at = float(np.arctan2(cosine[k], sine[k]))
    a = sine * np.cos(at) + cosine * np.sin(at)
    amounts = {p.name: float(np.clip(x, p.lower, p.upper)) for p, x in zip(own, a, strict=True)}
    return belief.with_effect(spec.name, amounts | variant.values | {phase: at})

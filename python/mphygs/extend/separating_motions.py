"""After the loop: which motion would tell what was found from what the data confuse it with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mphygs.diagnose.effect_variants import EffectVariant, late_variants, smooth_variants
from mphygs.diagnose.next_motion import Proposed, propose
from mphygs.diagnose.ranking import RankedEffect
from mphygs.extend.conclusion import Discovery
from mphygs.extend.step import Step
from mphygs.fit.experiment import Experiment
from mphygs.fit.placement import masses_of_loads
from mphygs.model.belief import Belief


def motions_to_record(
    found: Discovery,
    experiment: Experiment,
    spacing: float,
    *,
    report: Callable[[str], None] | None = None,
) -> tuple[Proposed, ...]:
    """Motions that would tell the first effect found from its closest rival, the best first.

    spacing: of the grid that simulates them [m]; a coarse one ranks motions as well as a fine one.

    None without a rival, for effects that no tangent describes, and where nothing that could be moved is
    held.
    """
    number = next((k for k, step in enumerate(found.steps) if k and step.ties), None)
    if number is None or not set(found.steps[number].added) & set(found.effects):
        return ()
    step, rankings = found.steps[number], [r for r in found.rankings if r.entries]
    leader = step.added[0]
    entries = {entry.effect: entry for ranking in reversed(rankings) for entry in ranking.entries}
    belief = _without_last(found.steps[number - 1], step)
    name = next(iter(experiment.fitted))
    predictor = experiment.predictor(name, spacing)
    hung = masses_of_loads(experiment.capture, [name])
    asked = [leader, *step.ties]
    variants = smooth_variants(belief, predictor.body, names=asked, hung=hung)
    variants += late_variants(belief, predictor.body, names=asked)
    first = _variant_of(entries.get(leader), variants)
    second = next((w for rival in step.ties if (w := _variant_of(entries.get(rival), variants))), None)
    if first is None or second is None:
        return ()
    return propose(
        predictor,
        experiment.observations[name],
        belief,
        first,
        second,
        _strength(first, entries[leader], step.belief),
        report=report,
    )


def _without_last(before: Step, after: Step) -> Belief:
    """The belief of the step before with the numbers that the step after found for what they share."""
    found = {p.key: p for p in after.belief.parameters}
    parameters = tuple(p.found(found.get(p.key, p)) for p in before.belief.parameters)
    return replace(before.belief, parameters=parameters)


def _variant_of(entry: RankedEffect | None, variants: list[EffectVariant]) -> EffectVariant | None:
    """The variant in which an entry has its effect, or the effect's first that came when that did."""
    if entry is None:
        return None
    terms = [term.settings for term in entry.start.terms if term.name == entry.effect]
    borne = all(settings.get("at_rest", True) for settings in terms)
    own = [w for w in variants if w.effect == entry.effect and w.settings.get("at_rest", True) is borne]
    return next((variant for variant in own if variant.label == entry.label), own[0] if own else None)


def _strength(variant: EffectVariant, entry: RankedEffect, belief: Belief) -> np.ndarray:
    """(q,) of the effect, in units of its variant's parameters: as fitted, where those are the model's."""
    keys = [p.key for _, p in variant.columns]
    if len(set(keys)) == len(keys) and all(key in belief for key in keys):
        return np.array([belief[p.key].value - p.value for _, p in variant.columns])
    estimate = np.array(list(entry.estimate.values()))
    return estimate if len(estimate) == len(keys) else np.ones(len(keys))

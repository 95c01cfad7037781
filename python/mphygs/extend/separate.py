"""After the loop: which motion would tell what was found from what the data confuse it with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mphygs.diagnose.next_motion import Proposed, propose
from mphygs.diagnose.ranking import Entry
from mphygs.diagnose.ways import Way, late_ways, smooth_ways
from mphygs.extend.discover import Discovery
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
    ways = smooth_ways(belief, predictor.body, names=asked, hung=hung)
    ways += late_ways(belief, predictor.body, names=asked)
    first = _way_of(entries.get(leader), ways)
    second = next((w for rival in step.ties if (w := _way_of(entries.get(rival), ways))), None)
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


def _way_of(entry: Entry | None, ways: list[Way]) -> Way | None:
    """The way in which an entry has its effect, or the effect's first that came when that did."""
    if entry is None:
        return None
    terms = [term.settings for term in entry.start.terms if term.name == entry.effect]
    borne = all(settings.get("at_rest", True) for settings in terms)
    own = [w for w in ways if w.effect == entry.effect and w.settings.get("at_rest", True) is borne]
    return next((way for way in own if way.label == entry.label), own[0] if own else None)


def _strength(way: Way, entry: Entry, belief: Belief) -> np.ndarray:
    """(q,) of the effect, in units of the way's parameters: as fitted, where those are the model's own."""
    keys = [p.key for _, p in way.columns]
    if len(set(keys)) == len(keys) and all(key in belief for key in keys):
        return np.array([belief[p.key].value - p.value for _, p in way.columns])
    estimate = np.array(list(entry.estimate.values()))
    return estimate if len(estimate) == len(keys) else np.ones(len(keys))

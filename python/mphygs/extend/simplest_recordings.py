"""Several recordings of one object: the simplest are explained first, then the others with what was found.

A recording with a load has the physics of the one without and more. Fitted together from the start, each
spoils what the other says.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from mphygs.extend.step import EXPLAINED, Step
from mphygs.extend.steps import step_at
from mphygs.fit.experiment import Experiment
from mphygs.fit.stiffness_scale import CONTRAST
from mphygs.model.belief import Belief


def sequences_without_loads(experiment: Experiment) -> tuple[str, ...]:
    """Fitted sequences that no known load pulls at, of a file of numbers neither; none where all or no
    sequence is such."""
    recordings = {name: experiment.capture.sequence(name) for name in experiment.fitted}
    simple = tuple(name for name, own in recordings.items() if not (own.loads or own.actuators))
    return simple if len(simple) < len(experiment.fitted) else ()


def explains(step: Step, names: Sequence[str]) -> bool:
    """Whether a step's model explains some sequences."""
    ratios = [value for name in names for value in step.assessment.ratio[name].values()]
    return bool(step.added) and max(ratios) <= EXPLAINED


def compared_on_all(experiment: Experiment, first: Belief, step: Step) -> Step:
    """A step that was found on some sequences, compared on all.

    first: the belief of all sequences, which has what the step's lacks (the release of the others).
    """
    found = {parameter.key: parameter for parameter in step.belief.parameters}
    parameters = []
    for p in first.parameters:
        if p.free and p.key in found:
            if found[p.key].free:
                p = p.found(found[p.key])
            else:
                # what the other recordings alone can tell was fitted with a model that is now another one
                usual = math.exp(p.prior_mean) if p.log else p.prior_mean
                wide = replace(p.widened(), value=usual)
                p = wide if p.widest is None else wide.narrowed(CONTRAST)
        parameters.append(p)
    own = {parameter.key for parameter in first.parameters}
    parameters += [parameter for key, parameter in found.items() if key not in own]
    belief = replace(step.belief, parameters=tuple(parameters))
    whole = step_at(
        experiment,
        belief,
        step.spacing,
        added=step.added,
        ties=step.ties,
        jacobian_spacing=step.jacobian_spacing,
    )
    return replace(whole, window_share=step.window_share, refits=step.refits, dropped=step.dropped)

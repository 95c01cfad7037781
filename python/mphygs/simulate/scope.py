"""What parameters and effects act on: the motion or what is seen of it, all sequences or some, masses whose
weight a known load states already."""

from __future__ import annotations

from dataclasses import replace

from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import effect, effects


def in_scope(belief: Belief, name: str, sequence: str) -> bool:
    """Whether a sequence has an effect of the belief; its term may name "sequences" that alone do."""
    only = belief.term(name).settings.get("sequences")
    return only is None or sequence in only


def belief_of_sequence(belief: Belief, sequence: str) -> Belief:
    """The belief as one sequence has it: effects of other sequences alone are at their null."""
    absent = [t.name for t in belief.terms if not in_scope(belief, t.name, sequence)]
    if not absent:
        return belief
    nulls = {f"{name}.{p.name}": p.null for name in absent for p in effect(name).parameters}
    return replace(
        belief,
        parameters=tuple(
            replace(p, value=nulls[p.key], log=False, lower=min(p.lower, nulls[p.key]))
            if p.key in nulls
            else p
            for p in belief.parameters
        ),
    )


def is_absent(owner: Belief, parameter: Parameter, sequence: str) -> bool:
    """Whether a parameter belongs to an effect that the sequence does not have."""
    name = parameter.key.rsplit(".", 1)[0]
    return name in effects() and name in owner.effects and not in_scope(owner, name, sequence)


def stated_weights(belief: Belief) -> tuple[str, ...]:
    """Names of the belief's point masses whose weight is among the sequence's known loads ("weight": False
    in the term's settings): they bring their inertia alone."""
    return tuple(
        t.name for t in belief.terms if effect(t.name).site == "mass" and not t.settings.get("weight", True)
    )


def moves_targets(parameter: Parameter) -> bool:
    """Whether a parameter changes where the measurement says that markers are: a fault of it."""
    try:
        return effect(parameter.key.rsplit(".", 1)[0]).fault
    except KeyError:
        return False


def acts_in_simulation(parameter: Parameter) -> bool:
    """Whether a parameter changes the motion; the others change what is seen of it, or when it starts."""
    owner = parameter.key.rsplit(".", 1)[0]
    if parameter.key.endswith(".release_shift"):
        return False
    try:
        return not effect(owner).fault
    except KeyError:
        return True

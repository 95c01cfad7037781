"""Parameters whose derivatives one run of the core computes together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import core_parameter_nulls, core_parameter_offsets, effect, effects
from mphygs.simulate.body import Body
from mphygs.simulate.core_runs import Apart
from mphygs.simulate.fields import core_effects, core_inputs, places

Owned = tuple[Belief, Parameter]

# Where an effect is evaluated at every point, with derivatives; directions that one evaluation carries.
DEAR, PAIR = ("volume", "surface"), 2
# Effects of which a direction may have its own, at their null, where the transfer knows of such: their forces
# are seen along a motion that they do not change, so that they share runs whatever their constants.
APART = (*DEAR, "body")


@dataclass(frozen=True, eq=False)
class Batch:
    """members: indices of the parameters; active: core effects; spots: (K, 3) places [m]; fields: values
    that all of them share; directions: change of the fields for each; apart: effects that a direction alone
    has, None for none."""

    members: tuple[int, ...]
    active: tuple[str, ...]
    spots: np.ndarray
    fields: dict[str, np.ndarray]
    directions: list[dict[str, np.ndarray]]
    apart: list[Apart | None]


def batches_of(
    belief: Belief,
    body: Body,
    base: dict[str, np.ndarray],
    owned: Sequence[Owned],
    changes: Sequence[dict[str, np.ndarray]],
    *,
    largest: int,
    apart: bool = False,
) -> list[Batch]:
    """Share parameters out to as few runs as there can be, alike in size: whoever runs them, the same bits.

    Unless they are kept apart, an effect of the volume or the surface that an owner adds costs every two
    directions of its run as much as several of them: such parameters share runs of two with each other.

    base: fields of the belief; owned: parameters, each with the belief that has it: this one plus effects at
    their null; changes: of the fields by each; largest: parameters to a run; apart: whether a direction may
    have effects of the volume, the surface and the body that the run has not.
    """
    own = set(core_effects(belief))
    brought = [set(core_effects(owner)) - own for owner, _ in owned]
    alone = [{name for name in names if apart and effect(name).site in APART} for names in brought]
    added = [frozenset(names - theirs) for names, theirs in zip(brought, alone, strict=True)]
    dear = [any(known.site in DEAR for known in map(effect, names)) for names in added]
    light = max(len(owned) - sum(dear), 1)
    size = -(-light // -(-light // largest))
    # Parameters that need the same effects share a run; others do not pay the rest of an effect's cost. Those
    # come first of which there are most owners: no two of them may be able to share a run.
    owners_of: dict[frozenset[str], set[int]] = {}
    for (owner, _), names in zip(owned, added, strict=True):
        owners_of.setdefault(names, set()).add(id(owner) if names else 0)
    rank = [(dear[i], -len(owners_of[names]), sorted(names)) for i, names in enumerate(added)]
    order = sorted(range(len(owned)), key=rank.__getitem__)
    sizes = [min(PAIR, largest) if is_dear else size for is_dear in dear]
    found = []
    for members in _together(order, added, [owner for owner, _ in owned], body, sizes):
        owners = [owned[i][0] for i in members]
        active = tuple(sorted(own.union(*(added[i] for i in members))))
        shared = [added[i] for i in members]
        spots, fields, directions = _merged(belief, body, base, owners, shared, [changes[i] for i in members])
        theirs = [
            (sorted(alone[i]), core_inputs(owned[i][0], body)["effect"]) if alone[i] else None
            for i in members
        ]
        found.append(Batch(members, active, spots, fields, directions, theirs))
    return found


def _together(
    order: Sequence[int],
    added: Sequence[frozenset[str]],
    owners: Sequence[Belief],
    body: Body,
    sizes: Sequence[int],
) -> list[tuple[int, ...]]:
    """Members of each run. added: effects that each adds to its run; sizes: of the runs that each may be in;
    others it does not join.

    A run has one value of every constant: owners of one effect with unlike ones (a frequency, a phase, a
    relaxation time) never share it.
    """
    constants: dict[int, np.ndarray] = {}
    members: list[list[int]] = []
    largest: list[int] = []
    brought: list[np.ndarray] = []
    for i in order:
        own = constants.setdefault(id(owners[i]), _brought(added[i], owners[i], body))
        for k, there in enumerate(brought):
            both = np.isfinite(own) & np.isfinite(there)
            room = len(members[k]) < largest[k] == sizes[i]
            if room and np.array_equal(own[both], there[both]):
                break
        else:
            members.append([])
            largest.append(sizes[i])
            brought.append(np.full(own.shape, np.nan))
            k = len(members) - 1
        members[k].append(i)
        brought[k] = np.where(np.isfinite(own), own, brought[k])
    return [tuple(group) for group in members]


def _brought(added: frozenset[str], owner: Belief, body: Body) -> np.ndarray:
    """All core parameters, NaN but for those of effects that the owner adds."""
    values = np.full(len(core_parameter_nulls()), np.nan)
    offsets, known = core_parameter_offsets(), effects()
    for name in added:
        if name in offsets:
            place = slice(offsets[name], offsets[name] + len(known[name].parameters))
            values[place] = core_inputs(owner, body)["effect"][place]
    return values


def _merged(
    belief: Belief,
    body: Body,
    base: dict[str, np.ndarray],
    owners: Sequence[Belief],
    added: Sequence[frozenset[str]],
    changes: Sequence[dict[str, np.ndarray]],
) -> tuple[np.ndarray, dict[str, np.ndarray], list[dict[str, np.ndarray]]]:
    """Places, fields and directions of one batch whose owners add effects (at places of their own)."""
    spots = places(belief)
    merged = dict(base)
    nulls = np.array(core_parameter_nulls())
    own, masses, points = [spots], [base["place_mass"]], [base["place_effect"]]
    slots = []
    count = len(spots)
    for owner, names in zip(owners, added, strict=True):
        fields = core_inputs(owner, body)
        # An effect that only this owner has brings its constants (directions, shapes) along.
        constants = _brought(names, owner, body)
        differs = np.isfinite(constants) & (constants != base["effect"]) & (base["effect"] == nulls)
        merged["effect"] = np.where(differs, constants, merged["effect"])
        extra = places(owner)[len(spots) :]
        slots.append((count, len(extra)))
        own.append(extra)
        masses.append(fields["place_mass"][len(spots) :])
        points.append(fields["place_effect"][len(spots) :])
        count += len(extra)
    merged["place_mass"], merged["place_effect"] = np.concatenate(masses), np.concatenate(points)
    directions = []
    for (begin, extra), change in zip(slots, changes, strict=True):
        moved = dict(change)
        for name in ("place_mass", "place_effect"):
            if name in moved:
                full = np.zeros_like(merged[name])
                full[: len(spots)] = moved[name][: len(spots)]
                full[begin : begin + extra] = moved[name][len(spots) :]
                moved[name] = full
        directions.append(moved)
    return np.concatenate(own), merged, directions

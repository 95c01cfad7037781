"""What a loop has come to: its verdict, and the effects that it rests on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from mphygs.capture.track_faults.tracks import Finding
from mphygs.compare.roughness import doubted_sigma
from mphygs.diagnose.ranking import Ranking
from mphygs.extend.candidate_table import Row
from mphygs.extend.seen_faults import fault_lines, fault_names
from mphygs.extend.step import Step
from mphygs.model.registry import effect

# So much of the noise or less in every range says that the noise is stated too large.
FAR_LESS = 0.5


@dataclass(frozen=True, eq=False)
class Discovery:
    """verdict: adequate, missing, unknown or measurement; effects: concluded, most certain first; table: the
    candidates of the first round (see `candidate_rows`), empty where there was none."""

    verdict: str
    effects: tuple[str, ...]
    steps: tuple[Step, ...]
    rankings: tuple[Ranking, ...]
    warnings: tuple[str, ...] = field(default_factory=tuple)
    table: tuple[Row, ...] = ()


def conclude(
    steps: list[Step],
    rankings: list[Ranking],
    warnings: list[str],
    faults: Mapping[str, Sequence[Finding]] = MappingProxyType({}),
    *,
    final: bool = True,
    unsure: Sequence[str] = (),
) -> Discovery:
    """What the steps come to; faults: that the measurement showed by itself; final: with what is to be said
    of the last one; unsure: effects of its model of which no number is determined: nothing that is concluded
    rests on them."""
    last = steps[-1]
    added: list[str] = []
    for step in steps:
        added += [name for name in step.added if name not in added]
        added = [name for name in added if name not in step.dropped]
    told = [text for step in steps for text in step.warnings]
    told += [f"{n}: in the model, but the data determine none of its numbers" for n in added if n in unsure]
    doubtful = any(name in unsure for name in added)
    added += [name for name in fault_names(faults) if name not in added]
    if not last.explained or doubtful:
        verdict, added = "unknown", []
    elif not added:
        verdict = "adequate"
    else:
        verdict = "missing" if any(effect(n).kind != "measurement" for n in added) else "measurement"
    if not final:
        return Discovery(verdict, tuple(added), tuple(steps), tuple(rankings), (*told, *warnings))
    came = fault_lines(faults)
    came += [
        f"{term.name}: acts since the first frame; the published shape does not bear it"
        for term in last.belief.terms
        if term.name in added and term.settings.get("at_rest") is False and "sequences" not in term.settings
    ]
    worst = last.assessment.worst
    if worst < FAR_LESS:
        came.append(
            f"no range leaves more than {worst:.2g} of the noise: sigma may be {1.0 / max(worst, 1e-3):.2g} "
            "times too large, and hide what is missing"
        )
    came += doubted_sigma(last.compared)
    return Discovery(verdict, tuple(added), tuple(steps), tuple(rankings), (*told, *warnings, *came))

"""A diagnosis as JSON and as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mphygs.diagnose.next_motion import Proposed
from mphygs.diagnose.ranking import LEVEL, RankedEffect, Ranking
from mphygs.model.registry import effects

SHOWN = 8


def ranking_document(
    ranking: Ranking,
    sigma: float,
    *,
    refitted: Mapping[str, float] | None = None,
    ties: Mapping[str, Sequence[str]] | None = None,
) -> list[dict[str, object]]:
    """Candidates, the best first. sigma: of one coordinate of the markers [m].

    refitted: effects that were really put into the model, the best first, with the actual fall of chi^2: they
    come before those that were only scored; ties: effects that refits could not tell from an effect.
    """
    actual, alike = refitted or {}, ties or {}
    order = list(actual)
    entries = sorted(
        ranking.entries, key=lambda e: order.index(e.effect) if e.effect in actual else len(order)
    )
    return [
        {
            "effect": entry.effect,
            "kind": entry.kind,
            "statistic": entry.statistic,
            "p_value": entry.p_value,
            "expected_rms": entry.expected_ratio * sigma * np.sqrt(3.0),
            "estimate": _estimate(entry),
            "confounded_with": list(dict.fromkeys([*alike.get(entry.effect, ()), *entry.confounded_with])),
            "std": {name: std for name, std in entry.std.items() if name in _own(entry)},
            "way": entry.label,
            "reason": entry.reason,
            "detectable": dict(entry.detectable),
            "where": [spot.document() for spot in entry.spots],
            "refitted": actual.get(entry.effect),
            "stands_out": entry.stands_out,
        }
        for entry in entries
    ]


def _own(entry: RankedEffect) -> dict[str, float]:
    """The parameters of an entry's effect, as the model has them that a refit begins with."""
    owner = f"{entry.effect}."
    return {p.key.removeprefix(owner): p.value for p in entry.start.parameters if p.key.startswith(owner)}


def _estimate(entry: RankedEffect) -> dict[str, float]:
    """All numbers that make the effect: what was estimated, and at what (a frequency, a flow).

    By the public names of the parameters: the columns of a score may be several to one (a sine and a cosine).
    """
    own = _own(entry)
    return own | {name: value for name, value in entry.estimate.items() if name in own}


def advice(
    verdict: str,
    found: Sequence[str],
    ranking: Sequence[Mapping[str, object]],
    warnings: Sequence[str],
    *,
    motions: Sequence[Proposed] = (),
) -> str:
    """What to do next, in words. motions: to record, where the first effect has a rival, the best first."""
    lines = []
    if verdict == "adequate":
        lines.append("Nothing needs to be added: the misfit is noise and the discretisation's share.")
    elif verdict == "missing":
        lines.append(f"Add {', '.join(found)} (mphygs extend).")
    elif verdict == "measurement":
        lines.append(f"Correct the measurement for {', '.join(found)}, or record again.")
    else:
        lines.append("No known effect brings the error to the noise.")
        lines.append("Look at where and when the model fails (mphygs compare).")
    ties = {e["effect"]: e["confounded_with"] for e in ranking if e["effect"] in found}
    for name, others in ties.items():
        if not others:
            continue
        told = "record another one, with another amplitude, frequency or direction of gravity, and fit both"
        if motions and name == found[0]:
            told = (
                f"record another one and fit both; best of {len(motions)} that were simulated: "
                f"{motions[0].motion} (chi^2 would tell them apart by {motions[0].separation:.0f})"
            )
        lines.append(f"This motion does not tell {name} from {', '.join(others)}: {told}.")
    return " ".join([*lines, *(f"Warning: {line}." for line in warnings)])


def diagnosis_text(document: Mapping[str, object]) -> list[str]:
    """Lines for people: the verdict, its reasons, the advice."""
    effects = ", ".join(document["effects"]) or "none"
    lines = [f"verdict: {document['verdict']}; effects: {effects}", ""]
    for entry in document["ranking"][:SHOWN]:
        numbers = ", ".join(f"{k} {v:.4g}" for k, v in entry["estimate"].items())
        lines.append(
            f"  {entry['way']}: chi^2 would fall by {entry['statistic']:.1f}, p {entry['p_value']:.2g}, "
            f"rms would be {1e3 * entry['expected_rms']:.3f} mm ({numbers})"
            + (f"; refitted: falls by {entry['refitted']:.1f}" if entry["refitted"] is not None else "")
        )
    lines += spot_lines(document)
    unseen = [
        entry
        for entry in document["ranking"]
        if entry["p_value"] > LEVEL and entry["effect"] not in document["effects"] and seen_from(entry)
    ]
    if unseen:
        lines += ["", "not found, and would have been found from this far off their null:"]
        lines += [f"  {entry['effect']}: {seen_from(entry)}" for entry in unseen]
    return [*lines, "", document["advice"]]


def spot_lines(document: Mapping[str, object]) -> list[str]:
    """Where and when the effect that a diagnosis names first is wanted, or the first of a ranking that names
    none, and what would have to drift; nothing of a model that needs nothing."""
    lines = []
    if document["verdict"] == "adequate":
        return lines
    ranking, named = document["ranking"], document["effects"][:1]
    leading = next((entry for entry in ranking if entry["effect"] in named), next(iter(ranking), {}))
    if leading.get("where"):
        lines += ["", f"{leading['effect']} is wanted most in", *map(_spot_text, leading["where"])]
    if document.get("drift"):
        lines += ["", "these fitted numbers would have to drift:", *map(_spot_text, document["drift"])]
    return lines


def _spot_text(spot: Mapping[str, object]) -> str:
    first, last = spot["frames"]
    place = f"{spot['part']}, frames {first} to {last - 1} of {spot['sequence']}"
    return f"  {place}: {spot['parameter']}, z {spot['z']:.1f}"


def seen_from(entry: Mapping[str, object]) -> str:
    """From which size of each parameter alone an effect of a ranking would have been found, with units.

    Empty where that is not known.
    """
    sizes = entry.get("detectable")
    if not isinstance(sizes, Mapping):  # an older diagnosis
        return ""
    known = effects().get(str(entry["effect"]))  # none where a plugin's is not named
    units = {} if known is None else {p.name: p.unit for p in known.parameters}
    told = []
    for name, size in sizes.items():
        unit = units.get(name, "-")
        told.append(f"{name} {size:.3g}" + ("" if unit == "-" else f" {unit}"))
    return ", ".join(told)

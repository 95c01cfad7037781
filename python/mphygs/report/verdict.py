"""A run in a sentence, and in a few numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from mphygs.compare.assess import in_words

Errors = Mapping[str, Mapping[str, Mapping[str, float] | None]]


def pooled(sequences: Errors, label: str) -> float | None:
    """Root mean square over the noise of all points in a range ("fit", "predict"); None without any."""
    found = [ranges.get(label) for ranges in sequences.values()]
    known = [e for e in found if e and e.get("count") and e.get("rms_over_sigma") is not None]
    count = sum(e["count"] for e in known)
    return math.sqrt(sum(e["count"] * e["rms_over_sigma"] ** 2 for e in known) / count) if count else None


def concluded(
    comparison: Mapping[str, object],
    steps: Mapping[str, object] | None,
    diagnosis: Mapping[str, object] | None,
) -> tuple[str, Sequence[str]]:
    """Verdict and effects: of the loop, else of a diagnosis, else whether the model is enough, or
    "not diagnosed"."""
    for found in (steps, diagnosis):
        if found is not None and found.get("verdict"):
            return str(found["verdict"]), list(found.get("effects", ()))
    return ("adequate" if comparison["adequate"] else "not diagnosed"), []


def verdict_sentence(
    name: str,
    comparison: Mapping[str, object],
    steps: Mapping[str, object] | None,
    diagnosis: Mapping[str, object] | None,
) -> str:
    """What was found, in plain words. name: of the capture."""
    verdict, effects = concluded(comparison, steps, diagnosis)
    told, added = ", ".join(effects), len((steps or {}).get("steps", ())) > 1
    if verdict == "adequate":
        lead = f"Nothing is missing from the model of {name}"
    elif verdict == "missing" and effects:
        lead = f"{name} moves with {told}"
        lead += ", which its model had lacked" if added else ", which this model lacks"
    elif verdict == "measurement" and effects:
        lead = f"The measurement of {name} is at fault: {told}"
        lead += ", corrected for here" if added else ""
    elif verdict == "unknown":
        lead = f"No known effect explains all of how {name} moves"
    else:
        lead = f"The misfit of {name} is {in_words(comparison['adequate'], comparison['p_value'])}"
    return f"{lead}: {_errors(comparison['sequences'], steps if added else None)}."


def _errors(now: Errors, steps: Mapping[str, object] | None) -> str:
    before = {} if steps is None else steps["steps"][0]["sequences"]
    pieces = []
    for label, words in (("fit", "on fitted frames"), ("predict", "on frames that no fit has seen")):
        here, there = pooled(now, label), pooled(before, label)
        if here is not None:
            pieces.append((f"from {there:.2f} to {here:.2f}" if there is not None else f"{here:.2f}", words))
    if not pieces:
        return "nothing was measured in the frames to compare"
    verb = "the error falls " if steps is not None else "the error is "
    first = f"{verb}{pieces[0][0]} times the noise {pieces[0][1]}"
    return first + "".join(f", {text} {words}" for text, words in pieces[1:])


def tiles(comparison: Mapping[str, object], steps: Mapping[str, object] | None) -> list[tuple[str, str]]:
    """(number, what it is)."""
    found = []
    for label, words in (("fit", "times the noise, fitted"), ("predict", "times the noise, unseen")):
        value = pooled(comparison["sequences"], label)
        if value is not None:
            found.append((f"{value:.2f}", words))
    found.append((f"{comparison['p_value']:.2g}", "p of a misfit this large"))
    found.append((f"{1e3 * comparison['budget']['physics']:.3g} mm", "left to the model"))
    if steps is not None and len(steps["steps"]) > 1:
        found.append((str(len(steps["steps"])), "models on the way"))
    return found

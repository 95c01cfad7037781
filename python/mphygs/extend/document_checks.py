"""What commands wrote of their findings into a run folder, looked at before it is used: anybody may have
changed it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from mphygs.capture.document import Entry, read_document
from mphygs.capture.patterns import (
    FRAMES,
    by_name,
    count,
    many,
    maybe,
    number,
    one_of,
    record,
    sentence,
    size,
)
from mphygs.capture.record import Capture
from mphygs.diagnose.force_readings import WORDS
from mphygs.diagnose.missing_force_document import PLUGIN
from mphygs.fit.belief_document import belief_from_document
from mphygs.fit.run_checks import check_belief_document
from mphygs.fit.spacings import check_spacing
from mphygs.model.registry import effects

_VERDICT = one_of(("adequate", "missing", "unknown", "measurement"))
_NAMES = many(Entry.name)
_KIND = one_of(("smooth", "threshold", "measurement"))


def _belief(entry: Entry) -> None:
    """A model of which another command goes on."""
    check_belief_document(entry)
    try:
        belief_from_document(entry.table())
    except ValueError as error:
        raise entry.fault(str(error), "a model as it is written") from error


def _length(entry: Entry) -> None:
    if not entry.number() > 0.0:
        raise entry.wrong("a length above zero [m]")


def _effect(entry: Entry) -> None:
    """The name of an effect, known here."""
    if entry.name() not in effects():
        raise entry.fault(
            f'the effect "{entry.value}" is not known here',
            "--plugin FILE with the Python file that registers it",
        )


def _row(entry: Entry) -> None:
    """A candidate of a round of the loop."""
    record(
        {
            "effect": Entry.name,
            "kind": _KIND,
            "predicted_drop": number,
            "drop": maybe(number),
            "gain": maybe(number),
            "gain_se": maybe(number),
            "numbers": count,
            "estimate": by_name(number),
            "std": by_name(number),
            "ties": _NAMES,
            "struck": maybe(sentence),
        }
    )(entry)
    if entry["gain"].value is not None:
        number(entry["gain_se"])


# A standard error, null where none is known.
_STD = maybe(size)
_ERROR = record({"rms": size, "max": size, "rms_over_sigma": size, "count": count})
_PARAMETER = record(
    {"value": number, "std": _STD, "unit": sentence, "determined": Entry.flag},
    {
        "note": sentence,
        "interval": many(number, least=2, most=2),
        "bound": record({}, {"lower": number, "upper": number}),
    },
)
_TOLD = {
    "effects": _NAMES,
    "added": _NAMES,
    "ties": _NAMES,
    "sequences": by_name(by_name(maybe(_ERROR))),
    "adequate": Entry.flag,
    "p_value": maybe(number),
    "parameters": by_name(_PARAMETER),
}
_STEP = record(_TOLD, {"grid": maybe(number), "by": maybe(sentence), "table": many(_row), "pays": Entry.flag})
_PATH = record(
    {
        "model": _NAMES,
        "added": _NAMES,
        "adequate": Entry.flag,
        "p_value": maybe(number),
        **dict.fromkeys(("fitted", "unseen", "grid", "fitted_fall", "unseen_fall"), maybe(number)),
    }
)
_SPOT = record(
    {"sequence": Entry.name, "part": Entry.name, "frames": FRAMES, "parameter": Entry.name, "z": number}
)
_CANDIDATE = {
    "effect": Entry.name,
    "kind": _KIND,
    "statistic": number,
    "p_value": number,
    "estimate": by_name(number),
    "confounded_with": _NAMES,
}
_MORE = {
    "expected_rms": number,
    "way": sentence,
    "refitted": maybe(number),
    "std": by_name(_STD),
    "reason": sentence,
    "detectable": by_name(number),
    "where": many(_SPOT),
    "stands_out": maybe(number),
}
# Of a candidate, what is printed as well when a command goes on.
_PRINTED = ("way", "refitted", "expected_rms")
_FORCE = record(
    {
        "rms": number,
        "direction": many(number, least=3, most=3),
        "where": many(record({"part": Entry.name, "rms": number, "share": number}), least=1),
        "when": many(record({"sequence": Entry.name, "frames": FRAMES, "rms": number}), least=1),
        "formula": maybe(sentence),
        "nature": many(one_of(WORDS)),
        "terms": many(
            record(
                {
                    "expression": sentence,
                    "coefficient": number,
                    "std": number,
                    "unit": sentence,
                    "stability": number,
                    "alike": many(sentence),
                }
            )
        ),
        "unstable": many(record({"expression": sentence, "stability": number})),
        "sigma": record({"without": number, "with": number}),
        "plugin": maybe(one_of((PLUGIN,))),
    },
    {"untold": maybe(sentence)},
)
_DIAGNOSIS = record(
    {"verdict": _VERDICT, "effects": _NAMES, "ranking": many(record(_CANDIDATE, _MORE)), "advice": sentence},
    {"missing_force": maybe(_FORCE), "drift": many(_SPOT), "table": many(_row), "path": many(_PATH)},
)
_STATE = record(
    {
        "belief": _belief,
        "spacing": _length,
        "jacobian_spacing": maybe(_length),
        "refined": Entry.flag,
        "refinement_spacing": maybe(_length),
        "moved": by_name(number),
        "coarse_belief": maybe(_belief),
        "window_share": lambda entry: entry.within(0.0, 1.0, "a share"),
        "reconciled": Entry.flag,
        "warnings": many(sentence),
    },
    {"stays": Entry.flag, "persists": Entry.flag, "excess_beyond": maybe(size)},
)
_RANKING = record(
    {
        "chi_square": size,
        "rows": count,
        "entries": many(
            record(
                {
                    "effect": _effect,
                    "label": sentence,
                    "kind": _KIND,
                    "statistic": number,
                    "p_value": number,
                    "expected_ratio": number,
                    "estimate": by_name(number),
                    "std": by_name(_STD),
                    "start": _belief,
                }
            )
        ),
    }
)
_ANSWER = {"effects": _NAMES, "run": sentence}
_STEPS = record(
    {"steps": many(_STEP)},
    {
        "verdict": _VERDICT,
        **_ANSWER,
        "states": many(_STATE),
        "ranking": maybe(many(record(_CANDIDATE | {key: _MORE[key] for key in _PRINTED}, _MORE))),
        "drift": many(_SPOT),
        "left_out": by_name(many(FRAMES)),
        "candidates": maybe(sentence),
        "rankings": many(_RANKING),
        "asked": _NAMES,
        "warnings": many(sentence),
        "table": many(_row),
        "path": many(_PATH),
        "missing_force": maybe(_FORCE),
    },
)


def read_diagnosis(path: Path) -> dict | None:
    """The diagnosis in a file, None where there is none. Raises CaptureError where it is none as it is
    written."""
    if not path.is_file():
        return None
    root = read_document(path)
    _DIAGNOSIS(root)
    return root.table()


def read_steps(path: Path) -> dict | None:
    """The same for the steps of a loop, as far as it has come."""
    if not path.is_file():
        return None
    root = read_document(path)
    _STEPS(root)
    if root.get("verdict") is not None:
        record(_ANSWER)(root)
    states, steps = root.get("states"), root["steps"]
    if states is not None and len(states.elements()) != len(steps.elements()):
        raise states.fault(
            f"has {len(states.elements())} entries", f"{len(steps.elements())}, one for each step"
        )
    return root.table()


def check_models(file: str | Path, states: Sequence[Mapping], capture: Capture) -> None:
    """Raises ValueError where the models of steps, read from a file, are not of a capture's parts, or on
    grids that are too fine for it."""
    expected = [part.name for part in capture.parts]
    for k, state in enumerate(states):
        where = f"{file}: states[{k}]"
        for key in ("spacing", "jacobian_spacing", "refinement_spacing"):
            if state[key] is not None:
                check_spacing(capture, state[key], f"{where}.{key}")
        for key in ("belief", "coarse_belief"):
            if state[key] is not None and state[key]["parts"] != expected:
                found = ", ".join(state[key]["parts"])
                raise ValueError(f"{where}.{key}: has parts {found}; expected {', '.join(expected)}")


def check_known(path: Path) -> None:
    """Raises CaptureError where steps in a file name an effect that is not known here."""
    for step in read_document(path)["steps"].elements():
        for key in ("effects", "added", "ties"):
            many(_effect)(step[key])

"""What a run's document must hold: anybody may have written it, so every value is looked at before use."""

from __future__ import annotations

import numpy as np

from mphygs.capture.document import Entry
from mphygs.model.belief import PRESTRESS_MODES
from mphygs.model.registry import effects, laws
from mphygs.simulate.settings import INTEGRATORS, TRANSFERS

# Of materials, far beyond what any fit finds: outside, a simulation ends nowhere.
_MATERIALS = {"youngs_modulus": (1.0, 1e12), "density": (0.1, 1e5), "poissons_ratio": (-1e-9, 0.4999)}
_BUDGETS = (1 << 20, 1 << 40)  # bytes
_LONGEST_SEED = 1 << 64
_GRAVITY = 300.0  # m/s^2
_LARGEST_FACTOR = 1e100  # room for products


def check_run_document(root: Entry) -> None:
    """Raises CaptureError, one line with file, key, value and what was expected, at the first value that no
    run has; where an effect of the model is not known, it says how to give it."""
    options = root["options"]
    options.table()
    for _, option in options.children():
        _check_option(option)
    for _, version in root["versions"].children():
        version.text()
    seed = root["seed"]
    if not 0 <= seed.integer() < _LONGEST_SEED:
        raise seed.wrong("a whole number, zero or more")
    for key in ("capture", "digest", *(("stages",) if root.get("stages") else ())):
        root[key].name()
    root["transfer"].choice(TRANSFERS)
    _check_settings(root["settings"])
    ranges = root["ranges"]
    if not ranges.table():
        raise ranges.fault("is empty", "the frames fitted of at least one sequence")
    for _, frames in ranges.children():
        _check_pair(frames)
    plugin = options.get("plugin")
    for key in ("start", "belief", *(("earlier",) if root.value.get("earlier") is not None else ())):
        check_belief_document(root[key], plugin=None if plugin is None else plugin.value)
    for stage in root["history"].elements():
        _check_stage(stage)
    for _, sequence in root["left_out"].children():
        for entry in sequence.elements():
            _check_pair(entry)
    if limits := root.get("limits"):
        check_limits(limits)
    if root["answer"].value is not None:
        root["answer"].table()
    root["complete"].flag()


def check_belief_document(entry: Entry, *, plugin: object = None) -> None:
    """The same for the document of a belief. plugin: what the run says of the file of its own effects."""
    parts = [part.name() for part in entry["parts"].elements()]
    gravity = entry["gravity"].array((3,))
    if not np.abs(gravity).max() <= _GRAVITY or np.linalg.norm(gravity) > _GRAVITY:
        raise entry["gravity"].fault("is too strong", f"at most {_GRAVITY:g} m/s^2")
    parameters = {}
    for parameter in entry["parameters"].elements():
        _check_parameter(parameter)
        parameters[parameter["key"].value] = parameter["value"]
    for part in parts:
        for name, (low, high) in _MATERIALS.items():
            value = parameters.get(f"{part}.{name}")
            if value is None:
                raise entry["parameters"].fault(f"has no {part}.{name}", "every material of every part")
            if not low <= value.value <= high:
                raise value.wrong(f"a {name} from {low:g} to {high:g}")
    known = effects()
    for term in entry["terms"].elements():
        name = term["name"].name()
        if name not in known:
            made_with = f" (it was made with {plugin})" if isinstance(plugin, str) else ""
            raise term["name"].fault(
                f'the effect "{name}" is not known here',
                f"--plugin FILE with the Python file that registers it{made_with}",
            )
        for p in known[name].parameters:
            value = parameters.get(f"{name}.{p.name}")
            if value is not None and not p.lower <= value.value <= p.upper:
                raise value.wrong(f"a {name}.{p.name} from {p.lower:g} to {p.upper:g} {p.unit}")
        _check_term(term["settings"], parts)
    entry["prestress"].choice(PRESTRESS_MODES)
    entry["law"].choice(laws())
    if entry["known_mass"].value is not None and not entry["known_mass"].number() > 0:
        raise entry["known_mass"].wrong("a mass above zero [kg]")
    if likenesses := entry.get("likenesses"):
        for likeness in likenesses.elements():
            keys = [key.name() for key in likeness["keys"].elements()]
            likeness["coefficients"].array((len(keys),))
            likeness["std"].number()


def check_limits(entry: Entry) -> None:
    """The same for what is known of how far numbers can be moved, by their keys."""
    for _, limit in entry.children():
        for side in ("soft", "stiff"):
            if limit[side].value is not None and not 0.0 < limit[side].number() < _LARGEST_FACTOR:
                raise limit[side].wrong("a factor above zero")
        for key in ("phases", "leaps", "weak"):
            limit[key].flag()
        limit["null"].within(-_LARGEST_FACTOR, _LARGEST_FACTOR, "a number")


def _check_parameter(entry: Entry) -> None:
    entry.check_keys(
        required=("key", "value", "unit", "log", "free", "prior_mean", "scale"),
        optional=("lower", "upper", "prior_std", "widest"),
    )
    entry["key"].name()
    entry["value"].number()
    if not isinstance(entry["unit"].value, str):
        raise entry["unit"].wrong("a text")
    for key in ("log", "free"):
        entry[key].flag()
    entry["prior_mean"].number()
    for key in ("lower", "upper"):
        if entry.get(key):
            entry[key].number()
    for key in ("scale", "prior_std"):
        if (given := entry.get(key)) and not given.number() > 0:
            raise given.wrong("a number above zero")
    if widest := entry.get("widest"):
        widest.array((2,))


def _check_term(settings: Entry, parts: list[str]) -> None:
    """The constants of an effect: a place and an axis, a part, sequences and a law by name, switches."""
    settings.table()
    for key, value in settings.children():
        if key in ("place", "axis"):
            value.array((3,))
        elif key == "part":
            if value.text() not in parts:
                raise value.wrong(f"one of {', '.join(parts)}")
        elif key == "instead_of":
            value.choice(laws())
        elif isinstance(value.value, list):
            # names of sequences, or how surely a place is known along each axis
            for item in value.elements():
                if not isinstance(item.value, bool | float | int):
                    item.name()
        elif not isinstance(value.value, bool):
            value.number()


def _check_settings(entry: Entry) -> None:
    entry.check_keys(required=("spacing", "safety", "dtype", "memory_budget"), optional=("integrator",))
    if entry.get("integrator"):
        entry["integrator"].choice(INTEGRATORS)
    if not 0.0 < entry["spacing"].number():
        raise entry["spacing"].wrong("a length above zero [m]")
    if not 0.0 < entry["safety"].number() <= 1.0:
        raise entry["safety"].wrong("a share above 0, at most 1")
    entry["dtype"].choice(("float32", "float64"))
    low, high = _BUDGETS
    if not low <= entry["memory_budget"].integer() <= high:
        raise entry["memory_budget"].wrong(f"{low} to {high} bytes")


def _check_stage(entry: Entry) -> None:
    entry.check_keys(
        required=("name", "spacing", "costs", "converged", "reason", "seconds"), optional=("misfit",)
    )
    for key in ("name", "reason"):
        entry[key].text()
    for key in ("spacing", "seconds", *(("misfit",) if entry.get("misfit") else ())):
        entry[key].number()
    for cost in entry["costs"].elements():
        cost.number()
    entry["converged"].flag()


def _check_pair(entry: Entry) -> None:
    """Two whole numbers, zero or more."""
    items = entry.elements()
    if len(items) != 2 or not all(0 <= item.integer() for item in items):
        raise entry.wrong("two whole numbers, zero or more")


def _check_option(entry: Entry) -> None:
    """An option as it was given: a word, a number, a switch, nothing, or several words."""
    if entry.value is None or isinstance(entry.value, bool):
        return
    if isinstance(entry.value, list):
        for item in entry.elements():
            item.name()
    elif isinstance(entry.value, str):
        if entry.value:
            entry.name()
    else:
        entry.number()

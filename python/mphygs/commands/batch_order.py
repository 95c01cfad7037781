"""The runs that a batch comes to: a command line for each of them."""

from __future__ import annotations

import contextlib
import io
from dataclasses import fields, replace
from pathlib import Path

from mphygs.batch.order import Order
from mphygs.batch.work import Task
from mphygs.commands.command_table import COMMANDS, module_of
from mphygs.commands.options import CommonOptions, OptionError, read_options, split_names
from mphygs.fit.run import folder_name

# Folder of what the runs say while they work.
LOGS = "logs"
# A folder on a line that is read for its options alone.
_ANY = "folder"


def options_of(command: str) -> type[CommonOptions]:
    """The options of a command that is run on a capture or a run. Raises OptionError for another one."""
    found = _options(command) if command in COMMANDS else None
    if found is None:
        able = ", ".join(name for name in COMMANDS if _options(name) is not None)
        raise OptionError(f"--command: got '{command}'; expected one of {able}")
    return found


def _options(command: str) -> type[CommonOptions] | None:
    """The options of a command, None where it is not for a batch."""
    found = getattr(module_of(command), f"{command.capitalize()}Options")
    takes = {f.name for f in fields(found)}
    # what serves at a port does not end by itself
    return found if takes & {"capture", "run"} and "port" not in takes else None


def tasks_of(order: Order, options_type: type[CommonOptions], out: Path) -> list[Task]:
    """The runs of an order, in the order of its folders, then effects, then seeds. Raises OptionError."""
    takes = {f.name for f in fields(options_type)}
    own_folder = "out" in takes and ("capture" in _first(options_type) or "resume" in takes)
    _check(order, options_type, takes, own_folder)
    taken = {LOGS, "batch.json", "summary.csv", "summary.html"}
    tasks = []
    for folder in order.folders:
        label = _unused(folder_name((Path(order.place) / folder).resolve().name), taken)
        for effects in order.each_effect or (None,):
            for seed in order.seeds or (None,):
                told = [label, *([effects] if effects else []), *([] if seed is None else [f"seed-{seed}"])]
                name = _unused("-".join(told), taken) if len(told) > 1 else label
                run = out / name if own_folder else None
                tasks.append(
                    Task(
                        name=name,
                        folder=folder,
                        words=(order.command, *_line(order, takes, folder, effects, seed, run)),
                        run=run,
                        logs=out / LOGS,
                        place=Path(order.place),
                        limited="workers" in takes,
                        resumable="resume" in takes,
                        seed=seed,
                        effects=effects,
                    )
                )
    return tasks


def _first(options_type: type[CommonOptions]) -> str:
    """What the command takes first: a capture or a run."""
    return next(f.name for f in fields(options_type) if f.name in ("capture", "run"))


def _line(
    order: Order, takes: set[str], folder: str, effects: str | None, seed: int | None, run: Path | None
) -> list[str]:
    """The words of one run's command line, after the command."""
    # a name that begins as an option does is a path all the same
    words = [f"./{folder}" if folder.startswith("-") else folder]
    if effects is not None:
        listed = effects.split("+")
        words += listed if "effect" in takes else ["--effects", ",".join(listed)]
    words += order.options
    if seed is not None:
        words += ["--seed", str(seed)]
    if order.plugin is not None:
        words += ["--plugin", order.plugin]
    return words if run is None else [*words, "--out", str(run)]


def _unused(name: str, taken: set[str]) -> str:
    """A name that no run has yet; it has it now."""
    found, number = name, 1
    while found in taken:
        number += 1
        found = f"{name}-{number}"
    taken.add(found)
    return found


def _check(order: Order, options_type: type[CommonOptions], takes: set[str], own_folder: bool) -> None:
    """Raises OptionError for what none of the runs could be."""
    program = f"mphygs {order.command}"
    if not order.folders:
        raise OptionError("no folder named; expected captures or runs: mphygs batch FOLDER... --command NAME")
    places = [(Path(order.place) / folder).resolve() for folder in order.folders]
    for k, place in enumerate(places):
        if place in places[:k]:
            raise OptionError(f"{order.folders[k]}: is named twice; expected every folder once")
    if order.seeds and "seed" not in takes:
        raise OptionError(f"--seeds: {program} has no seed; expected a command that has one")
    if order.each_effect and not {"effect", "effects"} & takes:
        raise OptionError(f"--each-effect: {program} takes no effects; expected a command that does")
    if not own_folder and max(len(order.seeds), len(order.each_effect)) > 1:
        several = "--seeds" if len(order.seeds) > 1 else "--each-effect"
        raise OptionError(
            f"{several}: {program} writes into the folder that it is run on; expected one of them, or a "
            "command with a run folder of its own"
        )
    given = {"out", "workers", "resume", "json", "plugin"}
    given |= ({"seed"} if order.seeds else set()) | ({"effects"} if order.each_effect else set())
    for word in order.options:
        if _named(word) in given:
            raise OptionError(f"after --: got {word}, which the batch itself gives; expected other options")
    effects = order.each_effect[0] if order.each_effect else None
    line = _line(replace(order, plugin=None), takes, _ANY, effects, None, Path(_ANY) if own_folder else None)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            found = read_options(options_type, program, line)
    except OptionError as error:
        raise OptionError(f"after --: {error}") from None
    if found is None:
        raise OptionError(f"after --: got --help; expected options of {program}")


def _named(word: str) -> str | None:
    """The option that a word names."""
    return word[2:].split("=")[0].replace("-", "_") if word.startswith("--") else None


def effect_lists(text: str | None) -> tuple[str, ...]:
    """What is to be added by each run: names separated by commas, those of one run joined by "+".
    Raises OptionError for a name that is empty, and for what would be run twice."""
    found = split_names(text)
    sets = [frozenset(each.split("+")) for each in found]
    if any("" in names or len(names) < len(each.split("+")) for names, each in zip(sets, found, strict=True)):
        raise OptionError(f"--each-effect: got '{text}'; expected names between '+', each once")
    if len(set(sets)) < len(sets):
        raise OptionError(f"--each-effect: got '{text}'; expected every choice of effects once")
    return found

"""`mphygs batch FOLDER... --command NAME`: one command on many captures or runs, and one table of them."""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from mphygs.batch.batch_folder import DOCUMENT, PAGE, TABLE, BatchFolder, read_order, remove_outcomes
from mphygs.batch.cluster import check_distributed, workers_for
from mphygs.batch.dispatch import dispatch
from mphygs.batch.order import Order
from mphygs.batch.summary import row_of, text_of
from mphygs.batch.work import Outcome, Task
from mphygs.commands.batch_order import LOGS, effect_lists, options_of, tasks_of
from mphygs.commands.batch_view import BatchView
from mphygs.commands.claim import claim_capture, claim_file, folder_inside
from mphygs.commands.command import DONE, FAILED, Answer, run
from mphygs.commands.console import Console
from mphygs.commands.fit_begun import RUNS
from mphygs.commands.options import CommonOptions, OptionError, split_names

PROGRAM = "mphygs batch"


@dataclass(frozen=True, kw_only=True)
class BatchOptions(CommonOptions):
    """Run one command on many folders, side by side, and put what comes of them into one table. What follows
    "--" is passed on to every run: mphygs batch a b c --command fit -- --effects viscosity. A run that fails
    ends no other one: it is listed at the end, and the exit code is 1."""

    folders: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Captures, or runs where the command takes one."""
    command: str | None = None
    """What is run on each of them, with the options that follow "--": fit, discover, extend, diagnose, ..."""
    out: Path | None = None
    """Folder of the table and of the runs, each in a folder of its name; default: runs/batch-COMMAND."""
    seeds: Annotated[str | None, tyro.conf.arg(metavar="0,1,2")] = None
    """One run of every folder for each of these seeds."""
    each_effect: Annotated[str | None, tyro.conf.arg(metavar="a,b,a+b")] = None
    """One run of every folder for each of these effects; those joined by "+" go together."""
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="tcp://HOST:PORT")] = None
    """Scheduler of dask.distributed whose workers are used; they see the same files. Default: workers on this
    machine."""
    workers: int | None = None
    """Worker processes on this machine; default: one a core, no more than there are runs."""
    threads: int | None = None
    """Threads of every run, at most those of its worker, which has as many runs at a time as it has threads
    for; default: all that its worker has, one run at a time. Workers on this machine share its cores."""
    resume: bool = False
    """Go on with the batch in --out: what is done stays, what was stopped goes on, what failed is tried
    again."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    end = words.index("--") if "--" in words else len(words)
    passed = tuple(words[end + 1 :])
    return run(
        BatchOptions, lambda o, console: batch_command(o, passed, console), program=PROGRAM, argv=words[:end]
    )


def batch_command(options: BatchOptions, passed: tuple[str, ...], console: Console) -> Answer:
    """Run all that is not done yet; the table is written anew whenever a run has ended."""
    if options.threads is not None and options.threads < 1:
        raise OptionError(f"--threads: got {options.threads}; expected 1 or more")
    if options.scheduler is not None and options.workers is not None:
        raise OptionError("--workers: not with --scheduler, whose workers are used; expected one of them")
    if options.scheduler is not None:
        check_address(options.scheduler)
    order, tasks, out = _asked(options, passed)
    check_distributed()
    folder = BatchFolder.of(order, out, tasks if options.resume else ())
    todo = [task for task in tasks if not folder.done(task)]
    given = {name: getattr(options, name) for name in ("workers", "threads", "scheduler")}
    with workers_for(len(todo), **given) as pool:
        folder_inside(out, LOGS)
        if not options.resume:
            remove_outcomes(tasks)
        folder = replace(folder, tasks=tasks)
        folder.write()
        console.resume = _again(options)
        def ended(task: Task, outcome: Outcome) -> None:
            folder.end(task, outcome)
            row = row_of(task, outcome)
            view.ended(f"{task.name}: {row.verdict or row.line or row.state}", failed=not outcome.done)

        console.say(f"{len(todo)} runs of mphygs {order.command}; folder {out}")
        # a view of its own in the place of the live line, its clock begun here
        view = BatchView(Console(console.stream), before=len(tasks) - len(todo), total=len(tasks))
        dispatch(todo, pool, ended=ended, look=view.look, threads=options.threads)
    rows = folder.rows()
    failed = any(row.state == "failed" for row in rows)
    return Answer(folder.answer(), text_of(rows, out), FAILED if failed else DONE)


def _asked(options: BatchOptions, passed: tuple[str, ...]) -> tuple[Order, list[Task], Path]:
    """What is asked for, the runs that it comes to, and their folder, which is held. Raises OptionError."""
    before = None
    if options.resume:
        if options.out is None and options.command is None:
            raise OptionError("--resume: got no --out; expected the folder of a batch")
        before = read_order(_folder(options))
    order = _order(options, passed, before)
    out = _folder(replace(options, command=order.command)).absolute()
    tasks = tasks_of(order, options_of(order.command), out)
    if before is None:
        claim_batch(out)
    return order, tasks, out


def claim_batch(out: Path) -> None:
    """Hold the folder of a batch that begins. Raises OptionError where that would destroy another's files."""
    if (out / "capture.json").exists():
        raise OptionError(f"--out {out}: holds a capture; expected a new folder")
    claim_capture(out)
    for name in (DOCUMENT, TABLE, PAGE):
        claim_file(out / name)


def check_address(address: str) -> None:
    """Raises OptionError for what is no address of a scheduler."""
    if not re.fullmatch(r"([a-z]+://)?[^\s/]+:[0-9]+", address):
        raise OptionError(f"--scheduler: got '{address}'; expected tcp://HOST:PORT of a scheduler")


def _folder(options: BatchOptions) -> Path:
    return options.out or RUNS / f"batch-{options.command}"


def _order(options: BatchOptions, passed: tuple[str, ...], before: Order | None) -> Order:
    """What is asked for; where a batch is gone on with it may be left out, and be nothing else."""
    if options.command is None and before is None:
        raise OptionError(f"--command: not given; expected --command NAME (see {PROGRAM} --help)")
    given = {
        "command": options.command,
        "folders": tuple(str(folder) for folder in options.folders),
        "options": passed,
        "seeds": _seeds(options.seeds),
        "each_effect": effect_lists(options.each_effect),
        "plugin": None if options.plugin is None else str(options.plugin.absolute()),
    }
    if before is None:
        return Order(**given, place=os.getcwd())
    for key, value in given.items():
        began = getattr(before, key)
        # A plugin is run only where it is named: that of before is not taken from a file.
        if value != began and (value or key == "plugin"):
            raise OptionError(
                f"{key}: got {_in_words(value)}, but the batch began with {_in_words(began)}; expected the "
                "same to resume"
            )
    return before


def _in_words(value: object) -> str:
    """A value in words."""
    return (" ".join(map(str, value)) if isinstance(value, tuple) else str(value or "")) or "none"


def _seeds(text: str | None) -> tuple[int, ...]:
    try:
        found = tuple(int(word) for word in split_names(text))
    except ValueError:
        raise OptionError(f"--seeds: got '{text}'; expected numbers separated by commas") from None
    if any(not 0 <= seed < 1 << 64 for seed in found) or len(set(found)) < len(found):
        raise OptionError(f"--seeds: got '{text}'; expected numbers of 0 or more, each once")
    return found


def _again(options: BatchOptions) -> str:
    """The command line that goes on where this one is stopped."""
    words = [PROGRAM, "--out", shlex.quote(str(_folder(options)))]
    for name in ("scheduler", "workers", "threads"):
        if getattr(options, name) is not None:
            words.append(f"--{name} {shlex.quote(str(getattr(options, name)))}")
    return " ".join([*words, "--resume"])

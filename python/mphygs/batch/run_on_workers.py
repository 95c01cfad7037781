"""Runs on workers as `mphygs batch` has them, for scripts that make their own tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from mphygs.batch.cluster import check_distributed, workers_for
from mphygs.batch.dispatch import dispatch
from mphygs.batch.work import Outcome, Task

# Exit codes of what was refused, and of what was interrupted.
REFUSED, INTERRUPTED = 2, 130


class WorkerOptions(Protocol):
    """Which workers a script asks for: see `workers_for`."""

    @property
    def workers(self) -> int | None: ...
    @property
    def threads(self) -> int | None: ...
    @property
    def scheduler(self) -> str | None: ...


def run_on_workers(
    tasks: Sequence[Task],
    ended: Callable[[Task, Outcome], Sequence[Task] | None],
    options: WorkerOptions,
) -> None:
    """Run all tasks, each once. ended: told what came of one, and may say which can be run after it.

    Raises ValueError where no scheduler answers.
    """
    given = {"workers": options.workers, "threads": options.threads, "scheduler": options.scheduler}
    with workers_for(len(tasks), **given) as pool:
        dispatch(tasks, pool, ended=ended, look=lambda *_: None, threads=options.threads)


def exit_code_of(script: Callable[[], int], say: Callable[[str], None]) -> int:
    """The exit code of a script whose runs are on workers: its own; with a line for `say`, another where
    dask is not there or it raises ValueError, and where it is interrupted."""
    try:
        check_distributed()
        return script()
    except ValueError as error:
        say(str(error))
        return REFUSED
    except KeyboardInterrupt:
        say("interrupted; the same line goes on")
        return INTERRUPTED

"""Runs on workers as `mphygs batch` has them, for scripts that make their own tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mphygs.batch.cluster import workers_for
from mphygs.batch.dispatch import dispatch
from mphygs.batch.work import Outcome, Task


def run_on_workers(
    tasks: Sequence[Task],
    ended: Callable[[Task, Outcome], Sequence[Task] | None],
    *,
    workers: int | None = None,
    threads: int | None = None,
    scheduler: str | None = None,
) -> None:
    """Run all tasks, each once. ended: told what came of one, and may say which can be run after it.

    workers, threads, scheduler: see `workers_for`. Raises ValueError where no scheduler answers.
    """
    with workers_for(len(tasks), workers=workers, threads=threads, scheduler=scheduler) as pool:
        dispatch(tasks, pool, ended=ended, look=lambda *_: None, threads=threads)

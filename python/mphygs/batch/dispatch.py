"""Runs handed to workers as these have threads free; what a lost worker had begun goes to another one."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from mphygs.batch.work import FAILED, Outcome, Task

# Workers that one run may be lost with: it may be what ends them.
MOST_LOST = 3


class Handle(Protocol):
    """A run on a worker."""

    def done(self) -> bool:
        """Whether it has ended."""
        ...

    def result(self) -> Outcome:
        """What came of it."""
        ...

    def cancel(self) -> object:
        """Have it interrupted."""
        ...


class Pool(Protocol):
    """Workers, which come and go."""

    def threads(self) -> Mapping[str, int]:
        """The threads of every worker that is there now, by its address."""
        ...

    def submit(self, address: str, task: Task, threads: int) -> Handle:
        """Begin a run on a worker."""
        ...

    def wait(self, seconds: float) -> None:
        """Return once a run has ended, or these are over."""
        ...


@dataclass(frozen=True)
class Running:
    """A run under way: where, and with how many threads."""

    task: Task
    address: str
    threads: int
    handle: Handle


def dispatch(
    tasks: Sequence[Task],
    pool: Pool,
    *,
    ended: Callable[[Task, Outcome], Sequence[Task] | None],
    look: Callable[[Sequence[Running], int], None],
    threads: int | None = None,
    tick: float = 0.5,
) -> None:
    """Run all tasks, each once. threads: of every run; default: all those of its worker, one run at a time.

    No worker has more runs at a time than it has threads for. ended: told what came of a task, and may say
    which can be run after it; look: told every `tick` seconds, at least, of the runs under way and the
    number of workers. An interruption stops what is under way.
    """
    waiting, lost = deque(tasks), Counter()
    running: list[Running] = []

    def end(task: Task, outcome: Outcome) -> None:
        waiting.extend(ended(task, outcome) or ())

    try:
        while waiting or running:
            there = pool.threads()
            for one in list(running):
                if one.handle.done():
                    running.remove(one)
                    end(one.task, one.handle.result())
                elif one.address not in there:
                    running.remove(one)
                    one.handle.cancel()
                    lost[one.task.name] += 1
                    if lost[one.task.name] < MOST_LOST:
                        waiting.appendleft(one.task)
                    else:
                        line = f"{MOST_LOST} workers were lost with it; expected one that it does not end"
                        end(one.task, Outcome(FAILED, line, None, 0.0))
            while waiting and (free := _free(there, running, threads)):
                task = waiting.popleft()
                running.append(Running(task, *free, pool.submit(free[0], task, free[1])))
            look(running, len(there))
            if waiting or running:
                pool.wait(tick)
    except BaseException:
        for one in running:
            one.handle.cancel()
        raise


def _free(
    there: Mapping[str, int], running: Sequence[Running], threads: int | None
) -> tuple[str, int] | None:
    """The worker with most threads free for one more run, and the threads of that run."""
    best = None
    for address, count in there.items():
        each = min(threads or count, count)
        left = count - sum(one.threads for one in running if one.address == address)
        if left >= each and (best is None or left > best[2]):
            best = address, each, left
    return best and best[:2]

"""Fits that ask nothing of each other, a few at a time, each on cores of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Event, Lock
from typing import TypeVar

from mphygs.fit.experiment import Experiment

Item = TypeVar("Item")
Result = TypeVar("Result")

# Fits of a wave. What is decided between waves is the same whatever the number of cores.
ABREAST = 2


def waves(items: Sequence[Item]) -> Iterator[Sequence[Item]]:
    """The items in order, a wave at a time."""
    for begin in range(0, len(items), ABREAST):
        yield items[begin : begin + ABREAST]


def side_by_side(
    experiment: Experiment, work: Callable[[Experiment, Item], Result], items: Sequence[Item]
) -> list[Result]:
    """work(experiment, item) of every item, in order; the same to the bit whatever the cores.

    Where there are cores for it each item has the simulators of a twin of the experiment; cores that have no
    item left help those that have. What work raises is raised here, the first item's first.
    """
    if len(items) < 2 or experiment.settings.workers < 2:
        return [work(experiment, item) for item in items]
    workers = experiment.settings.workers
    abreast = min(ABREAST, len(items), workers)
    # Made here, one after the other: what they are made from is not shared between threads.
    halt = Event()
    twins = [experiment.twin(workers // abreast, halt) for _ in range(abreast)]
    busy, lock = list(twins), Lock()

    def stream(twin: Experiment, share: Sequence[Item]) -> list[Result]:
        results = [work(twin, item) for item in share]
        with lock:
            busy.remove(twin)
            for other in busy:
                other.share(workers // len(busy))
        return results

    with ThreadPoolExecutor(abreast) as pool:
        streams = [pool.submit(stream, twin, items[k::abreast]) for k, twin in enumerate(twins)]
        try:
            done = [stream.result() for stream in streams]
        except BaseException:
            halt.set()  # an interrupt, too, does not wait for more than the runs under way
            raise
    for twin in twins:
        twin.share(workers)  # a Jacobian may be asked of it yet
        experiment.adopt(twin)
    return [done[i % abreast][i // abreast] for i in range(len(items))]

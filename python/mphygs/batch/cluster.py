"""Workers of dask.distributed: a cluster on this machine, or those of a scheduler that is there already."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mphygs.batch.dispatch import Handle
from mphygs.batch.work import FAILED, Outcome, Task, work
from mphygs.capture.errors import one_line
from mphygs.simulate.settings import available_cores

if TYPE_CHECKING:
    from distributed import Client, Future

# Seconds within which a scheduler answers, and a cluster is shut down.
ANSWER = 10.0
# What dask looks at a hundred times a second to tell where time goes, in every process of it: nobody asks.
UNWATCHED = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.gil.enabled": False,
}


def check_distributed() -> None:
    """Raises ValueError where dask.distributed is not installed."""
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise ValueError(
            f"batch needs dask.distributed ({error}); expected it installed: pip install 'mphygs[cluster]'"
        ) from error


@dataclass(frozen=True)
class _Future:
    """A run on a worker, as a future of dask."""

    future: Future

    def done(self) -> bool:
        return self.future.done()

    def result(self) -> Outcome:
        try:
            return self.future.result()
        except Exception as error:  # the worker's own: this one run fails, the others go on
            line = one_line(f"the worker could not run it: {type(error).__name__}: {error}")
            return Outcome(FAILED, line, None, 0.0)

    def cancel(self) -> None:
        self.future.cancel()


@dataclass(frozen=True)
class Workers:
    """The workers of a scheduler. client: connected to it."""

    client: Client
    _ended: threading.Event = field(default_factory=threading.Event)

    def threads(self) -> Mapping[str, int]:
        """The threads of every worker that is there now, by its address."""
        try:
            return self.client.nthreads()
        except (OSError, TimeoutError) as error:
            raise RuntimeError("the scheduler does not answer any more; --resume goes on") from error

    def submit(self, address: str, task: Task, threads: int) -> Handle:
        """Begin a run on a worker."""
        future = self.client.submit(
            on_worker, task, threads, workers=[address], allow_other_workers=False, pure=False, retries=0
        )
        future.add_done_callback(lambda _: self._ended.set())
        return _Future(future)

    def wait(self, seconds: float) -> None:
        """Return once a run has ended, or these are over."""
        self._ended.wait(seconds)
        self._ended.clear()


def on_worker(task: Task, threads: int) -> Outcome:
    """What a worker is sent: a run, which ends as soon as nobody wants it any more."""
    return work(task, threads, withdrawn=_withdrawn())


def _withdrawn() -> Callable[[], bool]:
    """Whether the task that this thread works on was cancelled, or its client is gone."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def asked() -> bool:
        task = worker.state.tasks.get(key)
        return task is None or task.state in ("cancelled", "resumed")

    return asked


@contextlib.contextmanager
def workers_for(
    count: int, *, workers: int | None, threads: int | None, scheduler: str | None
) -> Iterator[Workers | None]:
    """Workers for so many runs, those of a scheduler where its address is given; none where there is no run.

    workers: processes on this machine, default: one a core; threads: of each, default: the cores, shared out.
    Raises ValueError where no scheduler answers.
    """
    if not count:
        yield None
        return
    if scheduler is not None:
        with workers_of_scheduler(scheduler, "--scheduler") as found:
            yield found
        return
    cores = available_cores()
    workers = workers or min(cores, count)
    with local_workers(workers, threads or max(1, cores // workers)) as found:
        yield found


@contextlib.contextmanager
def local_workers(workers: int, threads: int) -> Iterator[Workers]:
    """Worker processes on this machine, which alone can reach them; one that ends is begun anew."""
    import dask
    from distributed import Client, LocalCluster, Security

    with (
        _quiet(),
        dask.config.set(UNWATCHED),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=threads,
            processes=True,
            # its pages are at any port that is free: a second batch may be under way
            dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
            worker_dashboard_address=None,
            memory_limit=None,
            silence_logs=logging.CRITICAL,  # of the worker processes
            security=Security.temporary(),
            preload=["mphygs.batch.interrupt_immunity"],
        ) as cluster,
        Client(cluster, timeout=ANSWER) as client,
    ):
        yield Workers(client)


@contextlib.contextmanager
def workers_of_scheduler(address: str, where: str) -> Iterator[Workers]:
    """The workers of a scheduler. where: that gave its address. Raises ValueError where none answers."""
    from distributed import Client

    with _quiet():
        try:
            client = Client(address, timeout=ANSWER, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise ValueError(
                f"{where}: no scheduler answers at {address}; expected tcp://HOST:PORT of one"
            ) from error
        with client:
            yield Workers(client)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """What the libraries log of lost connections is told in one line where it matters."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)

"""Which runs an order comes to, and how workers share them."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from batch_example import order, task
from mphygs.batch.dispatch import MOST_LOST, dispatch
from mphygs.batch.order import Order
from mphygs.batch.work import Outcome, Task
from mphygs.commands.batch_order import options_of, tasks_of


def runs(asked: Order) -> dict[str, tuple[str, ...]]:
    tasks = tasks_of(asked, options_of(asked.command), Path("/out"))
    return {t.name: t.words for t in tasks}


def test_folders_of_one_name_get_runs_of_their_own() -> None:
    found = runs(order("a/bar", "b/bar", "bar", "logs", options=("--spacing", "0.01")))
    assert list(found) == ["bar", "bar-2", "bar-3", "logs-2"]
    assert found["bar-2"] == ("fit", "b/bar", "--spacing", "0.01", "--out", "/out/bar-2")


def test_one_run_for_each_effect_and_seed() -> None:
    found = runs(order("bar", command="discover", each_effect=("viscosity", "drag+tether"), seeds=(3, 7)))
    assert list(found) == [
        "bar-viscosity-seed-3", "bar-viscosity-seed-7", "bar-drag+tether-seed-3", "bar-drag+tether-seed-7",
    ]  # fmt: skip
    words = found["bar-drag+tether-seed-7"]
    assert words[:4] == ("discover", "bar", "--effects", "drag,tether")
    assert words[words.index("--seed") + 1] == "7"
    extended = runs(order("bar", command="extend", each_effect=("viscosity", "drag+tether")))
    assert extended["bar-drag+tether"] == ("extend", "bar", "drag", "tether", "--out", "/out/bar-drag+tether")


def test_a_command_that_writes_into_its_run_is_left_to_do_so() -> None:
    assert runs(order("bar", command="diagnose")) == {"bar": ("diagnose", "bar")}
    assert runs(order("bar", command="compare")) == {"bar": ("compare", "bar")}


def test_the_first_folder_may_be_named_as_an_option_is(tmp_path: Path) -> None:
    asked = order("-odd", place=str(tmp_path))
    assert next(iter(runs(asked).values()))[1] == "./-odd"
    assert runs(replace(asked, folders=("even",)))["even"][1] == "even"


@dataclass
class Steady:
    """Workers that take one look at the clock for every run. lost: after so many looks, addresses."""

    workers: dict[str, int]
    lost: dict[int, str] = field(default_factory=dict)
    looks: int = 0
    busy: dict[str, list] = field(default_factory=dict)
    most: dict[str, int] = field(default_factory=dict)
    begun: list[str] = field(default_factory=list)

    def threads(self) -> dict[str, int]:
        self.looks += 1
        self.workers.pop(self.lost.get(self.looks, ""), None)
        return dict(self.workers)

    def wait(self, _seconds: float) -> None:
        pass

    def submit(self, address: str, one: Task, threads: int) -> "Run":
        run = Run(self, address, one, threads, self.looks + 2)
        self.begun.append(one.name)
        self.busy.setdefault(address, []).append(run)
        used = sum(r.threads for r in self.busy[address])
        self.most[address] = max(self.most.get(address, 0), used)
        return run


@dataclass
class Run:
    pool: Steady
    address: str
    task: Task
    threads: int
    until: int
    cancelled: bool = False

    def done(self) -> bool:
        return self.address in self.pool.workers and self.pool.looks >= self.until

    def result(self) -> Outcome:
        self.pool.busy[self.address].remove(self)
        return Outcome(0, "", {"threads": self.threads}, 1.0)

    def cancel(self) -> None:
        self.cancelled = True


def keeping(found: dict[str, Outcome]) -> Callable[[Task, Outcome], None]:
    def ended(one: Task, outcome: Outcome) -> None:
        assert one.name not in found, "a run that ended twice"
        found[one.name] = outcome

    return ended


def shared(pool: Steady, count: int, threads: int | None = None) -> dict[str, Outcome]:
    found: dict[str, Outcome] = {}
    tasks = [task(f"t{k}") for k in range(count)]
    dispatch(tasks, pool, ended=keeping(found), look=lambda *_: None, threads=threads)
    assert sorted(found) == sorted(t.name for t in tasks)
    return found


def test_no_worker_has_more_than_its_threads() -> None:
    pool = Steady({"a": 4, "b": 1})
    found = shared(pool, 10, threads=2)
    assert pool.most == {"a": 4, "b": 1}
    assert {o.answer["threads"] for o in found.values()} == {1, 2}
    pool = Steady({"a": 4, "b": 1})
    assert {o.answer["threads"] for o in shared(pool, 6).values()} == {4, 1}
    assert all(o.done for o in found.values())


def test_what_can_be_run_after_a_run_is_run() -> None:
    pool, ended = Steady({"a": 1}), []

    def end(one: Task, outcome: Outcome) -> list[Task]:
        ended.append(one.name)
        return [task("t1"), task("t2")] if one.name == "t0" else []

    dispatch([task("t0"), task("u")], pool, ended=end, look=lambda *_: None)
    assert pool.begun == ended == ["t0", "u", "t1", "t2"]


def test_what_a_lost_worker_had_goes_to_another_one() -> None:
    pool = Steady({"a": 1, "b": 1}, lost={2: "a"})
    found = shared(pool, 4)
    assert all(o.done for o in found.values())
    assert sorted(pool.begun) == ["t0", "t0", "t1", "t2", "t3"]


def test_a_run_that_ends_its_workers_fails_alone() -> None:
    pool = Steady({str(k): 1 for k in range(MOST_LOST + 1)})
    pool.workers = {"0": 1}

    def threads() -> dict[str, int]:
        pool.looks += 1
        if any(r.task.name == "t0" for r in pool.busy.pop(next(iter(pool.workers)), ())):
            pool.workers = {str(pool.looks): 1}
        return dict(pool.workers)

    pool.threads = threads  # type: ignore[method-assign]
    found: dict[str, Outcome] = {}
    dispatch([task("t0")], pool, ended=keeping(found), look=lambda *_: None)
    assert pool.begun == ["t0"] * MOST_LOST
    assert not found["t0"].done and f"{MOST_LOST} workers were lost with it" in found["t0"].line


def test_an_interruption_stops_what_is_under_way() -> None:
    pool, seen = Steady({"a": 1, "b": 1}), []

    def look(running: list, _workers: int) -> None:
        seen[:] = running
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dispatch([task("t0"), task("t1")], pool, ended=lambda *_: None, look=look)
    assert len(seen) == 2 and all(one.handle.cancelled for one in seen)

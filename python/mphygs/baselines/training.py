"""Numbers that a baseline learns, kept in its run folder; a resume goes on after the last stage done."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from safetensors.numpy import save

from mphygs.capture.tensors import read_tensors
from mphygs.capture.written import replace_file
from mphygs.fit.run import TRAINED, Run, StageRecord
from mphygs.simulate.errors import SimulationError

FORMAT = "mphygs-baseline/1"
# Adam, after Kingma and Ba, "Adam: a method for stochastic optimization", 2015.
BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8
# By how much steps shrink where one led to a motion that cannot be computed.
SHORTER = 0.5

# How many times the usual stiffness is tried first, as powers of ten. All of them: what swings faster than it
# should is as far off as what hardly moves, so costs fall and rise again on the way to the best.
TRIED = tuple(np.arange(1.5, -1.6, -0.25))

Values = dict[str, np.ndarray]
# Told the share of the work done, and a line.
Progress = Callable[[float, str], None]
# Cost and its gradient by the values; the number of the iteration.
Measure = Callable[[Mapping[str, np.ndarray], int], tuple[float, Values]]


@dataclass(frozen=True)
class TrainingPlan:
    """rates: longest step of each of the numbers by name; stages of so many iterations each; whole: cost by
    which values are kept, asked at the start and after every stage, where the cost of every iteration is of
    another sample and says nothing beside another (default: values of the iteration of least cost are kept);
    begins: iterations from which costs are of more frames than before, so that older ones say nothing;
    pictures: whether costs are losses of pictures, else half a mean square over the noise."""

    rates: Mapping[str, float]
    stages: int
    iterations: int
    whole: Callable[[Values], float] | None = None
    begins: tuple[int, ...] = ()
    pictures: bool = False


@dataclass
class Trained:
    """values, best: by name; first, second: moments; costs: of every iteration; lowest: cost of the best;
    shrunk: what of the steps' length is left; seconds: of every stage."""

    values: Values
    best: Values
    first: Values
    second: Values
    costs: list[float]
    seconds: list[float]
    lowest: float = np.inf
    shrunk: float = 1.0

    @classmethod
    def at(cls, start: Mapping[str, np.ndarray]) -> Trained:
        """Before the first iteration."""
        values = {name: np.array(value, float) for name, value in start.items()}
        zeros = {name: np.zeros_like(value) for name, value in values.items()}
        return cls(values, _copy(values), _copy(zeros), _copy(zeros), [], [])

    def step(self, cost: float, gradient: Mapping[str, np.ndarray], rates: Mapping[str, float]) -> None:
        """One step of Adam from values of a cost."""
        self.costs.append(cost)
        count = len(self.costs)
        for name, slope in gradient.items():
            self.first[name] = BETA1 * self.first[name] + (1.0 - BETA1) * slope
            self.second[name] = BETA2 * self.second[name] + (1.0 - BETA2) * slope**2
            mean = self.first[name] / (1.0 - BETA1**count)
            size = np.sqrt(self.second[name] / (1.0 - BETA2**count)) + EPSILON
            self.values[name] = self.values[name] - self.shrunk * rates[name] * mean / size

    def keep(self, cost: float) -> None:
        """These values, where none before had so low a cost."""
        if cost < self.lowest:
            self.lowest, self.best = cost, _copy(self.values)

    def back(self) -> None:
        """To the best values, with shorter steps."""
        self.costs.append(self.costs[-1])
        self.values, self.shrunk = _copy(self.best), SHORTER * self.shrunk
        self.first = {name: np.zeros_like(value) for name, value in self.values.items()}


def train(
    run: Run, start: Callable[[], Mapping[str, np.ndarray]], measure: Measure, plan: TrainingPlan,
    constants: Mapping[str, np.ndarray], progress: Progress, *, name: str,
) -> Run:  # fmt: skip
    """The stages that a run has not had yet; the folder is written after each of them.

    start: the values before the first iteration; constants: what else predicting takes, kept beside them;
    progress: told the share of the work done, and a line.
    Raises SimulationError where even the start cannot be computed.
    """
    path = run.folder / TRAINED
    state = _read(path) if path.is_file() else None
    if state is None:
        state = Trained.at(start())
        _keep_by_whole(state, plan)
    total = plan.stages * plan.iterations
    run = _with_history(run, state, plan, name)
    while len(state.costs) < total:
        began = time.monotonic()
        for _ in range(plan.iterations):
            number = len(state.costs)
            if number in plan.begins:
                state.lowest = np.inf
            _one(state, start, measure, plan, number, total)
        whole = _keep_by_whole(state, plan)
        state.seconds.append(time.monotonic() - began)
        done = len(state.costs) == total
        if done:
            state.values = _copy(state.best)
        _write(path, state, constants, complete=done)
        run = _with_history(run, state, plan, name)
        run.save()
        said = _said(state.costs[-1] if whole is None else whole, plan.pictures)
        line = f"{name}: iteration {len(state.costs)} of {total}, {said}"
        progress(len(state.costs) / total, line)
    return run


def _keep_by_whole(state: Trained, plan: TrainingPlan) -> float | None:
    """The cost of the values that a plan keeps them by, infinite where they lead to no motion; None where the
    iterations' own costs tell."""
    if plan.whole is None:
        return None
    try:
        cost = plan.whole(state.values)
    except SimulationError:
        cost = np.inf
    state.keep(cost)
    return cost


def _one(
    state: Trained,
    start: Callable[[], Mapping[str, np.ndarray]],
    measure: Measure,
    plan: TrainingPlan,
    number: int,
    total: int,
) -> None:
    try:
        cost, gradient = measure(state.values, number)
        if not np.isfinite(cost) or not all(np.isfinite(g).all() for g in gradient.values()):
            raise SimulationError("the motion or its gradient is not finite")
    except SimulationError:
        if not state.costs:
            raise
        if not np.isfinite(state.lowest):  # what did for fewer frames does not for more
            state.best = _copy(dict(start()))
        state.back()
        return
    if plan.whole is None:
        state.keep(cost)
    fall = 0.5 * (1.0 + np.cos(np.pi * number / total))
    state.step(cost, gradient, {key: max(fall, 0.05) * rate for key, rate in plan.rates.items()})


def begun_at(
    values_at: Callable[[float], Values], cost_of: Callable[[Values], float], progress: Progress, *,
    name: str, pictures: bool = False,
) -> Values:  # fmt: skip
    """Values of the stiffness that costs least of a few. values_at: of a power of ten times the usual one;
    pictures: as of `TrainingPlan`.

    Raises SimulationError where none can be run.
    """
    best: tuple[float, Values] | None = None
    for power in TRIED:
        values = values_at(power)
        try:
            cost = cost_of(values)
        except SimulationError:
            continue
        progress(0.0, f"{name}: 10^{power:+.2f} times as stiff as usual, {_said(cost, pictures)}")
        if best is None or cost < best[0]:
            best = cost, values
    if best is None:
        raise SimulationError(f"{name}: no stiffness that was tried could be run")
    return best[1]


def trained_values(run: Run) -> Values:
    """The numbers of a finished baseline, constants among them. Raises ValueError where it is not finished or
    they are damaged."""
    path = run.folder / TRAINED
    if not path.is_file():
        raise ValueError(_unfinished(run.folder))
    found = read_tensors(path, "the numbers of a baseline")
    if "complete" not in found or not found["complete"].any():
        raise ValueError(_unfinished(run.folder))
    for key, value in found.items():
        if not np.isfinite(value).all() and key != "state.lowest":
            raise ValueError(f"{path}: {key} holds what is no number; expected the numbers of a baseline")
    kept = ("values.", "constant.")
    return {key.split(".", 1)[1]: value for key, value in found.items() if key.startswith(kept)}


def taken(values: Mapping[str, np.ndarray], path: Path, shapes: Mapping[str, tuple]) -> list[np.ndarray]:
    """The values by name, of these shapes (None: any length). Raises ValueError."""
    out = []
    for name, shape in shapes.items():
        value = values.get(name)
        if value is None or value.ndim != len(shape) or any(
            b is not None and a != b for a, b in zip(value.shape, shape, strict=True)
        ):  # fmt: skip
            had = "none" if value is None else f"one of shape {value.shape}"
            raise ValueError(f"{path / TRAINED}: {name}: {had}; expected numbers of shape {shape}")
        out.append(value)
    return out


def _unfinished(folder: Path) -> str:
    return f"{folder}: is not complete; expected a finished run (fit --out {folder} --resume)"


def _with_history(run: Run, state: Trained, plan: TrainingPlan, name: str) -> Run:
    """The run with a record of every stage done; those of this training are told by the file of numbers."""
    own = [record for record in run.history if not record.name.startswith(f"{name} ")]
    for k, seconds in enumerate(state.seconds):
        costs = state.costs[k * plan.iterations : (k + 1) * plan.iterations]
        last = k + 1 == plan.stages
        lowest = 0.0 if plan.pictures else _misfit(min(costs))
        own.append(
            StageRecord(
                f"{name} {k + 1}", run.settings.spacing, tuple(costs), last, "planned", seconds, lowest
            )
        )
    return replace(run, history=tuple(own))


def _misfit(cost: float) -> float:
    """Root mean square of what is left [sigma], of a cost that is half its mean square."""
    return float(np.sqrt(2.0 * max(cost, 0.0)))


def _said(cost: float, pictures: bool) -> str:
    return f"loss {cost:.5f}" if pictures else f"misfit {_misfit(cost):.4g}"


def _copy(values: Mapping[str, np.ndarray]) -> Values:
    return {name: value.copy() for name, value in values.items()}


def _write(path: Path, state: Trained, constants: Mapping[str, np.ndarray], *, complete: bool) -> None:
    arrays = {f"constant.{name}": np.asarray(value, float) for name, value in constants.items()}
    for kind in ("values", "best", "first", "second"):
        arrays |= {f"{kind}.{name}": value for name, value in getattr(state, kind).items()}
    arrays |= {
        "state.costs": np.array(state.costs),
        "state.seconds": np.array(state.seconds),
        "state.lowest": np.array([state.lowest]),
        "state.shrunk": np.array([state.shrunk]),
        "complete": np.array([float(complete)]),
    }
    content = save({k: np.ascontiguousarray(v) for k, v in arrays.items()}, metadata={"format": FORMAT})
    replace_file(path, content)


def _read(path: Path) -> Trained:
    found = read_tensors(path, "the numbers of a baseline")

    def of(kind: str) -> Values:
        return {k.split(".", 1)[1]: v for k, v in found.items() if k.startswith(f"{kind}.")}

    try:
        return Trained(
            of("values"), of("best"), of("first"), of("second"),
            found["state.costs"].tolist(), found["state.seconds"].tolist(),
            float(found["state.lowest"][0]), float(found["state.shrunk"][0]),
        )  # fmt: skip
    except (KeyError, IndexError) as error:
        raise ValueError(f"{path}: is damaged ({error}); expected the numbers of a baseline") from error

"""Fits side by side: in order, two at a time, and the same bits whatever the cores."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, recorded
from mphygs.capture.format import Capture
from mphygs.fit.experiment import Experiment
from mphygs.fit.side_by_side import ABREAST, side_by_side, waves
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Settings

FREE = ("part0.youngs_modulus", "part0.density")


def recording() -> tuple[Capture, Belief]:
    capture = bar_capture(frames=20, fps=100.0, fit=(0, 15))
    truth = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    return recorded(capture, truth), truth


def experiment(workers: int) -> Experiment:
    made = Experiment.of(recording()[0], Settings(SPACING, workers=workers))
    made.problem(SPACING)
    return made


def test_waves_leave_nothing_out() -> None:
    assert [list(wave) for wave in waves(range(5))] == [[0, 1], [2, 3], [4]]
    assert list(waves([])) == []
    assert ABREAST == 2


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_come_in_order(workers: int) -> None:
    asked: list[Experiment] = []

    def work(own: Experiment, item: int) -> int:
        asked.append(own)
        return item**2

    made = experiment(workers)
    assert side_by_side(made, work, range(5)) == [0, 1, 4, 9, 16]
    assert side_by_side(made, work, [3]) == [9]
    assert asked[-1] is made  # alone it has all cores
    assert len({id(own) for own in asked[:5]}) == (1 if workers == 1 else ABREAST)
    assert all((own is made) == (workers == 1) for own in asked[:5])
    assert all(own.settings.workers == max(1, workers // ABREAST) for own in asked[:5])


def test_two_run_at_once() -> None:
    meeting = threading.Barrier(2, timeout=20.0)
    assert len(side_by_side(experiment(2), lambda _own, _item: meeting.wait(), "ab")) == 2


def test_what_work_raises_is_raised() -> None:
    def work(_own: Experiment, item: int) -> None:
        raise KeyError(item)

    with pytest.raises(KeyError, match="7"):
        side_by_side(experiment(2), work, [7, 8])


def test_an_interrupt_waits_for_no_more_than_the_runs_under_way() -> None:
    begun, told, ran = threading.Event(), threading.Event(), []

    def work(own: Experiment, item: int) -> None:
        if item == 0:
            begun.wait(20.0)
            raise KeyboardInterrupt
        problem, belief = own.problem(SPACING), recording()[1]
        problem.evaluate(belief, jacobian=False)
        begun.set()
        told.wait(2.0)  # by then it was raised
        problem.evaluate(belief.with_parameter(FREE[0], value=5e4), jacobian=False)
        ran.append(item)

    with pytest.raises(KeyboardInterrupt):
        side_by_side(experiment(2), work, [0, 1])
    assert ran == []


def test_a_twin_shares_what_is_not_written_to() -> None:
    made = experiment(2)
    twin = made.twin(1)
    own, other = made.problem(SPACING).predictors["a"], twin.problem(SPACING).predictors["a"]
    assert other.body is own.body and twin.observations is made.observations
    assert other.rest_shape is not own.rest_shape and other.transfer is not own.transfer
    assert (own.workers, other.workers, twin.problem(SPACING).settings.workers) == (2, 1, 1)
    # What is known already is not computed again.
    known = made.problem(SPACING).evaluate(belief := recording()[1])
    again = made.twin(1).problem(SPACING).evaluate(belief)
    assert np.array_equal(known.residual, again.residual)
    assert made.twin(1).problem(SPACING).predictors["a"]._kept[0] is own._kept[0]
    # Nor where no derivatives were asked for, by the predictor itself or a twin.
    ran = own.predict(belief, last=4).position
    assert own.predict(belief, last=4).position is ran
    assert made.twin(1).problem(SPACING).predictors["a"].predict(belief, last=4).position is ran
    own.forget()
    anew = own.predict(belief, last=4).position
    assert anew is not ran and np.array_equal(anew, ran)


def test_grids_that_a_twin_needed_are_kept() -> None:
    made, finer = experiment(2), 0.8 * SPACING

    def work(own: Experiment, item: int) -> float:
        return own.problem(finer).settings.spacing * item

    side_by_side(made, work, [1, 2])
    assert made.problems[finer].settings.workers == 2
    assert made.problems[finer].predictors["a"].workers == 2


def test_the_cores_change_no_bit() -> None:
    beliefs = [recording()[1].with_parameter(FREE[0], value=value) for value in (4e4, 5e4, 6e4)]

    def work(own: Experiment, belief: Belief) -> tuple[np.ndarray, np.ndarray]:
        found = own.window(SPACING, 0.6).evaluate(belief)
        return found.residual, found.jacobian

    alone, abreast = (side_by_side(experiment(workers), work, beliefs) for workers in (1, 2))
    for one, other in zip(alone, abreast, strict=True):
        assert np.abs(one[1]).max() > 0.0
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    assert not np.array_equal(alone[0][0], alone[1][0])


def test_the_last_one_has_the_others_cores() -> None:
    ended, cores = threading.Event(), {}

    def work(own: Experiment, item: int) -> None:
        predictor = own.problem(SPACING).predictors["a"]
        if item == 0:
            cores["before"] = predictor.workers
            ended.set()
            return
        ended.wait(20.0)
        for _ in range(200):
            if predictor.workers > 1:
                break
            time.sleep(0.05)
        cores["after"] = predictor.workers

    made = experiment(2)
    side_by_side(made, work, [0, 1])
    assert cores == {"before": 1, "after": 2}
    assert made.problem(SPACING).predictors["a"].workers == 2

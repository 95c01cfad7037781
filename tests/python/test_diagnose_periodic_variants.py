"""Where a frame's pulse is looked for, and what a refit of it starts from."""

import numpy as np
import pytest

from mphygs.diagnose.periodic_variants import (
    PULSE_WIDTHS,
    periodic_variants,
    pulse_variants,
    sudden_beginnings,
)
from mphygs.diagnose.refit_starts import refit_start
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.settings import TOTAL_LAGRANGIAN

FPS = 60.0
SHAKE = effect("base_motion")


def belief() -> Belief:
    return Belief(parts=("part",), gravity=np.array([0.0, 0.0, -9.81]), parameters=(), terms=())


def misfit(begin: int, frames: int = 90, frequency: float = 4.0, height: float = 3e-3) -> np.ndarray:
    """(T, 5, 3) noise, and from a frame on a decaying swing along y."""
    generator = np.random.default_rng(7)
    residual = generator.normal(0.0, 3e-4, (frames, 5, 3))
    time = np.maximum(np.arange(frames) - begin, 0.0) / FPS
    residual[:, :, 1] += height * np.exp(-time)[:, None] * np.sin(2 * np.pi * frequency * time)[:, None]
    return residual


@pytest.mark.parametrize("begin", [12, 40, 70])
def test_a_swing_is_seen_from_where_it_begins(begin: int) -> None:
    found = sudden_beginnings(misfit(begin), 1)
    assert len(found) == 1 and begin <= found[0] <= begin + 2


def test_noise_rises_nowhere_and_neither_does_a_swing_that_was_always_there() -> None:
    assert sudden_beginnings(misfit(90), 2) == []
    assert sudden_beginnings(misfit(-30), 2) == []


def test_frames_that_saw_nothing_do_not_matter() -> None:
    residual = misfit(40)
    residual[20:25] = np.nan
    residual[:, 2] = np.nan
    (found,) = sudden_beginnings(residual, 1)
    assert 40 <= found <= 42
    assert sudden_beginnings(np.full((90, 5, 3), np.nan), 2) == []


def test_pulses_of_several_widths_begin_shortly_before_they_are_seen() -> None:
    ways = pulse_variants(belief(), SHAKE, [0.5, 0.02], 0.25)
    assert len(ways) == 2 * len(PULSE_WIDTHS) and len({way.label for way in ways}) == len(ways)
    for way, share in zip(ways, PULSE_WIDTHS, strict=False):
        extended, _ = way.columns[0]
        f, phase = way.values["f"], way.values["phase"]
        begin, width = -phase / (2 * np.pi * f), 0.5 / f
        assert width == pytest.approx(0.25 * share) and begin < 0.5 < begin + width
        assert extended["base_motion.pulse"].value == 1.0 and not extended["base_motion.pulse"].free
        assert [p.key for _, p in way.columns] == [f"base_motion.a_{axis}" for axis in "xyz"]
    assert all(way.values["phase"] <= 0.0 for way in ways)  # none before the recording begins
    assert len(pulse_variants(belief(), SHAKE, [0.01, 0.02], 1.0)) < 2 * len(
        PULSE_WIDTHS
    )  # two with it are one


def test_a_pulse_is_refitted_from_its_own_time_and_width() -> None:
    (way, *_) = pulse_variants(belief(), SHAKE, [0.5], 0.25)
    start = refit_start(way, np.array([1.0, -2.0, 300.0]), belief())
    told = {p.key.removeprefix("base_motion."): p for p in start.parameters}
    assert [told[f"a_{axis}"].value for axis in "xyz"] == [1.0, -2.0, 100.0]  # its bound
    assert told["f"].value == way.values["f"] and told["phase"].value == way.values["phase"]
    assert told["pulse"].value == 1.0
    assert {name for name, p in told.items() if p.free} == {"a_x", "a_y", "a_z", "f", "phase"}


def test_a_misfit_that_begins_suggests_pulses_there_and_one_that_does_not_none() -> None:
    sudden = periodic_variants(belief(), TOTAL_LAGRANGIAN, misfit(40), FPS, 1.0)
    pulses = [way for way in sudden if way.values.get("pulse")]
    assert pulses and len(sudden) > len(pulses)
    begin = -pulses[0].values["phase"] / (2 * np.pi * pulses[0].values["f"])
    assert begin == pytest.approx(1.0 + 40 / FPS, abs=0.05)
    quiet = periodic_variants(belief(), TOTAL_LAGRANGIAN, misfit(-30), FPS, 1.0)
    assert not any(way.values.get("pulse") for way in quiet)
    assert (
        periodic_variants(belief().with_effect("base_motion"), TOTAL_LAGRANGIAN, misfit(40), FPS, 0.0) == []
    )

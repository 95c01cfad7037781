"""Which motion would tell two effects apart, and how that is told."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import recorded
from mphygs.diagnose.diagnosis_document import advice
from mphygs.diagnose.effect_variants import smooth_variants
from mphygs.diagnose.next_motion import Proposed, candidate_motions, motion_frequency, propose
from mphygs.fit.experiment import Experiment
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Settings

SPACING = 0.01


@cache
def scene() -> tuple[Experiment, Belief]:
    capture = bar_capture(frames=40, fps=100.0, fit=(0, 40))
    truth = bar_belief(capture, youngs_modulus=6e4, free=("part0.youngs_modulus",))
    return Experiment.of(recorded(capture, truth, SPACING), Settings(SPACING, workers=1)), truth


def test_the_frequency_is_that_of_the_markers() -> None:
    experiment, _ = scene()
    experiment.problem(SPACING)
    observation = next(iter(experiment.observations.values()))
    times = np.arange(40) / 100.0
    swing = 1e-3 * np.sin(2 * np.pi * 7.5 * times)[:, None, None] * np.ones((1, 5, 3))
    assert motion_frequency(replace(observation, position=swing), 100.0, (0, 40)) == pytest.approx(7.5)


def test_holds_are_moved_and_nothing_else() -> None:
    experiment, _ = scene()
    recording = experiment.capture.sequences[0]
    motions = candidate_motions(experiment.capture, recording, 5.0)
    assert len(motions) == 18
    for name, motion in motions.items():
        held = motion.held[0]
        assert len(held.position) == motion.frames and not motion.loads and motion.release is None
        shift, turn = np.ptp(held.position, axis=0), np.abs(held.quaternion[:, 0] - 1.0).max()
        if name.startswith("shake"):
            assert (shift > 1e-4).sum() == 1 and turn == 0.0
        else:
            assert turn > 1e-5
            # what is held turns about its own middle
            pivot = np.mean(held.box, axis=0)
            rotation, position = held.poses(np.arange(motion.frames) / motion.fps, motion.fps)
            assert np.allclose(rotation @ pivot + position, pivot, atol=1e-6)
    assert candidate_motions(experiment.capture, replace(recording, held=()), 5.0) == {}


def test_fast_motions_tell_viscosity_from_mass_damping() -> None:
    """Damping by viscosity grows with the square of the frequency, by mass it does not."""
    experiment, belief = scene()
    name = next(iter(experiment.fitted))
    predictor = experiment.predictor(name, SPACING)
    ways = {w.effect: w for w in smooth_variants(belief, predictor.body, names=["viscosity", "mass_damping"])}
    pair = ways["viscosity"], ways["mass_damping"]
    told: list[str] = []
    observation = experiment.observations[name]
    found = propose(predictor, observation, belief, *pair, np.array([2.0]), report=told.append)
    separations = [item.separation for item in found]
    assert len(found) == len(told) == 18 and separations == sorted(separations, reverse=True)
    assert separations[0] > 10.0 * max(separations[-1], 1e-9)
    # chi^2 goes with the square of the strength
    twice = propose(predictor, observation, belief, *pair, np.array([4.0]))
    assert twice[0].motion == found[0].motion
    assert twice[0].separation == pytest.approx(4.0 * found[0].separation, rel=1e-6)


def test_the_advice_names_the_motion() -> None:
    ranking = [{"effect": "viscosity", "confounded_with": ["mass_damping"]}]
    motions = [Proposed("shake the hold along y at 8 Hz by 3 mm", 120.0), Proposed("other", 3.0)]
    text = advice("missing", ["viscosity"], ranking, (), motions=motions)
    assert "does not tell viscosity from mass_damping" in text
    assert "best of 2 that were simulated: shake the hold along y at 8 Hz by 3 mm" in text and "120" in text
    assert "another amplitude" in advice("missing", ["viscosity"], ranking, ())

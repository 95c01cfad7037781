"""A sheet that a hand jerks: steps are halved where they do not converge, and only there."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief
from mphygs.diagnose.effect_variants import late_variants
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.settings import Settings
from mphygs.simulate.shorter_steps import HALVINGS, in_steps_that_do
from mphygs.simulate.timeline import Timeline
from thin_meshes import held_capture, rod, strip

FRAMES, KEY = 6, "part0.youngs_modulus"
LAST = 4  # soon after the jerk: later what snaps through is told by no derivative


@cache
def jerked(jump: float = 0.2, frames: int = LAST) -> tuple[Predictor, Belief]:
    """A soft sheet, its hold 20 cm higher a sixtieth of a second later; viscous, or a last digit grows a
    ten-thousandfold as it snaps."""
    motion = np.zeros((frames, 3))
    motion[2:, 2] = jump
    capture = held_capture([strip(0.04, 0.02, held=0.003)], frames=frames, motion=motion)
    belief = bar_belief(capture, youngs_modulus=2e5, density=800.0, poissons_ratio=0.3, prestress="off")
    belief = belief.with_effect("viscosity", {"eta": 300.0})
    settings = Settings(0.01, dtype="float64", workers=1)
    return Predictor(capture, capture.sequences[0], settings), belief


def test_a_jerk_is_followed_in_shorter_steps_and_the_same_again() -> None:
    predictor, belief = jerked()
    usual = predictor.timeline(belief, LAST, predictor.stable_substep(belief)).substeps
    motion = predictor.predict(belief)
    assert usual < motion.substeps < 2 * usual
    assert np.isfinite(motion.position).all()
    # neither what ran before nor derivatives change a step
    again = predictor.twin(1)
    again.forget()
    told = again.predict(belief, keys=(KEY,))
    assert told.substeps == motion.substeps
    np.testing.assert_allclose(told.position, motion.position, rtol=0, atol=1e-10)


def test_its_gradient_is_that_of_the_shorter_steps() -> None:
    predictor, belief = jerked()
    bar = np.random.default_rng(4).standard_normal((LAST, 1, 3))
    tangent = np.vdot(bar, predictor.predict(belief, keys=(KEY,)).jacobian[..., 0])
    _, gradient = predict_with_gradient(predictor, belief, lambda _: bar, keys=(KEY,), last=LAST)
    assert gradient == pytest.approx([tangent], rel=1e-5)
    step = 1e-6
    more, less = (
        predictor.predict(belief.with_parameter(KEY, value=2e5 * np.exp(x))).position for x in (step, -step)
    )
    assert tangent == pytest.approx(np.vdot(bar, more - less) / (2 * step), rel=1e-3)


@pytest.mark.parametrize("hard", [{3: 1}, {2: HALVINGS}, {1: 2, 4: 1}])
def test_steps_are_halved_where_it_is_hard_and_not_before(hard: dict[int, int]) -> None:
    predictor, belief = jerked(frames=FRAMES)
    usual = predictor.timeline(belief, FRAMES, predictor.stable_substep(belief))

    def run(timeline: Timeline) -> float:
        for span, halvings in hard.items():
            if timeline.schedule["steps"][span] < usual.schedule["steps"][span] << halvings:
                raise SimulationError("too long", frame=span + 1, shorter=True)
        return float(timeline.spans.sum())

    length, timeline = in_steps_that_do(usual, run)
    assert length == pytest.approx(usual.spans.sum())
    ratio = timeline.schedule["steps"] / usual.schedule["steps"]
    first = min(hard)
    assert (ratio[:first] == 1).all() and all(ratio[s] >= 2**h for s, h in hard.items())
    assert ratio.max() <= 1 << HALVINGS


def test_a_step_that_never_converges_ends_the_run_with_its_line() -> None:
    predictor, belief = jerked(frames=FRAMES)
    usual = predictor.timeline(belief, FRAMES, predictor.stable_substep(belief))
    tried = []

    def run(timeline: Timeline) -> None:
        tried.append(timeline.schedule["dt"][2])
        raise SimulationError(f"a step of {tried[-1]:g} s", frame=3, shorter=True)

    with pytest.raises(SimulationError, match=f"{usual.schedule['dt'][2] / 2**HALVINGS:g} s"):
        in_steps_that_do(usual, run)
    assert len(tried) == HALVINGS + 1
    # what shorter steps do not mend is not tried again
    with pytest.raises(SimulationError, match="inverted"):
        in_steps_that_do(usual, lambda _: (_ for _ in ()).throw(SimulationError("inverted", frame=2)))


def test_places_of_loads_on_a_rod_have_names_of_their_own() -> None:
    # A rod's points lie in two blocks about the same middle, and it has fewer cells than places are tried.
    capture = held_capture([rod(0.05)], rest="equilibrium")
    belief = bar_belief(capture, youngs_modulus=1e8, density=1000.0, prestress="equilibrium")
    body = Predictor(capture, capture.sequences[0], Settings(0.006, workers=1)).body
    labels = [variant.label for variant in late_variants(belief, body)]
    assert len(labels) > 8 and len(set(labels)) == len(labels)

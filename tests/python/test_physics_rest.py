"""Each prestress at rest moves nothing for a second."""

from __future__ import annotations

import numpy as np
import pytest

from bar_capture import DOWN, bar_belief, bar_capture
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor, Settings

STILL = 1e-6  # [m]


def largest_motion(prestress: str, gravity: np.ndarray, dtype: str, change: object = None) -> float:
    rest = "equilibrium" if prestress == "equilibrium" else "stress-free"
    capture = bar_capture(lengths=(0.03, 0.03), frames=26, fps=25.0, gravity=gravity, rest=rest)
    belief: Belief = bar_belief(
        capture, youngs_modulus=(3e4, 1.5e4), density=(1000.0, 600.0), prestress=prestress
    )
    if change is not None:
        belief = change(belief)
    predictor = Predictor(capture, capture.sequence("a"), Settings(0.01, dtype=dtype))
    position = predictor.predict(belief).position
    return float(np.abs(position - predictor.recording.markers.at).max())


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize(
    ("prestress", "gravity"),
    [("off", np.zeros(3)), ("paper", DOWN), ("equilibrium", DOWN)],
    ids=["off", "paper", "equilibrium"],
)
def test_nothing_moves_at_rest(prestress: str, gravity: np.ndarray, dtype: str) -> None:
    assert largest_motion(prestress, gravity, dtype) < STILL


def test_without_prestress_gravity_moves_it() -> None:
    assert largest_motion("off", DOWN, "float64") > 1e-2


@pytest.mark.parametrize(
    "change",
    [
        lambda b: b.with_effect("viscosity", {"eta": 3.0}).with_effect("mass_damping", {"alpha": 1.0}),
        lambda b: b.with_effect("gravity", {"delta_g_x": 0.4}),
        lambda b: b.with_effect("attached_mass", {"m": 3e-3}, {"place": [0.055, 0.01, 0.01]}),
        lambda b: b.with_effect("stiffening", {"c_2": 2e3}),
        lambda b: b.with_effect("relaxation", {"ratio": 0.5, "tau": 0.1}).with_effect(
            "air_drag", {"c_d": 1.0}
        ),
    ],
    ids=["damping", "gravity", "attached_mass", "stiffening", "relaxation"],
)
def test_equilibrium_includes_what_loads_the_rest_shape(change: object) -> None:
    assert largest_motion("equilibrium", DOWN, "float64", change) < STILL

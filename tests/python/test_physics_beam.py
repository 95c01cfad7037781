"""Bars against beam theory: deflection, first frequency, two materials in series, known viscosity."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq, least_squares

from bar_capture import bar_belief, bar_capture
from mphygs.capture.format import Capture
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor, Settings

LENGTH, SIDE = 0.1, 0.02
YOUNGS_MODULUS, DENSITY = 1e5, 1000.0
AREA, SECOND_MOMENT = SIDE**2, SIDE**4 / 12
# Timoshenko's shear coefficient of a rectangle; Poisson's ratio is zero, so that the clamp does not pinch.
SHEAR_STIFFNESS = 5 / 6 * YOUNGS_MODULUS / 2 * AREA


def cantilever(weight: float, frames: int, fps: float = 100.0, rest: str = "stress-free") -> Capture:
    tip = np.array([[LENGTH, SIDE / 2, SIDE / 2]])
    gravity = np.array([0.0, 0.0, -weight])
    return bar_capture(
        lengths=(LENGTH,), side=SIDE, gravity=gravity, markers_at=tip, frames=frames, fps=fps, rest=rest
    )


def static_displacement(capture: Capture, belief: Belief, spacing: float) -> np.ndarray:
    """Of the markers under small loads, (M, 3) [m]: the way back from the published shape, turned."""
    predictor = Predictor(capture, capture.sequence("a"), Settings(spacing, dtype="float64"))
    to_free = predictor.rest_shape.solve(belief)["map"]
    model = predictor.model((), np.zeros((0, 3)), "neo-hookean")
    node, value, _ = model.weights(predictor.attachment.anchor, predictor.attachment.cell)
    return -np.einsum("mk,mkc->mc", value, to_free[node])


def trace_frequency(times: np.ndarray, trace: np.ndarray, guess: float, decay: bool = False) -> np.ndarray:
    """First angular frequency [rad/s] (and decay [1/s]) of a tip's trace, fitted with its second mode."""

    def misfit(p: np.ndarray) -> np.ndarray:
        columns = [np.ones_like(times)]
        for ratio, fade in ((1.0, p[-1]), (p[1], p[-1] * p[1] ** 2)):
            envelope = np.exp(-fade * times) if decay else 1.0
            columns += [envelope * np.cos(ratio * p[0] * times), envelope * np.sin(ratio * p[0] * times)]
        basis = np.stack(columns, 1)
        return (basis @ np.linalg.lstsq(basis, trace, rcond=None)[0] - trace) / np.ptp(trace)

    start = [guess, 5.0, 1.0] if decay else [guess, 5.0]
    found = least_squares(misfit, start, x_scale=np.abs(start))
    assert np.abs(found.fun).max() < 0.03, "the trace is not two modes"
    return found.x[[0, -1]] if decay else found.x[:1]


def first_frequency() -> float:
    """Of a clamped Timoshenko beam [rad/s], by shooting from the clamp to the free end."""
    bending, inertia = YOUNGS_MODULUS * SECOND_MOMENT, DENSITY * SECOND_MOMENT

    def free_end(w: float) -> float:
        # y' = theta + V / kGA, theta' = M / EI, M' = -V - rho I w^2 theta, V' = -rho A w^2 y
        a = np.zeros((4, 4))
        a[0, 1], a[0, 3], a[1, 2] = 1.0, 1.0 / SHEAR_STIFFNESS, 1.0 / bending
        a[2, 1], a[2, 3], a[3, 0] = -inertia * w**2, -1.0, -DENSITY * AREA * w**2
        return float(np.linalg.det(expm(a * LENGTH)[2:, 2:]))

    slender = 3.516 * np.sqrt(bending / (DENSITY * AREA * LENGTH**4))
    return brentq(free_end, 0.7 * slender, slender)


def test_static_deflection_converges_to_beam_theory() -> None:
    weight = 1e-3
    capture = cantilever(weight, 2, rest="equilibrium")
    belief = bar_belief(
        capture, youngs_modulus=YOUNGS_MODULUS, density=DENSITY, poissons_ratio=0.0, prestress="equilibrium"
    )
    load = DENSITY * AREA * weight
    theory = load * LENGTH**4 / (8 * YOUNGS_MODULUS * SECOND_MOMENT) + load * LENGTH**2 / (
        2 * SHEAR_STIFFNESS
    )
    tips = np.array([-static_displacement(capture, belief, h)[0, 2] for h in (0.02, 0.01, 0.005)])
    errors = tips / theory - 1.0
    assert (np.abs(errors) < [2e-2, 1e-3, 5e-4]).all(), errors
    # Measured 5.8; energies of quadratic splines converge with the fourth power where the solution is smooth.
    order = np.log2((tips[1] - tips[0]) / (tips[2] - tips[1]))
    assert order > 3.5, order


def test_first_frequency_converges_with_the_square_of_the_spacing() -> None:
    theory = first_frequency()
    capture = cantilever(0.01, 121)
    belief = bar_belief(capture, youngs_modulus=YOUNGS_MODULUS, density=DENSITY, poissons_ratio=0.0)
    errors = []
    for spacing in (0.02, 0.01, 0.005):
        swing = Predictor(capture, capture.sequence("a"), Settings(spacing, dtype="float64")).predict(belief)
        found = trace_frequency(swing.frames / 100.0, swing.position[:, 0, 2], theory)
        errors.append(found[0] / theory - 1.0)
    # Lumped masses lower the frequency: -4.0 %, -1.1 %, -0.26 %.
    assert (np.abs(errors) < [5e-2, 1.3e-2, 3.5e-3]).all(), errors
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert ((orders > 1.7) & (orders < 2.3)).all(), orders


def test_two_materials_in_series() -> None:
    first, second, weight = 0.04, 0.036, 1e-2
    soft, stiff = 2e4, 8e4
    ends = np.array([[first, SIDE / 2, SIDE / 2], [first + second, SIDE / 2, SIDE / 2]])
    capture = bar_capture(
        lengths=(first, second), side=SIDE, gravity=np.array([weight, 0, 0]), markers_at=ends, frames=2,
        rest="equilibrium",
    )  # fmt: skip
    belief = bar_belief(
        capture,
        youngs_modulus=(stiff, soft),
        density=(DENSITY, 500.0),
        poissons_ratio=0.0,
        prestress="equilibrium",
    )
    # The first part carries its own weight and that of the second.
    joint = weight * (DENSITY * first**2 / 2 + 500.0 * second * first) / stiff
    tip = joint + weight * 500.0 * second**2 / (2 * soft)
    errors = []
    for spacing in (0.01, 0.005):
        errors.append(static_displacement(capture, belief, spacing)[:, 0] / [joint, tip] - 1.0)
    # The strain jumps fourfold at the joint. One spline over it would spread that over a cell (4 % on the
    # coarse grid); a grid for each part does not.
    assert (np.abs(errors) < 1e-3).all(), errors


def test_a_known_viscosity_gives_the_known_decay() -> None:
    eta = 20.0
    capture = cantilever(0.01, 121, fps=150.0)
    capture_belief = bar_belief(capture, youngs_modulus=YOUNGS_MODULUS, density=DENSITY, poissons_ratio=0.3)
    mu = YOUNGS_MODULUS / 2.6
    predictor = Predictor(capture, capture.sequence("a"), Settings(0.01, dtype="float64"))
    swing = predictor.predict(capture_belief.with_effect("viscosity", {"eta": eta}))
    guess = first_frequency()
    frequency, decay = trace_frequency(swing.frames / 150.0, swing.position[:, 0, 2], guess, decay=True)
    # mu becomes mu + i w eta; E = 9 K mu / (3 K + mu) has the slope E^2 / (3 mu^2), and w^2 goes with E.
    theory = frequency**2 * eta * YOUNGS_MODULUS / (6 * mu**2)
    np.testing.assert_allclose(decay, theory, rtol=0.03)

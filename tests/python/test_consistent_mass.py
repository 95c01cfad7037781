"""What nodes of thin parts share of their mass: masses at places, the motion of a run, derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigvalsh
from scipy.optimize import brentq

from bar_capture import bar_belief
from mphygs import _core
from mphygs.model.belief import Belief
from mphygs.simulate.fields import core_inputs
from mphygs.simulate.modes import natural_modes
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.settings import IMPLICIT, Settings
from thin_meshes import held_capture, strip

LENGTH, WIDTH, THICKNESS, DENSITY, MODULUS = 0.1, 0.02, 3e-4, 1000.0, 5e6
OWN = LENGTH * WIDTH * THICKNESS * DENSITY  # [kg]


def heavy_tipped(
    mass: float, spacing: float, *, place: float = LENGTH, frames: int = 2, free: tuple[str, ...] = (),
    **of_capture: object,
) -> tuple[Predictor, Belief]:
    """A clamped strip, and a mass [kg] on the middle of its width."""
    capture = held_capture([strip(LENGTH, WIDTH, THICKNESS)], frames=frames, **of_capture)
    belief = bar_belief(
        capture, youngs_modulus=MODULUS, density=DENSITY, poissons_ratio=0.0, prestress="off", free=free
    )
    if mass:
        belief = belief.with_effect(
            "attached_mass", {"m": mass}, settings={"place": [place, 0.0, 0.5 * THICKNESS]}
        )
        belief = belief.with_parameter("attached_mass.m", free=True)
    settings = Settings(spacing, dtype="float64", workers=1, integrator=IMPLICIT)
    return Predictor(capture, capture.sequences[0], settings), belief


def cantilever(share: float, count: int) -> np.ndarray:
    """Roots k L of a clamped beam with so much of its mass at its tip: Euler and Bernoulli."""

    def rest(x: float) -> float:
        c, s, ch, sh = np.cos(x), np.sin(x), np.cosh(x), np.sinh(x)
        return 1.0 + c * ch + share * x * (c * sh - s * ch)

    starts = np.arange(0.5, 12.0, 0.05)
    roots = [brentq(rest, a, a + 0.05) for a in starts if rest(a) * rest(a + 0.05) < 0]
    return np.array(roots[:count])


@pytest.mark.parametrize("share", [0.0, 0.1, 1.0])
def test_a_strip_with_a_mass_at_its_tip_swings_as_a_beam(share: float) -> None:
    """Lumped, the third is 3 % slow without a mass, and the mass has a moment of inertia of the grid's."""
    theory = cantilever(share, 3) ** 2 / LENGTH**2 * np.sqrt(MODULUS * THICKNESS**2 / 12 / DENSITY)
    squared = natural_modes(*heavy_tipped(share * OWN, 0.005), 6).squared
    found = np.abs(np.sqrt(squared)[:, None] / theory - 1.0).min(axis=0)
    assert (found < 0.012).all(), found


def test_a_run_swings_at_the_rate_of_its_modes() -> None:
    """Set going in its third bending, four cells to half a wave; lumped it would be a tenth slower."""
    frames = 26
    predictor, belief = heavy_tipped(0.2 * OWN, 0.01, frames=frames)
    theory = cantilever(0.2, 3)[2] ** 2 / LENGTH**2 * np.sqrt(MODULUS * THICKNESS**2 / 12 / DENSITY)
    modes = natural_modes(predictor, belief, 8)
    number = int(np.abs(np.sqrt(modes.squared) - theory).argmin())
    rate, shape = np.sqrt(modes.squared[number]), modes.shape[..., number]
    timeline = predictor.timeline(belief, frames, predictor.stable_substep(belief))
    model, fields = predictor.model_of(belief), predictor.inputs(belief, timeline)
    nodes, shared = model.shared_mass(fields)
    momentum = model.node_mass(fields)[:, None] * shape
    np.subtract.at(momentum, nodes[:, 0], shared[:, None] * shape[nodes[:, 1]])
    assert (momentum * shape).sum() == pytest.approx(1.0)
    small = 1e-6
    moved = model.simulate(fields | {"velocity0": small * shape}, timeline.schedule)[0]
    swing = np.einsum("nc,fnc->f", momentum, moved) * rate / small
    times = np.r_[0.0, timeline.times] - timeline.schedule["start"]
    assert rate * times[-1] > 10.0
    np.testing.assert_allclose(swing, np.sin(rate * times), atol=0.08)


@pytest.mark.parametrize("seed", range(12))
def test_no_motion_has_less_than_a_tenth_of_its_lumped_mass_in_cells_filled_anyhow(seed: int) -> None:
    """Half of the cells, and of each a part about one of its points: they could share more than their nodes
    have, and a motion of negative mass grows a hundredfold within a few steps."""
    predictor, belief = heavy_tipped(0.0, 0.005)
    whole = predictor.body.geometry
    rng = np.random.default_rng(seed)
    there = rng.random(len(whole["part"])) < 0.5
    points, count = whole["points"][there], there.sum()
    filled = rng.uniform(0.02, 1.0, (count, 1, 1))
    about = points[np.arange(count), rng.integers(8, size=count)][:, None]
    volume = whole["volume"][there] * filled[..., 0] ** 2
    geometry = {k: v for k, v in whole.items() if not k.startswith(("row_", "hold_", "surface_"))}
    geometry |= {k: whole[k][there] for k in ("cell", "part", "sparse")}
    geometry |= {"points": about + filled * (points - about), "volume": volume}
    model = _core.TotalLagrangianFloat64(geometry, {"active": [], "law": belief.law})
    fields = core_inputs(belief, predictor.body) | {"mass": DENSITY * volume, "stress_volume": volume}
    fields |= {k: fields[k][there] for k in ("mu", "lambda")}
    lumped = np.asarray(model.node_mass(fields), float)
    nodes, shared = model.shared_mass(fields)
    mass = np.diag(lumped)
    np.subtract.at(mass, tuple(nodes.T), shared)
    np.testing.assert_array_equal(mass, mass.T)
    heavy = lumped > 1e-9 * lumped.max()
    root = np.sqrt(lumped[heavy])
    least = eigvalsh(mass[np.ix_(heavy, heavy)] / root[:, None] / root)[0]
    assert 0.0999 < least < 0.6  # something is shared


def test_slopes_by_masses_are_those_of_differences_and_of_the_adjoint() -> None:
    frames = 10
    motion = np.zeros((frames, 3))
    motion[:, 2] = 0.004 * np.sin(2 * np.pi * 4.0 * np.arange(frames) / 60.0)
    predictor, belief = heavy_tipped(
        0.2 * OWN, 0.01, frames=frames, place=0.9 * LENGTH, free=("part0.youngs_modulus", "part0.density"),
        motion=motion,
    )
    free = [p.key for p in belief.free]
    found = predictor.predict(belief, keys=free).jacobian
    weights = np.random.default_rng(1).standard_normal(found.shape[:-1])
    gradient = predict_with_gradient(predictor, belief, lambda x: weights, keys=free, last=frames)[1]
    for number, key in enumerate(free):
        step = 1e-4 * (np.arange(len(free)) == number)
        up, down = (predictor.predict(belief.at(belief.coordinates + s * step)).position for s in (1, -1))
        difference = (up - down) / 2e-4
        own = found[..., number]
        assert np.abs(difference).max() > 1e-5, key
        assert np.abs(own - difference).max() < 1e-4 * np.abs(difference).max(), key
        assert gradient[number] == pytest.approx((weights * own).sum(), rel=1e-6), key

"""The torch operation on MLS-MPM, against differences, through whole small rollouts."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

from actuation_example import actuation, channels
from bar_capture import bar_belief, bar_capture
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.fields import core_inputs
from mphygs.simulate.op import rollout, rollout_windows
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.rollout_plan import FIELD_NAMES, UserTerms, Window
from mphygs.simulate.settings import Settings

# torch itself compiles its forward-mode rules with what it calls deprecated.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")

# Of runs without an observer; test_observer.py has those with one.
FREE_FIELDS = tuple(name for name in FIELD_NAMES if name != "target")
STEPS = np.array([7, 5], np.int32)
SCHEDULE = {"steps": STEPS, "dt": np.array([4e-4, 5e-4]), "start": 0.01}
CHECK = {"eps": 1e-5, "atol": 1e-6, "rtol": 1e-4, "nondet_tol": 0.0}
ROOMY, TIGHT = 2 << 30, 120_000


def scene(budget: int = ROOMY, dtype: str = "float64") -> tuple[Belief, Predictor, object]:
    capture = bar_capture(lengths=(0.02, 0.016), side=0.02)
    belief = bar_belief(capture, youngs_modulus=(6e4, 3e4), density=(1100.0, 900.0))
    belief = belief.with_effect("viscosity", {"eta": 3.0}).with_effect("mass_damping", {"alpha": 2.0})
    belief = belief.with_effect("air_drag", {"c_d": 1.5})
    belief = belief.with_effect("relaxation", {"ratio": 0.4, "tau": 0.01})
    belief = belief.with_effect("attached_mass", {"m": 2e-3}, {"place": [0.03, 0.01, 0.01]})
    belief = belief.with_effect("tether", {"k": 3.0}, {"place": [0.033, 0.012, 0.01]})
    settings = Settings(0.012, dtype=dtype, memory_budget=budget, transfer="mls")
    predictor = Predictor(capture, capture.sequence("a"), settings)
    predictor.transfer.actuate(actuation(len(predictor.transfer.places_at_rest())))
    return belief, predictor, predictor.model_of(belief)


def all_fields(
    belief: Belief, predictor: Predictor, dtype: torch.dtype = torch.float64
) -> dict[str, torch.Tensor]:
    """Every field that a rollout reads, none of them at a special value."""
    random = np.random.default_rng(0)
    fields = core_inputs(belief, predictor.body)
    count = len(predictor.transfer.places_at_rest())
    fields["deformation0"] = np.eye(3) + 0.02 * random.standard_normal((count, 3, 3))
    fields["displacement0"] = 1e-4 * random.standard_normal((count, 3))
    fields["velocity0"] = 0.1 * random.standard_normal((count, 3))
    fields["node_force"] = 1e-3 * random.standard_normal((len(STEPS), count, 3))
    pose = np.zeros((1, STEPS.sum() + 1, 12))
    pose[..., [0, 4, 8]] = 1.0
    fields["pose"] = pose + 1e-4 * random.standard_normal(pose.shape)
    fields["channel"] = channels(len(STEPS), random)
    assert set(fields) == set(FREE_FIELDS)
    return {name: torch.tensor(value, dtype=dtype) for name, value in fields.items()}


def along(fields: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """One random direction a field, sized to the field: differences by scalars check whole rollouts."""
    generator = torch.Generator().manual_seed(1)
    size = {"displacement0": 1e-3, "velocity0": 0.3, "node_force": 1e-2, "pose": 1e-2, "deformation0": 0.1}
    directions = {}
    for name, value in fields.items():
        noise = torch.rand(value.shape, generator=generator, dtype=torch.float64) + 0.5
        directions[name] = noise * (size[name] if name in size else value)
    return directions


@pytest.mark.parametrize("budget", [ROOMY, TIGHT], ids=["roomy", "checkpointed"])
def test_gradcheck_through_a_rollout_by_every_field(budget: int) -> None:
    belief, predictor, model = scene(budget)
    fields = all_fields(belief, predictor)
    directions = along(fields)

    def run(scales: torch.Tensor) -> tuple[torch.Tensor, ...]:
        moved = {n: fields[n] + scales[k] * directions[n] for k, n in enumerate(FREE_FIELDS)}
        x, v, f = rollout(model, moved, SCHEDULE)
        return 1e3 * x, v, f

    scales = torch.zeros(len(FREE_FIELDS), dtype=torch.float64, requires_grad=True)
    gradients = torch.autograd.grad(sum(x.pow(2).sum() for x in run(scales)), scales)[0]
    assert (gradients.abs() > 1e-12).all(), "a field that moves nothing would pass unseen"
    # Random projections of the output stand for all of it: fast mode.
    assert gradcheck(run, (scales,), check_forward_ad=True, fast_mode=True, **CHECK)


def test_a_tight_budget_recomputes_and_gives_the_same_gradient() -> None:
    results = []
    for budget in (ROOMY, TIGHT):
        belief, predictor, model = scene(budget)
        fields = {n: t.requires_grad_() for n, t in all_fields(belief, predictor).items()}
        x, v, f = rollout(model, fields, SCHEDULE)
        results.append(torch.autograd.grad((x * x).sum() + v.sum() + f.sum(), list(fields.values())))
        arrays = {n: t.detach().numpy() for n, t in fields.items()}
        _, recomputed = model.adjoint(arrays, SCHEDULE, (np.ones(tuple(x.shape)), None, None))
        assert (recomputed > 0) == (budget == TIGHT)
    for roomy, tight in zip(*results, strict=True):
        assert torch.equal(roomy, tight)


def test_windows_are_single_rollouts_and_shared_gradients_add() -> None:
    belief, predictor, model = scene()
    fields = all_fields(belief, predictor)
    own = ("displacement0", "velocity0", "deformation0", "node_force", "pose", "channel")
    shared = {n: t.clone().requires_grad_() for n, t in fields.items() if n not in own}
    second = {n: fields[n] if n in ("pose", "deformation0") else 0.5 * fields[n] for n in own}
    later = {"steps": STEPS[::-1].copy(), "dt": SCHEDULE["dt"], "start": 0.05}
    windows = []
    for schedule, part in ((SCHEDULE, {n: fields[n] for n in own}), (later, second)):
        windows.append(Window(schedule, {n: t.clone().requires_grad_() for n, t in part.items()}))
    leaves = [*shared.values(), *windows[0].fields.values(), *windows[1].fields.values()]

    def gradient(runs: list) -> tuple[torch.Tensor, ...]:
        return torch.autograd.grad(sum((x * x).sum() * 1e4 + (v * v).sum() for x, v, _ in runs), leaves)

    together = gradient(list(rollout_windows(model, shared, windows, workers=2)))
    apart = gradient([rollout(model, shared | dict(w.fields), w.schedule) for w in windows])
    for a, b in zip(together, apart, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-12, atol=0)
    assert all(float(g.abs().max()) > 0 for g in together)


def test_jacfwd_carries_all_directions_at_once_and_agrees_with_jacrev() -> None:
    belief, predictor, model = scene()
    fields = all_fields(belief, predictor)

    def tip(scale: torch.Tensor) -> torch.Tensor:
        moved = fields | {
            "mu": fields["mu"] * scale[0],
            "lambda": fields["lambda"] * scale[0],
            "mass": fields["mass"] * scale[1],
        }
        return rollout(model, moved, SCHEDULE)[0][-1, :3]

    at = torch.ones(2, dtype=torch.float64)
    forward = torch.func.jacfwd(tip)(at)
    reverse = torch.autograd.functional.jacobian(tip, at)
    assert forward.shape == (3, 3, 2)
    torch.testing.assert_close(forward, reverse, rtol=1e-8, atol=1e-15)


def test_float32_follows_float64() -> None:
    values, slopes = [], []
    for name, dtype in (("float32", torch.float32), ("float64", torch.float64)):
        belief, predictor, model = scene(dtype=name)
        fields = all_fields(belief, predictor, dtype)
        fields["mu"].requires_grad_()
        x, _, _ = rollout(model, fields, SCHEDULE)
        assert x.dtype == dtype
        rest = torch.from_numpy(predictor.transfer.places_at_rest())
        values.append(x.detach().double() - rest)
        slopes.append(torch.autograd.grad(1e6 * ((x - rest.to(dtype)) ** 2).sum(), fields["mu"])[0].double())
    torch.testing.assert_close(*values, rtol=1e-4, atol=1e-7)
    assert float((slopes[0] - slopes[1]).norm() / slopes[1].norm()) < 1e-2


def test_a_motion_of_micrometres_keeps_its_digits_in_float32() -> None:
    capture = bar_capture(frames=2, fps=1000.0, fit=(0, 2))
    keys = ("part0.youngs_modulus", "part0.density")
    belief = bar_belief(capture, youngs_modulus=1e5, free=keys)
    found = {}
    for dtype in ("float32", "float64"):
        settings = Settings(0.01, workers=1, transfer="mls", dtype=dtype)
        predictor = Predictor(capture, capture.sequence("a"), settings)
        found[dtype] = predict_with_gradient(predictor, belief, np.ones_like, keys=keys, last=2, substep=2e-5)
    (seen, slope), (precise, exact) = found["float32"], found["float64"]
    assert np.abs(np.diff(precise.position, axis=0)).max() < 1e-5
    assert np.abs(exact).min() > 0.0
    # Held particles move by less than a last digit of their place, strains are less than one of F: with those
    # as the state the first derivative is off by 5 %.
    assert slope[0] == pytest.approx(exact[0], rel=1e-5)
    assert slope[1] == pytest.approx(exact[1], rel=3e-4)
    assert seen.position == pytest.approx(precise.position, abs=1e-8)


def test_effects_in_python_are_refused() -> None:
    belief, predictor, model = scene()
    user = UserTerms((), torch.zeros(0, dtype=torch.float64), predictor.body)
    with pytest.raises(ValueError, match="do not run in MLS-MPM"):
        rollout(model, all_fields(belief, predictor), SCHEDULE, user=user)


def test_an_unstable_run_is_an_error_not_a_number() -> None:
    belief, predictor, model = scene()
    fields = all_fields(belief, predictor)
    with pytest.raises(SimulationError, match="frame"):
        rollout(model, fields | {"mu": 1e6 * fields["mu"]}, SCHEDULE)

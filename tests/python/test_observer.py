"""The torch operation under feedback: derivatives through targets, windows, errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

from bar_capture import bar_belief, bar_capture
from mphygs.simulate.body import core_model, hold_boxes
from mphygs.simulate.discretisation import discretise
from mphygs.simulate.fields import core_effects, core_inputs
from mphygs.simulate.observer import Observer
from mphygs.simulate.op import States, rollout, rollout_windows
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.rollout_plan import Window
from mphygs.simulate.settings import Settings

# torch itself compiles its forward-mode rules with what it calls deprecated.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")

STEPS = np.array([7, 5, 6], np.int32)
SCHEDULE = {"steps": STEPS, "dt": np.array([4e-4, 5e-4, 3e-4]), "start": 0.01}
CHANNELS, GAP = 3, (1, 2)  # interval, channel
CHECK = {"eps": 1e-5, "atol": 1e-6, "rtol": 1e-4, "nondet_tol": 0.0}
# Room for three records and a few states of this scene: the adjoint cuts the run and recomputes.
ROOMY, TIGHT = 2 << 30, 120_000

Scene = tuple[object, dict[str, torch.Tensor], Observer]


def observer_of(count: int) -> Observer:
    """Channels that read four nodes each and pull every node, far harder than frames ask for: so that it
    shows in a few substeps. One channel is not seen in one interval."""
    random = np.random.default_rng(2)
    share = np.ones((len(STEPS), CHANNELS))
    share[GAP] = 0.0
    return Observer(
        row_begin=np.arange(0, 4 * CHANNELS + 1, 4, dtype=np.int32),
        row_carrier=random.integers(0, count, 4 * CHANNELS).astype(np.int32),
        row_weight=random.uniform(0.1, 0.4, 4 * CHANNELS),
        reach_begin=np.arange(0, 2 * count + 1, 2, dtype=np.int32),
        reach_channel=np.stack([np.arange(count) % CHANNELS, np.arange(1, count + 1) % CHANNELS], 1)
        .ravel()
        .astype(np.int32),
        reach_weight=random.uniform(0.1, 0.5, 2 * count),
        stiffness=4e4,
        damping=4e2,
        share=share,
    )


def scene(budget: int = ROOMY, number: type = np.float64) -> Scene:
    """A small bar that moves, and what pulls it elsewhere."""
    capture = bar_capture(lengths=(0.02, 0.016), side=0.02)
    belief = bar_belief(capture, youngs_modulus=(6e4, 3e4), density=(1100.0, 900.0))
    belief = belief.with_effect("viscosity", {"eta": 3.0})
    body = discretise(capture, hold_boxes(capture.sequence("a")), 0.012)
    model = core_model(
        body, active=core_effects(belief), dtype=number, law="neo-hookean", threads=1, memory_budget=budget
    )
    random = np.random.default_rng(0)
    fields = core_inputs(belief, body)
    fields["velocity0"] = 0.1 * random.standard_normal((model.node_count, 3))
    pose = np.zeros((1, STEPS.sum() + 1, 12))
    pose[..., [0, 4, 8]] = 1.0
    fields["pose"] = pose
    fields["target"] = 2e-3 * random.standard_normal((len(STEPS), CHANNELS, 4, 3))
    tensors = {name: torch.tensor(np.asarray(value, number)) for name, value in fields.items()}
    return model, tensors, observer_of(model.node_count)


def sum_of(states: States) -> torch.Tensor:
    u, v = states
    return (1e6 * u * u).sum() + (v * v).sum()


@pytest.mark.parametrize("budget", [ROOMY, TIGHT], ids=["roomy", "tight"])
def test_gradcheck_through_targets_and_a_material(budget: int) -> None:
    model, fields, observer = scene(budget)
    generator = torch.Generator().manual_seed(1)
    along = torch.randn(fields["target"].shape, generator=generator, dtype=torch.float64)

    def run(scales: torch.Tensor) -> tuple[torch.Tensor, ...]:
        moved = {
            "mu": fields["mu"] * (1.0 + scales[0]),
            "target": fields["target"] + 1e-3 * scales[1] * along,
        }
        u, v = rollout(model, fields | moved, SCHEDULE, observer=observer)
        return 1e3 * u, v

    scales = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    gradient = torch.autograd.grad(sum(x.pow(2).sum() for x in run(scales)), scales)[0]
    assert (gradient.abs() > 1e-6).all(), "a field that moves nothing would pass unseen"
    # Random projections of the output stand for all of it: fast mode.
    assert gradcheck(run, (scales,), check_forward_ad=True, fast_mode=True, **CHECK)
    if budget == TIGHT:
        arrays = {name: t.numpy() for name, t in fields.items()}
        ones = np.ones((len(STEPS) + 1, model.node_count, 3))
        given = (None, None, observer.as_dict())
        assert model.adjoint(arrays, SCHEDULE, ones, np.zeros(0), *given)[1] > 0


def test_gradcheck_of_single_coefficients_of_a_target() -> None:
    model, fields, observer = scene()

    def run(change: torch.Tensor) -> torch.Tensor:
        # All four powers of one channel in the first interval, x.
        target = fields["target"].clone()
        target[0, 1, :, 0] = target[0, 1, :, 0] + change
        return 1e3 * rollout(model, fields | {"target": target}, SCHEDULE, observer=observer)[0][1:, ::7]

    start = torch.zeros(4, dtype=torch.float64, requires_grad=True)
    slopes = torch.autograd.functional.jacobian(run, start)
    assert (slopes.abs().amax((0, 1, 2)) > 1e-3).all()
    assert gradcheck(run, (start,), check_forward_ad=True, **CHECK)


def test_jacfwd_through_targets_agrees_with_jacrev() -> None:
    model, fields, observer = scene()

    def tip(scale: torch.Tensor) -> torch.Tensor:
        moved = fields | {"mu": fields["mu"] * scale[0], "target": fields["target"] * scale[1:, None, None]}
        return rollout(model, moved, SCHEDULE, observer=observer)[0][-1, :3]

    at = torch.ones(1 + CHANNELS, dtype=torch.float64)
    forward = torch.func.jacfwd(tip)(at)
    reverse = torch.autograd.functional.jacobian(tip, at)
    assert forward.shape == (3, 3, 1 + CHANNELS) and (forward.abs().amax((0, 1)) > 0).all()
    torch.testing.assert_close(forward, reverse, rtol=1e-8, atol=1e-15)


def test_a_gap_has_no_slope_and_all_gaps_are_a_free_run_to_the_bit() -> None:
    model, fields, observer = scene()
    target = fields["target"].clone().requires_grad_()
    pulled = rollout(model, fields | {"target": target}, SCHEDULE, observer=observer)
    slope = torch.autograd.grad(sum_of(pulled), target)[0].abs().amax((2, 3))
    assert float(slope[GAP]) == 0.0 and int((slope > 0).sum()) == slope.numel() - 1
    free = rollout(model, {n: t for n, t in fields.items() if n != "target"}, SCHEDULE)
    blind = replace(observer, share=np.zeros_like(observer.share))
    for one, same, other in zip(free, rollout(model, fields, SCHEDULE, observer=blind), pulled, strict=True):
        assert torch.equal(one, same) and float((one - other).detach().abs().max()) > 1e-6


def test_windows_have_observers_of_their_own() -> None:
    model, fields, observer = scene()
    shared = {n: t.clone().requires_grad_() for n, t in fields.items() if n != "target"}
    aims = [fields["target"].clone().requires_grad_(), (0.5 * fields["target"]).requires_grad_()]
    later = SCHEDULE | {"start": 0.05}
    windows = [
        Window(SCHEDULE, {"target": aims[0]}, observer),
        Window(SCHEDULE),
        Window(later, {"target": aims[1]}, observer.scaled(0.3)),
    ]
    leaves = [shared["mu"], shared["mass"], *aims]

    def outcome(runs: list[States]) -> tuple[torch.Tensor, ...]:
        return torch.autograd.grad(sum(sum_of(r) for r in runs), leaves)

    together = list(rollout_windows(model, shared, windows, workers=2))
    serial = list(rollout_windows(model, shared, windows, workers=1))
    apart = [rollout(model, shared | dict(w.fields), w.schedule, observer=w.observer) for w in windows]
    for a, b, c in zip(together, serial, apart, strict=True):
        assert all(torch.equal(x, y) and torch.equal(x, z) for x, y, z in zip(a, b, c, strict=True))
    assert not torch.equal(together[0][0], together[1][0])
    assert not torch.equal(together[1][0], together[2][0])
    for a, b, c in zip(outcome(together), outcome(serial), outcome(apart), strict=True):
        assert torch.equal(a, b) and float(a.abs().max()) > 0
        torch.testing.assert_close(a, c, rtol=1e-12, atol=0)


def test_float32_follows_float64() -> None:
    values, slopes = [], []
    for number in (np.float32, np.float64):
        model, fields, observer = scene(number=number)
        fields["target"].requires_grad_()
        states = rollout(model, fields, SCHEDULE, observer=observer)
        values.append(states[0].detach().double())
        slopes.append(torch.autograd.grad(sum_of(states), fields["target"])[0].double())
    torch.testing.assert_close(*values, rtol=1e-4, atol=1e-7)
    assert float((slopes[0] - slopes[1]).norm() / slopes[1].norm()) < 1e-3


def test_what_does_not_fit_is_named() -> None:
    model, fields, observer = scene()
    free = {n: t for n, t in fields.items() if n != "target"}
    with pytest.raises(ValueError, match="the fields have a target but there is no observer"):
        rollout(model, fields, SCHEDULE)
    with pytest.raises(ValueError, match=r"observer: fields' target must be \(intervals, channels, 4, 3\)"):
        rollout(model, free, SCHEDULE, observer=observer)
    with pytest.raises(ValueError, match="fields' target must be"):
        rollout(model, free | {"target": fields["target"][:, 1:]}, SCHEDULE, observer=observer)
    with pytest.raises(ValueError, match="'target' is torch.float32 on cpu, expected torch.float64"):
        rollout(model, free | {"target": fields["target"].float()}, SCHEDULE, observer=observer)
    with pytest.raises(ValueError, match=r"observer: share must be \(intervals, channels\)"):
        rollout(model, fields, SCHEDULE, observer=replace(observer, share=observer.share[1:]))
    far = replace(observer, row_carrier=observer.row_carrier + model.node_count)
    with pytest.raises(ValueError, match="observer: row names a number out of range"):
        rollout(model, fields, SCHEDULE, observer=far)


def particles(dtype: str = "float64", budget: int = ROOMY) -> Scene:
    """The same bar as particles of MLS-MPM. A block of eight is pulled alike, the last one not at all."""
    capture = bar_capture(lengths=(0.02, 0.016), side=0.02)
    belief = bar_belief(capture, youngs_modulus=(6e4, 3e4), density=(1100.0, 900.0))
    belief = belief.with_effect("viscosity", {"eta": 3.0})
    settings = Settings(0.012, dtype=dtype, memory_budget=budget, transfer="mls")
    predictor = Predictor(capture, capture.sequence("a"), settings)
    random, count = np.random.default_rng(0), len(predictor.transfer.places_at_rest())
    fields = core_inputs(belief, predictor.body)
    fields["velocity0"] = 0.1 * random.standard_normal((count, 3))
    pose = np.zeros((1, STEPS.sum() + 1, 12))
    pose[..., [0, 4, 8]] = 1.0
    fields["pose"] = pose
    fields["target"] = 2e-3 * random.standard_normal((len(STEPS), CHANNELS, 4, 3))
    tensors = {name: torch.tensor(np.asarray(value, settings.number)) for name, value in fields.items()}
    row = np.arange(count, dtype=np.int32) // 8
    alike = observer_of(row[-1])
    read = np.random.default_rng(2).integers(0, count, len(alike.row_carrier)).astype(np.int32)
    observer = replace(alike, row_carrier=read, reach_row=np.where(row == row[-1], -1, row).astype(np.int32))
    return predictor.model_of(belief), tensors, observer


@pytest.mark.parametrize("budget", [ROOMY, TIGHT], ids=["roomy", "tight"])
def test_gradcheck_on_particles(budget: int) -> None:
    model, fields, observer = particles(budget=budget)
    names = ("mu", "mass", "velocity0", "target")

    def run(scales: torch.Tensor) -> tuple[torch.Tensor, ...]:
        moved = {name: fields[name] * (1.0 + scales[k]) for k, name in enumerate(names)}
        x, v, f = rollout(model, fields | moved, SCHEDULE, observer=observer)
        return 1e3 * x, v, f

    scales = torch.zeros(len(names), dtype=torch.float64, requires_grad=True)
    gradient = torch.autograd.grad(sum(x.pow(2).sum() for x in run(scales)), scales)[0]
    assert (gradient.abs() > 1e-9).all(), "a field that moves nothing would pass unseen"
    assert gradcheck(run, (scales,), check_forward_ad=True, fast_mode=True, **CHECK)


def test_particles_in_many_lanes_in_float32_and_in_gaps() -> None:
    model, fields, observer = particles()

    def tip(scale: torch.Tensor) -> torch.Tensor:
        moved = fields | {"mu": fields["mu"] * scale[0], "target": fields["target"] * scale[1:, None, None]}
        return rollout(model, moved, SCHEDULE, observer=observer)[0][-1, :3]

    at = torch.ones(1 + CHANNELS, dtype=torch.float64)
    forward, reverse = torch.func.jacfwd(tip)(at), torch.autograd.functional.jacobian(tip, at)
    assert (forward.abs().amax((0, 1)) > 0).all()
    torch.testing.assert_close(forward, reverse, rtol=1e-8, atol=1e-15)
    narrow, single, _ = particles("float32")
    pulled = rollout(model, fields, SCHEDULE, observer=observer)
    torch.testing.assert_close(
        rollout(narrow, single, SCHEDULE, observer=observer)[1].double(), pulled[1], rtol=0.0, atol=1e-4
    )
    free = rollout(model, {n: t for n, t in fields.items() if n != "target"}, SCHEDULE)
    blind = replace(observer, share=np.zeros_like(observer.share))
    for one, same, other in zip(free, rollout(model, fields, SCHEDULE, observer=blind), pulled, strict=True):
        assert torch.equal(one, same) and float((one - other).abs().max()) > 1e-6
    with pytest.raises(ValueError, match="observer: reach_row names a row out of range"):
        rollout(model, fields, SCHEDULE, observer=replace(observer, reach_row=observer.reach_row + 2))

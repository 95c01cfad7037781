"""The torch operations against differences, through whole rollouts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad, gradcheck

from actuation_example import actuation, channels
from bar_capture import bar_belief, bar_capture
from mphygs.model.belief import Belief
from mphygs.simulate.body import Body, core_model, hold_boxes
from mphygs.simulate.discretisation import discretise
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.fields import core_effects, core_inputs, places
from mphygs.simulate.marker_map import MarkerMap, polar_rotation
from mphygs.simulate.op import rollout, rollout_windows
from mphygs.simulate.rest_op import RestSolver, node_mass, stress_free_state
from mphygs.simulate.rollout_plan import FIELD_NAMES, Window

# torch itself compiles its forward-mode rules with what it calls deprecated.
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")

# Of runs without an observer; test_observer.py has those with one.
FREE_FIELDS = tuple(name for name in FIELD_NAMES if name != "target")
STEPS = np.array([7, 5], np.int32)
SCHEDULE = {"steps": STEPS, "dt": np.array([4e-4, 5e-4]), "start": 0.01}
# The core's own round-off, seen through differences with this step.
CHECK = {"eps": 1e-5, "atol": 1e-6, "rtol": 1e-4, "nondet_tol": 0.0}


def scene(budget: int = 2 << 30, dtype: type = np.float64) -> tuple[Belief, Body, object]:
    capture = bar_capture(lengths=(0.02, 0.016), side=0.02)
    belief = bar_belief(capture, youngs_modulus=(6e4, 3e4), density=(1100.0, 900.0))
    belief = belief.with_effect("viscosity", {"eta": 3.0}).with_effect("mass_damping", {"alpha": 2.0})
    belief = belief.with_effect("air_drag", {"c_d": 1.5}).with_effect(
        "relaxation", {"ratio": 0.4, "tau": 0.01}
    )
    belief = belief.with_effect("attached_mass", {"m": 2e-3}, {"place": [0.03, 0.01, 0.01]})
    belief = belief.with_effect("tether", {"k": 3.0}, {"place": [0.033, 0.012, 0.01]})
    spots = places(belief)
    body = discretise(capture, hold_boxes(capture.sequence("a")), 0.012, places=spots)
    options = {"dtype": dtype, "law": "neo-hookean", "threads": 1, "memory_budget": budget}
    nodes = core_model(body, active=(), **options).node_count
    body = replace(body, geometry=body.geometry | {"actuation": actuation(nodes)})
    return belief, body, core_model(body, active=core_effects(belief), **options)


def all_fields(
    belief: Belief, body: Body, model: object, dtype: torch.dtype = torch.float64
) -> dict[str, torch.Tensor]:
    """Every field that a rollout reads, none of them at a special value."""
    random = np.random.default_rng(0)
    fields = core_inputs(belief, body)
    blocks, nodes = body.block_count, model.node_count
    fields["deformation0"] = np.tile(np.eye(3).reshape(9, 1), (blocks, 1, 8)) + 0.02 * random.standard_normal(
        (blocks, 9, 8)
    )
    fields["displacement0"] = 1e-4 * random.standard_normal((nodes, 3))
    fields["velocity0"] = 0.1 * random.standard_normal((nodes, 3))
    fields["node_force"] = 1e-3 * random.standard_normal((len(STEPS), nodes, 3))
    pose = np.zeros((1, STEPS.sum() + 1, 12))
    pose[..., [0, 4, 8]] = 1.0
    fields["pose"] = pose + 1e-4 * random.standard_normal(pose.shape)
    fields["channel"] = channels(len(STEPS), random)
    assert set(fields) == set(FREE_FIELDS)
    return {name: torch.tensor(value, dtype=dtype) for name, value in fields.items()}


def along(fields: dict[str, torch.Tensor], names: tuple[str, ...]) -> dict[str, torch.Tensor]:
    """One random direction a field, sized to the field: differences by scalars check whole rollouts."""
    generator = torch.Generator().manual_seed(1)
    size = {"displacement0": 1e-3, "velocity0": 0.3, "node_force": 1e-2, "pose": 1e-2, "deformation0": 0.1}
    directions = {}
    for name in names:
        noise = torch.rand(fields[name].shape, generator=generator, dtype=torch.float64) + 0.5
        directions[name] = noise * (size[name] if name in size else fields[name])
    return directions


# Room for three records and a few states of this scene: the adjoint cuts the run and recomputes.
@pytest.mark.parametrize("budget", [2 << 30, 120_000], ids=["roomy", "tight"])
def test_gradcheck_through_a_rollout_by_every_field(budget: int) -> None:
    belief, body, model = scene(budget)
    fields = all_fields(belief, body, model)
    directions = along(fields, FREE_FIELDS)

    def run(scales: torch.Tensor) -> tuple[torch.Tensor, ...]:
        moved = {n: fields[n] + scales[k] * directions[n] for k, n in enumerate(FREE_FIELDS)}
        u, v = rollout(model, moved, SCHEDULE)
        return 1e3 * u, v

    scales = torch.zeros(len(FREE_FIELDS), dtype=torch.float64, requires_grad=True)
    gradients = torch.autograd.grad(sum(x.pow(2).sum() for x in run(scales)), scales)[0]
    assert (gradients.abs() > 1e-12).all(), "a field that moves nothing would pass unseen"
    # Random projections of the output stand for all of it: fast mode.
    assert gradcheck(run, (scales,), check_forward_ad=True, fast_mode=True, **CHECK)


def test_a_tight_budget_recomputes_and_gives_the_same_gradient() -> None:
    results = []
    for budget in (2 << 30, 120_000):
        belief, body, model = scene(budget)
        fields = {n: t.requires_grad_() for n, t in all_fields(belief, body, model).items()}
        u, v = rollout(model, fields, SCHEDULE)
        results.append(torch.autograd.grad((u * u).sum() + v.sum(), list(fields.values())))
        arrays = {n: t.detach().numpy() for n, t in fields.items()}
        _, recomputed = model.adjoint(arrays, SCHEDULE, np.ones(tuple(u.shape)), np.zeros(0))
        assert (recomputed > 0) == (budget == 120_000)
    for roomy, tight in zip(*results, strict=True):
        assert torch.equal(roomy, tight)


def test_gradcheck_of_single_entries() -> None:
    belief, body, model = scene()
    fields = all_fields(belief, body, model)
    for name in ("mu", "gravity", "place_mass", "place_effect"):
        start = torch.zeros(min(fields[name].numel(), 4), dtype=torch.float64, requires_grad=True)

        def run(change: torch.Tensor, name: str = name) -> torch.Tensor:
            scale = fields[name].abs().max().clamp_min(1e-2)
            padded = torch.cat([change, torch.zeros(fields[name].numel() - len(change), dtype=torch.float64)])
            return (
                1e3
                * rollout(
                    model,
                    fields | {name: fields[name] + scale * padded.reshape(fields[name].shape)},
                    SCHEDULE,
                )[0][-1, ::17]
            )

        assert gradcheck(run, (start,), check_forward_ad=True, **CHECK)


def test_windows_are_single_rollouts_and_shared_gradients_add() -> None:
    belief, body, model = scene()
    fields = all_fields(belief, body, model)
    own = ("displacement0", "velocity0", "node_force", "pose", "channel")
    shared = {n: t.clone().requires_grad_() for n, t in fields.items() if n not in own}
    second = {n: 0.5 * fields[n] for n in own if n != "pose"} | {"pose": fields["pose"]}
    later = {"steps": STEPS[::-1].copy(), "dt": SCHEDULE["dt"], "start": 0.05}
    windows = []
    for schedule, part in ((SCHEDULE, {n: fields[n] for n in own}), (later, second)):
        windows.append(Window(schedule, {n: t.clone().requires_grad_() for n, t in part.items()}))
    leaves = [*shared.values(), *windows[0].fields.values(), *windows[1].fields.values()]

    def gradient(runs: list) -> tuple[torch.Tensor, ...]:
        return torch.autograd.grad(
            sum((u * u).sum() * 1e4 + (v * v).sum() for u, v in runs), leaves, allow_unused=True
        )

    together = gradient(list(rollout_windows(model, shared, windows, workers=2)))
    serial = gradient(list(rollout_windows(model, shared, windows, workers=1)))
    apart = gradient([rollout(model, shared | dict(w.fields), w.schedule) for w in windows])
    for a, b, c in zip(together, serial, apart, strict=True):
        assert torch.equal(a, b)
        torch.testing.assert_close(a, c, rtol=1e-12, atol=0)
    assert all(float(g.abs().max()) > 0 for g in together)


def test_jacfwd_carries_all_directions_at_once_and_agrees_with_jacrev() -> None:
    belief, body, model = scene()
    fields = all_fields(belief, body, model)

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
    for number, dtype in ((np.float32, torch.float32), (np.float64, torch.float64)):
        belief, body, model = scene(dtype=number)
        fields = all_fields(belief, body, model, dtype)
        fields["mu"].requires_grad_()
        u, _ = rollout(model, fields, SCHEDULE)
        assert u.dtype == dtype
        values.append(u.detach().double())
        slopes.append(torch.autograd.grad(1e6 * (u * u).sum(), fields["mu"])[0].double())
    torch.testing.assert_close(*values, rtol=1e-4, atol=1e-7)
    assert float((slopes[0] - slopes[1]).norm() / slopes[1].norm()) < 1e-2


def test_one_output_alone_may_be_used() -> None:
    belief, body, model = scene()
    fields = all_fields(belief, body, model)
    fields["velocity0"].requires_grad_()
    _, v = rollout(model, fields, SCHEDULE)
    assert float(torch.autograd.grad(v.sum(), fields["velocity0"])[0].abs().max()) > 0


def test_second_derivatives_are_refused() -> None:
    belief, body, model = scene()
    fields = all_fields(belief, body, model)
    fields["mu"].requires_grad_()
    u, _ = rollout(model, fields, SCHEDULE)
    slope = torch.autograd.grad((u * u).sum(), fields["mu"], create_graph=True)[0]
    with pytest.raises(NotImplementedError, match="first derivatives only"):
        slope.sum().backward()
    with forward_ad.dual_level(), pytest.raises(NotImplementedError, match="first derivatives only"):
        dual = fields | {"mu": forward_ad.make_dual(fields["mu"], torch.ones_like(fields["mu"]))}
        u, _ = rollout(model, dual, SCHEDULE)
        torch.autograd.grad((u * u).sum(), fields["mu"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stiffness": torch.zeros(3)}, "unknown field 'stiffness', expected one of mu"),
        ({"gravity": torch.zeros(3)}, "torch.float32 on cpu, expected torch.float64"),
        ({"gravity": torch.zeros(4, dtype=torch.float64)}, "gravity"),
    ],
)
def test_wrong_fields_are_named(change: dict, message: str) -> None:
    belief, body, model = scene()
    with pytest.raises(ValueError, match=message):
        rollout(model, all_fields(belief, body, model) | change, SCHEDULE)


def test_an_unstable_run_is_an_error_not_a_number() -> None:
    belief, body, model = scene()
    fields = all_fields(belief, body, model)
    with pytest.raises(SimulationError, match="frame"):
        rollout(model, fields | {"mu": 1e6 * fields["mu"]}, SCHEDULE)


def test_polar_rotation_is_differentiable_at_rest() -> None:
    generator = torch.Generator().manual_seed(2)
    f = torch.eye(3, dtype=torch.float64) + 0.3 * torch.randn(
        4, 3, 3, generator=generator, dtype=torch.float64
    )
    f[0] = torch.eye(3)
    rotation = polar_rotation(f)
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3, dtype=torch.float64).expand(4, 3, 3))
    stretch = rotation.mT @ f
    torch.testing.assert_close(stretch, stretch.mT)
    assert gradcheck(polar_rotation, (f.requires_grad_(),), check_forward_ad=True)


def test_marker_positions_follow_a_rigid_motion_and_are_differentiable() -> None:
    _, body, model = scene()
    points = np.array([[0.03, 0.01, 0.022], [0.02, 0.005, 0.01]])
    attached = body.attach(points)
    assert np.abs(attached.offset).max() > 1e-3
    seen = MarkerMap.build(model, attached.anchor, attached.offset, attached.cell)
    angle = 0.7
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    shift = np.array([0.1, -0.2, 0.3])
    nodes = model.node_positions
    u = torch.from_numpy(nodes @ turn.T + shift - nodes)[None]
    np.testing.assert_allclose(seen.positions(u)[0].numpy(), points @ turn.T + shift, atol=1e-12)
    touched = torch.unique(seen.node)[:6]

    def positions(change: torch.Tensor) -> torch.Tensor:
        return seen.positions(u.index_add(1, touched, change[None]))

    start = torch.zeros(6, 3, dtype=torch.float64, requires_grad=True)
    assert gradcheck(positions, (start,), check_forward_ad=True)


def test_rest_shape_derivatives_by_differences() -> None:
    capture = bar_capture(lengths=(0.02, 0.016), side=0.02)
    belief = bar_belief(capture, youngs_modulus=(2e4, 1e4)).with_effect("stiffening", {"c_2": 500.0})
    body = discretise(capture, hold_boxes(capture.sequence("a")), 0.012)
    model = core_model(
        body, active=("stiffening",), dtype=np.float64, law="neo-hookean", threads=1, memory_budget=1 << 20
    )
    solver = RestSolver(model)
    fields = {n: torch.from_numpy(np.asarray(v)) for n, v in core_inputs(belief, body).items()}
    volume = torch.from_numpy(body.quadrature.volumes)

    def state(scales: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        load = node_mass(model, body.geometry, scales[3] * fields["mass"])[:, None] * (
            fields["gravity"] + scales[4]
        )
        return stress_free_state(
            solver, mu=scales[0] * fields["mu"], lame_lambda=scales[1] * fields["lambda"],
            effect=scales[2] * fields["effect"], load=load, volume=volume,
        )  # fmt: skip

    start = torch.tensor([1.0, 1.0, 1.0, 1.0, 0.0], dtype=torch.float64, requires_grad=True)
    f, ratio = state(start)
    determinant = torch.linalg.det(f.reshape(-1, 3, 3, 8).permute(0, 3, 1, 2))
    torch.testing.assert_close(determinant * ratio, torch.ones_like(ratio))
    assert float((f.detach() - torch.eye(3).reshape(9, 1)).abs().max()) > 1e-3
    assert gradcheck(state, (start,), check_forward_ad=True, fast_mode=True, eps=1e-4, atol=1e-7, rtol=1e-4)
    # The derivative belongs to the state it was taken at, whatever was solved in between.
    loss = ratio.pow(3).sum()
    state(2.0 * start.detach())
    late = torch.autograd.grad(loss, start)[0]
    again = torch.autograd.grad(state(start)[1].pow(3).sum(), start)[0]
    torch.testing.assert_close(late, again, rtol=1e-6, atol=1e-12)
    with pytest.raises(ValueError, match="published volume"):
        stress_free_state(
            solver, mu=fields["mu"], lame_lambda=fields["lambda"], effect=fields["effect"],
            load=torch.zeros(model.node_count, 3, dtype=torch.float64),
            volume=volume.clone().requires_grad_(),
        )  # fmt: skip


def test_node_mass_is_the_models_own() -> None:
    belief, body, model = scene()
    mass = torch.from_numpy(core_inputs(belief, body)["mass"])
    without = core_inputs(belief, body) | {"place_mass": np.zeros(len(places(belief)))}
    np.testing.assert_allclose(
        node_mass(model, body.geometry, mass).numpy(), model.node_mass(without), rtol=1e-12
    )

"""Effects in Python: values against compiled ones, all derivatives, registration, the documented example."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from bar_capture import bar_belief, bar_capture
from mphygs.fit.placement import with_placed_effect
from mphygs.model import user_effect
from mphygs.model.registry import ParameterSpec, effect, effects
from mphygs.model.user_effect import UserEffect, load_plugin, register_effect
from mphygs.simulate import discretisation
from mphygs.simulate.body import core_model
from mphygs.simulate.fields import core_inputs
from mphygs.simulate.op import rollout
from mphygs.simulate.prediction import Predictor, Settings
from mphygs.simulate.rollout_plan import UserTerms
from mphygs.simulate.settings import check_effects

pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")

SPACING = 0.012
SETTINGS = Settings(SPACING, dtype="float64", workers=2)
DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "effects.md"


class ExtraWeight:
    """A further weight, m times a vector down."""

    name = "extra_weight"
    parameters = (ParameterSpec("g", "m/s^2", 0.0, -10.0, 10.0, 1.0),)

    def force(self, state, parameters):
        return -parameters["g"] * state.mass[:, None] * torch.eye(3, dtype=state.mass.dtype)[2]


class Stiffer:
    """A second neo-Hookean solid in parallel."""

    name = "stiffer"
    parameters = (
        ParameterSpec("e", "Pa", 0.0, 0.0, 1e9, 1e4),
        ParameterSpec("nu", "-", 0.3, 0.0, 0.49, 0.1, fitted=False),
    )

    def stress(self, state, parameters):
        e, nu = parameters["e"], parameters["nu"]
        mu, lame = e / (2 * (1 + nu)), e * nu / ((1 + nu) * (1 - 2 * nu))
        f = state.deformation
        inverse = torch.linalg.inv(f).mT
        return mu * (f - inverse) + lame * torch.logdet(f)[:, None, None] * inverse


class Everything(UserEffect):
    """A force that reads all of the state."""

    name = "everything"
    parameters = (
        ParameterSpec("a", "1", 0.0, -10.0, 10.0, 1.0),
        ParameterSpec("b", "1/s", 0.0, 0.0, 100.0, 1.0),
    )

    def force(self, state, parameters):
        stretch = (state.deformation.square().sum((1, 2)) - 3.0)[:, None] + 0.1
        along = state.position * np.cos(9.0 * state.time) * (1.0 + state.part[:, None])
        damping = parameters["b"] * state.mass[:, None] * state.velocity
        return parameters["a"] * stretch * along * 1e4 * state.volume[:, None] - damping


class Brake(UserEffect):
    """Braked above a speed, not below it."""

    name = "brake"
    kind = "threshold"
    parameters = (
        ParameterSpec("limit", "m/s", 1e3, 1e-4, 1e3, 0.1, role="level", scan=(1e-2, 1.0)),
        ParameterSpec("beta", "1/s", 20.0, 0.0, 1e3, 10.0, fitted=False),
    )

    def force(self, state, parameters):
        speed = (state.velocity.square().sum(-1, keepdim=True) + 1e-12).sqrt()
        beyond = torch.relu(speed - parameters["limit"])
        return -parameters["beta"] * state.mass[:, None] * beyond / speed * state.velocity


class Along(UserEffect):
    """A steady pull along an axis."""

    name = "along"
    parameters = (
        ParameterSpec("pull", "m/s^2", 0.0, -10.0, 10.0, 1.0),
        *(ParameterSpec(f"n_{a}", "-", 0.0, -1.0, 1.0, 1.0, fitted=False, role="axis") for a in "xyz"),
    )

    def force(self, state, parameters):
        axis = torch.stack([parameters[f"n_{a}"] for a in "xyz"])
        return parameters["pull"] * state.mass[:, None] * axis


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The effects above, and nothing left of them afterwards."""
    from mphygs.model import registry

    monkeypatch.setattr(registry, "_USER", {})
    monkeypatch.setattr(user_effect, "_IMPLEMENTATIONS", {})
    for cls in (ExtraWeight, Stiffer, Everything, Brake, Along):
        register_effect(cls)
    yield


def predictor(rest: str = "stress-free") -> Predictor:
    capture = bar_capture(lengths=(0.024, 0.024), frames=6, fps=50.0, rest=rest)
    return Predictor(capture, capture.sequence("a"), SETTINGS)


def belief(one: Predictor, **options: object):
    return bar_belief(one.capture, youngs_modulus=(4e4, 2e4), **options)


def test_a_weight_in_python_is_the_compiled_one() -> None:
    one = predictor()
    base = belief(one)
    keys = ("part0.density", "part1.youngs_modulus")
    mine = one.predict(
        base.with_effect("extra_weight", {"g": 3.0}), keys=(*keys, "extra_weight.g"), substep=2e-4
    )
    compiled = one.predict(
        base.with_effect("gravity", {"delta_g_z": -3.0}), keys=(*keys, "gravity.delta_g_z"), substep=2e-4
    )
    np.testing.assert_allclose(mine.position, compiled.position, atol=1e-14)
    scale = np.array(
        [1.0, 1.0, -effect("extra_weight").parameters[0].scale / effect("gravity").parameters[2].scale]
    )
    np.testing.assert_allclose(mine.jacobian, compiled.jacobian * scale, atol=1e-13)
    assert np.abs(mine.position - one.predict(base, substep=2e-4).position).max() > 1e-4


@pytest.mark.parametrize("prestress", ["off", "equilibrium"])
def test_a_stress_in_python_is_the_compiled_one(prestress: str, monkeypatch: pytest.MonkeyPatch) -> None:
    one = predictor("equilibrium" if prestress == "equilibrium" else "stress-free")
    soft = belief(one, prestress=prestress)
    mine = one.predict(soft.with_effect("stiffer", {"e": 1e4}), keys=("stiffer.e",), substep=2e-4)
    if prestress == "off":
        # The springs of sparsely filled cells go by the modulus of the part: a law alone has none.
        monkeypatch.setattr(discretisation, "SPARSE", 0.0)
        one = predictor("stress-free")
        mine = one.predict(soft.with_effect("stiffer", {"e": 1e4}), keys=("stiffer.e",), substep=2e-4)
        stiff = bar_belief(one.capture, youngs_modulus=(5e4, 3e4))
        np.testing.assert_allclose(mine.position, one.predict(stiff, substep=2e-4).position, atol=1e-13)
    step = 10.0
    sides = [
        one.predict(soft.with_effect("stiffer", {"e": 1e4 + s}), substep=2e-4).position for s in (step, -step)
    ]
    slope = (sides[0] - sides[1]) / (2 * step) * effect("stiffer").parameters[0].scale
    assert np.abs(slope).max() > 1e-5
    np.testing.assert_allclose(mine.jacobian[..., 0], slope, atol=1e-4 * np.abs(slope).max())


def test_tangents_by_all_parameters_are_differences() -> None:
    one = predictor()
    base = belief(one, free=("part0.density", "part0.youngs_modulus"))
    model = base.with_effect("everything", {"a": 0.5, "b": 3.0})
    keys = tuple(p.key for p in model.free)
    assert keys == ("part0.youngs_modulus", "part0.density", "everything.a", "everything.b")
    got = one.predict(model, keys=keys, substep=2e-4)
    for k in range(len(keys)):
        step = np.zeros(len(keys))
        step[k] = 1e-5
        sides = [one.predict(model.at(model.coordinates + s * step), substep=2e-4).position for s in (1, -1)]
        slope = (sides[0] - sides[1]) / 2e-5
        assert np.abs(slope).max() > 1e-6, keys[k]
        np.testing.assert_allclose(
            got.jacobian[..., k], slope, atol=1e-5 * np.abs(slope).max(), err_msg=keys[k]
        )


def test_a_candidate_at_its_null_is_scored_like_any_other() -> None:
    one = predictor()
    base = belief(one)
    mine, compiled = base.with_effect("extra_weight"), base.with_effect("gravity")
    candidates = [(mine, mine["extra_weight.g"]), (compiled, compiled["gravity.delta_g_z"])]
    got = one.predict(base, candidates=candidates, substep=2e-4)
    np.testing.assert_allclose(got.position, one.predict(base, substep=2e-4).position, atol=1e-14)
    ratio = -effect("extra_weight").parameters[0].scale / effect("gravity").parameters[2].scale
    np.testing.assert_allclose(got.jacobian[..., 0], ratio * got.jacobian[..., 1], atol=1e-13)
    assert np.abs(got.jacobian[..., 0]).max() > 1e-4


def test_a_threshold_tells_how_it_is_tried_and_has_a_derivative_where_it_acts() -> None:
    spec = effect("brake")
    assert spec.threshold and not spec.history and not spec.fault
    assert {role: [p.name for p in own] for role, own in spec.scanned.items()} == {"level": ["limit"]}
    assert spec.scanned["level"][0].range == (1e-2, 1.0)
    one = predictor()
    base = belief(one)
    with pytest.raises(ValueError, match="a fit cannot start from its absence"):
        with_placed_effect(base, "brake", one.capture, ("a",))
    null = base.with_effect("brake")
    absent = one.predict(null, keys=("brake.limit",), substep=2e-4)
    # Beside a derivative as well: a run of values alone is compiled otherwise, to other last bits.
    beside = one.predict(base, keys=("part0.youngs_modulus",), substep=2e-4)
    np.testing.assert_array_equal(absent.position, beside.position)
    assert not absent.jacobian.any()
    # A level is fitted in its logarithm, as a yield stress is.
    model = base.with_effect("brake", {"limit": 0.05})
    assert model["brake.limit"].log
    got = one.predict(model, keys=("brake.limit",), substep=2e-4)
    (place,) = np.flatnonzero([p.key == "brake.limit" for p in model.free])
    step = np.zeros(len(model.free))
    step[place] = 1e-5
    sides = [one.predict(model.at(model.coordinates + s * step), substep=2e-4).position for s in (1, -1)]
    slope = (sides[0] - sides[1]) / 2e-5
    assert np.abs(slope).max() > 1e-6
    np.testing.assert_allclose(got.jacobian[..., 0], slope, atol=1e-4 * np.abs(slope).max())


def test_an_axis_begins_along_the_largest_part() -> None:
    one = predictor()
    model = with_placed_effect(belief(one), "along", one.capture, ("a",))
    axis = [model[f"along.n_{a}"].value for a in "xyz"]
    assert np.linalg.norm(axis) == pytest.approx(1.0) and np.isclose(np.abs(axis), 1.0).any()
    assert model["along.pull"].value == 0.0 and model["along.pull"].free
    assert np.abs(one.predict(model, keys=("along.pull",), substep=2e-4).jacobian).max() > 1e-4


@pytest.mark.parametrize("budget", [2 << 30, 120_000], ids=["roomy", "tight"])
def test_adjoint_and_tangent_through_the_operation(budget: int) -> None:
    one = predictor()
    fields = {
        n: torch.from_numpy(np.asarray(v, float)) for n, v in core_inputs(belief(one), one.body).items()
    }
    schedule = {"steps": np.array([9, 8], np.int32), "dt": np.array([3e-4, 3e-4]), "start": 0.02}
    pose = np.zeros((1, 18, 12))
    pose[..., [0, 4, 8]] = 1.0
    fields["pose"] = torch.from_numpy(pose)
    random = np.random.default_rng(1)
    blocks = one.body.block_count
    noise = 0.02 * random.standard_normal((blocks, 9, 8))
    fields["deformation0"] = torch.from_numpy(np.eye(3).reshape(9, 1) + noise)
    model = core_model(
        one.body, active=(), dtype=np.float64, law="neo-hookean", threads=1, memory_budget=budget
    )
    names = ("mu", "mass", "stress_volume", "deformation0")

    def run(scales: torch.Tensor) -> tuple[torch.Tensor, ...]:
        moved = fields | {n: fields[n] * scales[k] for k, n in enumerate(names)}
        user = UserTerms(
            ("everything", "stiffer"), torch.cat([scales[4:6], 1e4 * scales[6:7], 0.3 * scales[7:]]), one.body
        )
        u, v = rollout(model, moved, schedule, user=user)
        return 1e3 * u, v

    scales = torch.tensor([1.0, 1.0, 1.0, 1.0, 0.5, 3.0, 1.0, 1.0], dtype=torch.float64, requires_grad=True)
    gradient = torch.autograd.grad(sum(x.square().sum() for x in run(scales)), scales)[0]
    assert (gradient.abs() > 1e-10).all()
    options = {"eps": 1e-5, "atol": 1e-6, "rtol": 1e-4}
    assert torch.autograd.gradcheck(run, (scales,), check_forward_ad=True, fast_mode=True, **options)


def test_the_substep_knows_the_stiffness_of_an_effect_in_python() -> None:
    one = predictor()
    base = belief(one)
    with_stiffer = one.stable_substep(base.with_effect("stiffer", {"e": 3e5}))
    assert with_stiffer < 0.5 * one.stable_substep(base)
    one.predict(base.with_effect("stiffer", {"e": 3e5}))


def test_registration_says_that_it_is_slower(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "mphygs"):
        register_effect(ExtraWeight)
    assert [r.getMessage() for r in caplog.records] == [
        "effect 'extra_weight' runs in Python, once a substep: slower than a compiled one"
    ]
    spec = effects()["extra_weight"]
    assert (spec.kind, spec.site, spec.summary) == (
        "smooth",
        "user",
        "A further weight, m times a vector down",
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "Bad Name"}, "name is 'Bad Name', expected lower-case"),
        ({"name": "gravity"}, "taken by a built-in effect"),
        ({"parameters": ()}, "expected a tuple of ParameterSpec"),
        ({"kind": "rough"}, "kind is 'rough', expected one of smooth, threshold"),
        ({"stress": Stiffer.stress}, "has force and stress, expected one of"),
    ],
)
def test_a_class_that_lacks_something_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        register_effect(type("Other", (ExtraWeight,), changes))


def test_effects_in_python_are_refused_where_particles_carry_the_motion() -> None:
    with pytest.raises(ValueError, match="'stiffer': not with --transfer mls, for it has no effects"):
        check_effects("mls", ["stiffer"])
    check_effects("total-lagrangian", ["stiffer"])


def test_a_class_without_a_function_is_refused() -> None:
    with pytest.raises(ValueError, match="has no function, expected one of force, stress"):
        register_effect(type("Empty", (UserEffect,), {"name": "empty", "parameters": ExtraWeight.parameters}))


def test_a_force_of_the_wrong_shape_is_named() -> None:
    class Flat(ExtraWeight):
        name = "flat"

        def force(self, state, parameters):
            return state.mass

    register_effect(Flat)
    one = predictor()
    with pytest.raises(
        ValueError, match=r"effect 'flat': its force is \(\d+,\), expected a tensor \(\d+, 3\)"
    ):
        one.predict(belief(one).with_effect("flat", {"g": 1.0}), substep=2e-4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no such file"),
        ("x = 1", "registered nothing, expected a call of register_effect"),
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
    ],
)
def test_a_plugin_at_fault_is_told_in_one_line(tmp_path: Path, text: str | None, message: str) -> None:
    path = tmp_path / "mine.py"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        load_plugin(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_the_documented_example_slows_a_swing(tmp_path: Path) -> None:
    section = DOCUMENT.read_text().split("## Effects in Python", 1)[1]
    code = re.search(r"```python\n(.*?)```", section, re.DOTALL)
    assert code is not None
    path = tmp_path / "quadratic_drag.py"
    path.write_text(code.group(1))
    assert load_plugin(path) == ("quadratic_drag",)
    one = predictor()
    base = belief(one)
    free = one.predict(base, substep=2e-4)
    dragged = one.predict(
        base.with_effect("quadratic_drag", {"beta": 20.0}), keys=("quadratic_drag.beta",), substep=2e-4
    )
    assert np.isfinite(dragged.jacobian).all()
    assert np.square(dragged.velocity[2]).sum() < 0.9 * np.square(free.velocity[2]).sum()

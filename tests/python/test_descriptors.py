"""What effects say of themselves: in C++, in Python, and in a file of their own that nothing else names."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs import _core
from mphygs.diagnose.effect_variants import absent_effects
from mphygs.extend.step import FAULT as OUTLIERS
from mphygs.fit.belief_document import belief_from_document, document_of_belief
from mphygs.model import faults as fault_files
from mphygs.model import material_effects as material_files
from mphygs.model import registry
from mphygs.model.belief import Belief
from mphygs.model.descriptor import VECTORS, EffectSpec, ParameterSpec
from mphygs.model.registry import effects, faults, laws, material_effects
from mphygs.simulate.body import Body
from mphygs.simulate.fields import core_effects, core_input_tangent, core_inputs
from mphygs.simulate.measurement import (
    before_measurement,
    lateness,
    with_measurement_faults,
    without_measurement_faults,
)
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.settings import Settings, impossible_effects

FAULT = '''
import numpy as np

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault


class SlidingFrame(Fault):
    """The measuring frame slides along x, faster and faster."""

    name = "sliding_frame"
    summary = "the measuring frame slides along x"
    parameters = (ParameterSpec("a", "m/s^2", 0.0, -1.0, 1.0, 1e-2),)
    order = 4

    def shown(self, values, times, position, velocity):
        along = values["a"] * times[:, None, None] * np.eye(3)[0]
        return position + 0.5 * times[:, None, None] * along, velocity + along

    def derivative(self, quantity, values, times, position, velocity):
        return 0.5 * (times**2)[:, None, None] * np.eye(3)[0]

    def undone(self, values, times, position):
        return position - 0.5 * values["a"] * (times**2)[:, None, None] * np.eye(3)[0]
'''

MATERIAL = '''
from dataclasses import replace

import numpy as np

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.material_effect import MaterialChange, MaterialEffect


class Sediment(MaterialEffect):
    """Stiffer and denser towards the ground."""

    name = "sediment"
    summary = "Young's modulus and density times exp(-depth z)"
    parameters = (ParameterSpec("depth", "1/m", 0.0, -100.0, 100.0, 1.0),)

    def changed(self, material, values, settings, object_):
        factor = np.exp(-values["depth"] * object_.points[..., 2])
        moved = {name: factor * getattr(material, name) for name in ("youngs_modulus", "density")}
        return replace(material, **moved)

    def derivative(self, quantity, values, settings, object_):
        below = -object_.points[..., 2]
        return MaterialChange(youngs_modulus=below, density=below)
'''

MEASUREMENT = [*(f.name for f in faults() if any(p.fitted for p in f.parameters)), "sliding_frame"]
MATERIALS = [*(e.name for e in material_effects()), "sediment"]


@pytest.fixture(autouse=True)
def two_more_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A fault and an effect of the material, each in a file of its own beside the built-in ones."""
    for files, name, text in (
        (fault_files, "sliding_frame", FAULT),
        (material_files, "sediment", MATERIAL),
    ):
        folder = tmp_path / files.__name__.rpartition(".")[2]
        folder.mkdir()
        (folder / f"{name}.py").write_text(text)
        monkeypatch.setattr(files, "__path__", [*files.__path__, str(folder)])
    kept = (faults, material_effects, registry._built_in)
    for one in kept:
        one.cache_clear()
    yield
    monkeypatch.undo()
    for one in kept:
        one.cache_clear()


def bar() -> Predictor:
    capture = bar_capture(lengths=(0.024, 0.024), frames=6, fps=50.0)
    return Predictor(capture, capture.sequence("a"), Settings(0.012, dtype="float64", workers=1))


def with_effect(belief: Belief, name: str, share: float = 0.7) -> Belief:
    """The belief with an effect of so many usual sizes."""
    spec = effects()[name]
    values = {p.name: p.null + share * p.scale for p in spec.fitted}
    settings = {"part": "part1", "axis": [0.6, 0.0, 0.8]}
    return belief.with_effect(name, values, {key: settings[key] for key in spec.settings})


def test_all_effects_say_the_same_things_of_themselves() -> None:
    known = effects()
    assert {n for n, e in known.items() if e.threshold} == {"contact", "plasticity"}
    assert {n for n, e in known.items() if e.history} == {"relaxation", "plasticity"}
    assert {n for n, e in known.items() if e.loads_at_rest} == {"gravity", "attached_mass", "tether", "wind"}
    assert {n for n, e in known.items() if e.placed} == {"attached_mass", "tether"}
    assert {n for n, e in known.items() if e.fault} == {f.name for f in faults()}
    assert set(impossible_effects("mls")) == {"hold_compliance"} and not impossible_effects(
        "total-lagrangian"
    )
    assert {role for e in known.values() for role in e.scanned if role in VECTORS} == set(VECTORS)
    for name, spec in known.items():
        assert spec.name == name and spec.summary and bool(spec.parameters) is (name not in laws())
        assert (spec.site == "law") is (name in laws())
        for p in spec.parameters:
            assert p.lower <= p.null <= p.upper and p.scale > 0.0
            assert p.lower <= p.range[0] <= p.range[1] <= p.upper or p.scan is None
    assert list(known["contact"].scanned) == ["direction", "offset"]
    assert [p.name for p in known["contact"].of_role("direction")] == ["n_x", "n_y", "n_z"]
    assert known["plasticity"].scanned["level"][0].range == (1e2, 1e6)
    assert list(known["base_motion"].scanned) == ["frequency", "phase", "switch"]
    assert known["stiffness_gradient"].settings == ("part", "axis")


def test_what_does_not_go_together_is_refused() -> None:
    numbers = ("x", "m", 1.0, 0.0, 10.0, 1.0)
    with pytest.raises(ValueError, match="role is 'size', expected one of strength, level"):
        ParameterSpec(*numbers, role="size")
    with pytest.raises(ValueError, match="scan is 1 to 20, expected it between 0.0 and 10.0"):
        ParameterSpec(*numbers, scan=(1, 20))
    with pytest.raises(ValueError, match="lower is 0.0, expected a level's above zero"):
        ParameterSpec(*numbers, role="level")
    with pytest.raises(ValueError, match="1 numbers are of role flow, expected x, y and z"):
        EffectSpec("e", "", "smooth", "user", (ParameterSpec(*numbers, role="flow"),))
    assert ParameterSpec(*numbers).role == "strength"
    assert ParameterSpec(*numbers, fitted=False).role == "constant"


def test_laws_are_told_by_the_core() -> None:
    assert laws() == ("neo-hookean", "fixed-corotated")
    with pytest.raises(ValueError, match="law 'jelly': expected one of neo-hookean, fixed-corotated"):
        Belief((), np.zeros(3), (), law="jelly")


def test_effects_tell_their_share_of_the_stable_step() -> None:
    one = bar()
    belief = bar_belief(one.capture, youngs_modulus=(4e4, 2e4))
    body = one.body

    def flat(**effects_: dict[str, float]) -> tuple[np.ndarray, list[str]]:
        whole = belief
        for name, values in effects_.items():
            whole = whole.with_effect(name, values)
        return core_inputs(whole, body)["effect"], list(core_effects(whole))

    assert _core.stiffness_factor(*flat(relaxation={"ratio": 3.0})) == 4.0
    assert _core.stiffness_factor(*flat(viscosity={"eta": 3.0})) == 1.0
    numbers, active = flat(contact={"d": -0.5, "mu": 0.4, "n_x": 0.6, "n_z": 0.8})
    first = registry.core_parameter_offsets()["contact"]
    chosen = numbers[first + 5]
    assert chosen == 2.0 ** np.round(np.log2(2e4 / body.quadrature.spacing.min()))
    worst = _core.worst_case(numbers, active)
    assert worst[first : first + 6] == pytest.approx([100.0, 0.6, 0.0, 0.8, 0.0, chosen])
    assert np.array_equal(_core.worst_case(numbers, []), numbers)
    given = flat(contact={"stiffness": 7.0})[0]
    assert given[first + 5] == 7.0
    with pytest.raises(ValueError, match="expected those of all effects"):
        _core.worst_case(numbers[:-1], active)


@pytest.mark.parametrize("name", MATERIALS)
def test_derivatives_of_an_effect_of_the_material(name: str) -> None:
    body: Body = bar().body
    belief = with_effect(bar_belief(bar().capture, youngs_modulus=(4e4, 2e4)), name)
    plain = core_inputs(bar_belief(bar().capture, youngs_modulus=(4e4, 2e4)), body)
    assert any(not np.array_equal(plain[k], v) for k, v in core_inputs(belief, body).items())
    keys = [f"{name}.{p.name}" for p in effects()[name].fitted]
    for key in (*keys, "part1.youngs_modulus", "part1.density"):
        found = core_input_tangent(belief, body, belief[key])
        assert found and all(np.abs(v).max() > 0.0 for v in found.values())
        ends = []
        for step in (1e-5, -1e-5):
            moved = belief[key].at(belief[key].coordinate + step)
            ends.append(core_inputs(belief.with_parameter(key, value=moved.value), body))
        for field, ahead in ends[0].items():
            slope = (ahead - ends[1][field]) / 2e-5
            size = np.abs(ahead).max(initial=0.0)
            np.testing.assert_allclose(
                found.get(field, 0.0) + 0.0 * slope, slope, atol=1e-9 * size, rtol=1e-7
            )


@pytest.mark.parametrize("name", MEASUREMENT)
def test_derivatives_of_a_fault(name: str) -> None:
    belief = bar_belief(bar().capture, youngs_modulus=(4e4, 2e4))
    generator = np.random.default_rng(5)
    times = 0.1 * np.arange(7)
    # A motion of which the velocity is the derivative, whatever the clock says.
    place, speed = generator.normal(size=(2, 1, 4, 3))

    def seen(of: Belief, wanted: list, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        position = place + (times + lateness(of))[:, None, None] * speed
        return with_measurement_faults(
            of, wanted, times, position, np.broadcast_to(speed, position.shape), jacobian
        )

    faulty, none = with_effect(belief, name), np.zeros((7, 4, 3, 0))
    assert not np.allclose(seen(faulty, [], none)[0], seen(belief, [], none)[0])
    keys = [f"{name}.{p.name}" for p in effects()[name].fitted]
    wanted = [(faulty, faulty[key]) for key in keys]
    position, velocity, jacobian = seen(faulty, wanted, np.zeros((7, 4, 3, len(keys))))
    for k, key in enumerate(keys):
        ends = []
        for step in (1e-4, -1e-4):
            moved = faulty[key].at(faulty[key].coordinate + step)
            ends.append(seen(faulty.with_parameter(key, value=moved.value), [], none)[0])
        slope = (ends[0] - ends[1]) / 2e-4
        np.testing.assert_allclose(jacobian[..., k], slope, atol=1e-9, rtol=1e-6)
        assert np.abs(slope).max() > 1e-6
        # At its null it is a candidate, of a belief that has it beside one that has not.
        null = belief.with_effect(name)
        beside = seen(belief, [(null, null[key])], np.zeros((7, 4, 3, 1)))[2]
        np.testing.assert_array_equal(beside, seen(null, [(null, null[key])], np.zeros((7, 4, 3, 1)))[2])
    # What it does can be taken off, and its transpose is one.
    true = place + (times + lateness(faulty))[:, None, None] * speed
    np.testing.assert_allclose(without_measurement_faults(faulty, times, position), true, atol=1e-12)
    change, bar_ = generator.normal(size=(2, 7, 4, 3))
    pushed = seen(faulty, [(belief, belief["part0.density"])], change[..., None])[2][..., 0]
    assert np.vdot(bar_, pushed) == pytest.approx(np.vdot(before_measurement(faulty, times, bar_), change))
    assert velocity.shape == position.shape


def test_faults_act_one_after_the_other() -> None:
    assert [f.name for f in faults()] == [
        "time_offset", "frame_drift", "length_scale", "common_shake", "frame_drops", "label_swaps",
        "marker_labels", "marker_outliers", "marker_survey", "noise_level", "zero_gaps", "sliding_frame",
    ]  # fmt: skip
    belief = bar_belief(bar().capture, youngs_modulus=(4e4, 2e4))
    for name in ("length_scale", "frame_drift"):
        belief = with_effect(belief, name)
    times, still = np.arange(3.0), np.ones((3, 1, 3))
    shown = with_measurement_faults(belief, [], times, still, 0.0 * still, np.zeros((3, 1, 3, 0)))[0]
    scale = 1.0 + belief["length_scale.scale"].value
    drifted = with_measurement_faults(
        belief.without_effect("length_scale"), [], times, still, 0.0 * still, np.zeros((3, 1, 3, 0))
    )
    np.testing.assert_allclose(shown, scale * drifted[0])


def test_measurements_are_left_out_for_the_fault_that_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert registry.outliers() == "marker_outliers" == OUTLIERS
    assert [n for n, e in effects().items() if e.leaves_out] == ["marker_outliers"]
    assert [n for n, e in effects().items() if e.carries_gravity] == ["prestress"]
    (marker,) = (f for f in faults() if f.leaves_out)
    monkeypatch.setattr(type(marker), "name", "strays")
    registry._built_in.cache_clear()
    assert registry.outliers() == "strays"


def test_a_law_takes_the_place_of_another_and_gives_it_back() -> None:
    belief = bar_belief(bar().capture)
    usual, other = laws()[:2]
    spec = effects()[other]
    assert spec.site == "law" and not spec.in_core and not spec.parameters
    model = belief.with_effect(other)
    assert (model.law, model.effects, model.chosen_law) == (other, (other,), other)
    assert model.numbers == len(model.free) + 1
    assert model.parameters == belief.parameters
    again = belief_from_document(json.loads(json.dumps(document_of_belief(model))))
    assert again.law == other and again.terms == model.terms
    back = model.without_effect(other)
    assert (back.law, back.effects, back.chosen_law) == (usual, (), None)
    # What was given is no effect, and what is chosen is chosen once.
    given = replace(belief, law=other)
    assert given.chosen_law is None and given.effects == ()
    for of, name, why in (
        (belief, usual, "is in the model already"),
        (given, other, "is in the model already"),
        (model, usual, f"'{other}' has been chosen"),
    ):
        with pytest.raises(ValueError, match=why):
            of.with_effect(name)
    with pytest.raises(ValueError, match=f"law '{usual}': expected '{other}', which is among the effects"):
        replace(model, law=usual)
    # Beside it no other law is a candidate, and none beside itself.
    names = {n for n, e in effects().items() if e.site == "law"}
    for of, left in ((belief, names - {usual}), (given, names - {other}), (model, set())):
        assert {spec.name for spec in absent_effects(of, "total-lagrangian", None)} & names == left


def test_a_model_with_another_law_moves_as_one_that_was_given_it() -> None:
    one = bar()
    belief = bar_belief(one.capture, youngs_modulus=(4e3, 2e3))
    other = laws()[1]
    chosen = one.predict(belief.with_effect(other), substep=2e-4).position
    np.testing.assert_array_equal(chosen, one.predict(replace(belief, law=other), substep=2e-4).position)
    assert np.abs(chosen - one.predict(belief, substep=2e-4).position).max() > 1e-6

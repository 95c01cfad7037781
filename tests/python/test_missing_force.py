"""The missing force: gradient, recovery of a known one, its formula, what is kept and told of it."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from force_example import measured_problem, shaken_bar, soft_belief
from mphygs.diagnose import force_regression
from mphygs.diagnose import missing_force as finding
from mphygs.diagnose.force_features import PointMotion
from mphygs.diagnose.force_plugin import plugin_text
from mphygs.diagnose.force_readings import force_place, nature
from mphygs.diagnose.force_regression import formula_of
from mphygs.diagnose.missing_force import MissingForce, missing_force
from mphygs.diagnose.missing_force_basis import coarse_cells
from mphygs.diagnose.missing_force_document import (
    Unexplained,
    keep_missing_force,
    load_samples,
    missing_force_text,
    sample_of,
)
from mphygs.diagnose.missing_force_model import SeenForce
from mphygs.fit.problem import Problem
from mphygs.model import registry, user_effect
from mphygs.model.registry import ParameterSpec
from mphygs.model.user_effect import load_plugin, register_effect
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.forced_motion import ForcedSequence
from mphygs.simulate.prediction import Predictor, Settings

pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")

C_3 = 20.0


class HeadDrag:
    """Drag that grows with the cube of the speed, on the second part."""

    name = "head_drag"
    parameters = (ParameterSpec("c_3", "s/m^2", 0.0, 0.0, 1e4, 10.0),)

    def force(self, state, parameters):
        speed = state.velocity.square().sum(-1, keepdim=True)
        inside = (state.part == 1)[:, None]
        return -parameters["c_3"] * state.mass[:, None] * speed * state.velocity * inside


@pytest.fixture(scope="module", autouse=True)
def registered() -> Iterator[None]:
    """The effect above, and nothing left of it afterwards."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "_USER", {})
        patch.setattr(user_effect, "_IMPLEMENTATIONS", {})
        register_effect(HeadDrag)
        yield


def test_gradient_by_the_force_s_values_follows_differences() -> None:
    capture = shaken_bar(9, markers=12)
    belief = soft_belief(capture)
    position = np.tile(capture.sequences[0].markers.at, (9, 1, 1))
    problem = measured_problem(capture, position, dtype="float64")
    seen = SeenForce.of("a", problem.predictors["a"], belief, problem.observations["a"], (2, 9))
    random = np.random.default_rng(1)
    values, direction = random.standard_normal((2, *seen.basis.shape))
    motion, residual = seen.run(belief, values)
    gradient, _ = seen.gradient(motion, residual, [])
    step = 1e-3
    ends = [seen.run(belief, values + sign * step * direction)[1] for sign in (1.0, -1.0)]
    slope = 0.5 * (ends[0] @ ends[0] - ends[1] @ ends[1]) / (2 * step)
    assert np.vdot(gradient, direction) == pytest.approx(slope, rel=1e-6)
    assert abs(slope) > 1.0


def test_cells_are_whole_parts_or_less() -> None:
    random = np.random.default_rng(2)
    points = random.uniform(size=(600, 3))
    part = (points[:, 0] > 0.7).astype(int)
    cell = coarse_cells(points, part, np.ones(600), 12)
    assert set(cell) == set(range(cell.max() + 1)) and 10 <= cell.max() + 1 <= 14
    assert all(len(set(part[cell == c])) == 1 for c in set(cell))
    assert np.array_equal(cell, coarse_cells(points, part, np.ones(600), 12))


def test_known_force_is_recovered_beside_a_free_stiffness() -> None:
    capture = shaken_bar()
    truth = soft_belief(capture)
    predictor = Predictor(capture, capture.sequences[0], Settings(0.015, workers=1))
    forced = ForcedSequence(predictor, 30)
    plain = measured_problem(capture, np.tile(capture.sequences[0].markers.at, (30, 1, 1)))
    seen = SeenForce.of("a", plain.predictors["a"], truth, plain.observations["a"], (0, 30))
    # A pulse across the bar on the second part, not a combination of the hats.
    frames = np.arange(30)
    pulse = 0.4 * np.exp(-((frames - 14.0) ** 2) / 18.0)
    acceleration = np.zeros((30, len(seen.basis.part), 3))
    acceleration[:, seen.basis.part == 1, 2] = pulse[:, None]
    force = np.einsum("nc,tcd->tnd", seen.basis.spread, acceleration)
    problem = measured_problem(capture, forced.run(truth, force).position)
    belief = truth.with_parameter("part0.youngs_modulus", value=7e4)
    missing = missing_force(problem, belief)
    assert missing.before > 20.0 * missing.rows
    assert missing.after < 1.1 * missing.rows
    assert missing.explained > 0.99
    found = missing.found["a"]
    a = found.seen_force.basis.over_time(found.values)[1:]
    b = acceleration[1:]
    weight = found.seen_force.basis.mass[:, None]
    correlation = (weight * a * b).sum() / np.sqrt((weight * a**2).sum() * (weight * b**2).sum())
    assert correlation > 0.9
    assert force_place([sample_of("a", found)])[0]["part"] == "part1"
    # From a start nearer to the truth: told of the model that it was asked of, along fewer of the frames.
    said: list[str] = []
    led = missing_force(problem, belief, start=truth, report=said.append)
    assert led.before == missing.before and led.after < finding.STRAY * led.rows
    assert all(f"{finding.STAGES[0]:.0%}" not in line for line in said)
    assert led.belief["part0.youngs_modulus"].value == pytest.approx(6e4, rel=0.1)


@pytest.fixture(scope="module")
def dragged() -> tuple[Problem, MissingForce]:
    """A bar whose second part is slowed by something that the model does not have."""
    capture = shaken_bar()
    belief = soft_belief(capture, free=("part0.youngs_modulus", "part1.youngs_modulus", "part1.density"))
    predictor = Predictor(capture, capture.sequences[0], Settings(0.015, workers=1))
    position = predictor.predict(belief.with_effect("head_drag", {"c_3": C_3})).position
    problem = measured_problem(capture, position)
    return problem, missing_force(problem, belief)


@pytest.fixture(scope="module")
def told(dragged: tuple[Problem, MissingForce]) -> Unexplained:
    problem, missing = dragged
    explained = formula_of(problem, missing, generator=np.random.default_rng(0))
    samples = (sample_of("a", missing.found["a"]),)
    return Unexplained(missing, samples, explained, ("part0", "part1"))


def test_drag_is_read_as_dissipative_and_on_its_part(told: Unexplained) -> None:
    assert told.missing.explained > 0.99
    assert nature(told.samples) == ["dissipative"]
    assert force_place(told.samples)[0]["part"] == "part1"


def test_formula_of_drag_is_found(told: Unexplained) -> None:
    (term,) = told.explained.formula.terms
    assert "|v|^2 v on part part1" in (term.expression, *term.alike)
    assert term.expression in ("|v|^2 v on part part1", "|v|^2 v"), "what can be added to the model"
    assert term.stability > 0.7 and told.explained.formula.explained > 0.9
    assert term.coefficient == pytest.approx(-C_3, rel=0.25)


def test_what_is_kept_is_read_again_and_can_be_added(told: Unexplained, tmp_path: Path) -> None:
    keep_missing_force(told, tmp_path)
    frames, place, force = load_samples(tmp_path, ["a"])["a"]
    assert len(frames) == len(place) == len(force) == 29
    np.testing.assert_array_equal(force, told.samples[0].force)
    document = told.document()
    assert document["formula"] == told.explained.formula.text
    lines = "\n".join(missing_force_text(document, Path("capture"), tmp_path))
    assert "takes energy out of the motion" in lines and document["formula"] in lines
    assert f"--plugin {tmp_path / 'missing_force.py'} --effects missing_force" in lines
    assert load_plugin(tmp_path / "missing_force.py") == ("missing_force",)
    capture = shaken_bar(6, markers=4)
    predictor = Predictor(capture, capture.sequences[0], Settings(0.015, workers=1))
    belief = soft_belief(capture)
    values = {"c_1": told.explained.formula.terms[0].coefficient}
    moved = predictor.predict(belief.with_effect("missing_force", values)).position
    true = predictor.predict(belief.with_effect("head_drag", {"c_3": C_3})).position
    plain = predictor.predict(belief).position
    assert np.linalg.norm(moved - true) < 0.3 * np.linalg.norm(plain - true)
    keep_missing_force(None, tmp_path)
    assert not list(tmp_path.glob("missing*"))


def test_no_file_where_an_effect_in_python_cannot_have_the_force(told: Unexplained) -> None:
    from mphygs.diagnose.force_features import Feature

    formula = told.explained.formula
    assert plugin_text(formula, [Feature("strain_rate")], ("part0", "part1")) is None
    assert plugin_text(formula, [Feature("point", None, (0.1, 0.0, 0.0, 0.01))], ()) is not None


def test_features_are_right_in_units_and_in_sign(dragged: tuple[Problem, MissingForce]) -> None:
    from mphygs.diagnose.force_features import KINDS, Feature, candidate_features

    motion = PointMotion.of(dragged[1].found["a"])
    for kind, power in (("drag", 0), ("quadratic_drag", 1), ("cubic_drag", 2)):
        force = Feature(kind, "part1").forces(motion)
        inside = motion.part == 1
        speed = np.linalg.norm(motion.velocity[:, inside], axis=2, keepdims=True)
        expected = (motion.mass[inside, None] * speed**power * motion.velocity[:, inside]).sum(1)
        np.testing.assert_allclose(force.sum(1), expected, atol=1e-9)
    viscous = Feature("strain_rate").forces(motion)
    assert np.abs(viscous.sum(1)).max() < 1e-9 * np.abs(viscous).max() * len(viscous[0]), "internal"
    power = np.einsum("tnc,tnc->t", viscous, _node_velocity(dragged[1]))
    assert (power[5:] < 0.0).all(), "a positive viscosity takes energy"
    made = {f.kind for f in candidate_features(motion, np.random.default_rng(0).standard_normal((30, 3)))}
    assert made == set(KINDS)


def _node_velocity(missing: MissingForce) -> np.ndarray:
    velocity = missing.found["a"].motion.velocity
    return np.concatenate([np.zeros_like(velocity[:1]), 0.5 * (velocity[1:] + velocity[:-1])])


def test_torch_sees_the_code_of_every_kind() -> None:
    from mphygs.diagnose.force_features import KINDS, Feature

    numbers = {"uniform": (1.0,), "harmonic": (0.0, 2.0, 1.0), "point": (0.1, 0.0, 0.0, 0.01)}
    for kind, known in KINDS.items():
        if known.code is None:
            continue
        code = known.code(Feature(kind, None, numbers.get(kind, ())).numbers)
        state = type("State", (), {"velocity": torch.ones(4, 3), "position": torch.zeros(4, 3), "time": 0.1})
        scope = {
            "state": state, "mass": torch.ones(4, 1), "speed": torch.ones(4, 1), "math": __import__("math"),
            "away": lambda position, place, core: position + core,
        }  # fmt: skip
        assert eval(code, scope).shape == (4, 3), kind


@pytest.mark.parametrize(
    ("misfits", "stages"),
    [
        # far off from the first frames on, or nowhere but at the end
        ((4.0, 9.0, 9.0, 9.0), finding.STAGES),
        ((1.0, 1.2, 2.0, 2.9), finding.STAGES[3:]),
        ((1.0, 1.2, 4.0, 2.0), finding.STAGES[1:]),
        # what cannot be simulated further on
        ((1.0, None, None, None), finding.STAGES),
    ],
)
def test_a_motion_is_followed_from_where_it_is_not_far_off(
    misfits: tuple[float | None, ...], stages: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    def state(_problem: object, seen: float, *_: object) -> SimpleNamespace:
        misfit = misfits[finding.STAGES.index(seen)]
        if misfit is None:
            raise SimulationError("unstable")
        return SimpleNamespace(chi_square=50 * misfit**2, residuals={"a": np.zeros(50)})

    monkeypatch.setattr(finding, "_narrowed", lambda _problem, _whole, share: (None, share))
    monkeypatch.setattr(finding, "state_at", state)
    assert finding._stages(None, {}, None, {}) == stages


@pytest.mark.parametrize(
    ("chi_squares", "steps"),
    [
        # far from noise it goes on however slowly it falls
        ([9.0, 8.9, 8.8, 8.7], 3),
        # 0.6 beyond noise, then 0.5
        ([9.0, 1.6, 1.5, 1.4], 2),
        ([9.0, 1.6, 1.3, 1.25], 3),
        # at the noise twice
        ([9.0, 1.04, 1.03, 1.02], 2),
    ],
)
def test_a_force_is_followed_as_long_as_a_step_takes_a_good_share(
    chi_squares: list[float], steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """chi_squares: over the rows, at the start and after each step."""
    rows, left = 100, iter(chi_squares[1:])
    belief = SimpleNamespace(free=(), coordinates=np.zeros(0))

    def state(chi_square: float) -> SimpleNamespace:
        residual = np.full(rows, np.sqrt(chi_square))
        values = {"a": np.zeros((1, 1, 3))}
        return SimpleNamespace(
            belief=belief, residuals={"a": residual}, values=values, chi_square=rows * chi_square
        )

    said: list[str] = []
    monkeypatch.setattr(finding, "matrix_of", lambda *_: SimpleNamespace(whole=np.eye(3), exact={}))
    monkeypatch.setattr(finding, "gradient_of", lambda *_: np.zeros(3))
    monkeypatch.setattr(finding, "penalised_step", lambda *_: (1.0, np.zeros(3), 0.0))
    monkeypatch.setattr(finding, "stepped", lambda *_: state(next(left)))
    monkeypatch.setattr(finding, "penalised_cost", lambda state, *_: state.chi_square)
    finding._descend(
        None, {"a": SimpleNamespace(seen_force=None)}, state(chi_squares[0]), 3, 1.0, said.append
    )
    assert len(said) == steps


class BentFormula:
    """Two coefficients whose response bends: what a refit asks of the simulation; asked: slopes computed."""

    truth = np.array([1.0, -0.5])
    courses = np.stack([np.sin(np.linspace(0.0, 3.0, 40)), np.linspace(0.0, 1.0, 40)], axis=1)
    noise = np.where(np.arange(40) % 2, 1.0, -1.0)

    def __init__(self, bend: float, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bend, self.asked, self.runs = bend, 0, 0
        belief = SimpleNamespace(coordinates=np.zeros(0), at=lambda _c: belief)
        self.base = SimpleNamespace(belief=belief)
        self.problem = SimpleNamespace(prior_rows=lambda _belief: (np.zeros(1), np.zeros((1, 0))))
        monkeypatch.setattr(force_regression, "_at", lambda _base, _belief, _own, n: self.at(n))
        monkeypatch.setattr(force_regression, "_slopes", lambda now, _own: self.slopes(now.numbers))

    def moves(self, numbers: np.ndarray) -> np.ndarray:
        linear = self.courses @ numbers
        return linear + self.bend * linear**2

    def at(self, numbers: np.ndarray) -> SimpleNamespace:
        self.runs += 1
        residual = self.noise + 100.0 * (self.moves(self.truth) - self.moves(numbers))
        return SimpleNamespace(
            belief=self.base.belief, numbers=numbers, residual=residual, chi_square=float(residual @ residual)
        )

    def slopes(self, numbers: np.ndarray) -> np.ndarray:
        self.asked += 1
        return 100.0 * self.courses * (1.0 + 2.0 * self.bend * (self.courses @ numbers))[:, None]

    def refitted(self, numbers: np.ndarray, first: np.ndarray) -> SimpleNamespace:
        """first: slopes that are known about no force."""
        linear = force_regression._Linear(
            self.noise + 100.0 * self.moves(self.truth), first, np.zeros((40, 0)), np.zeros(40, int)
        )
        return force_regression._refitted(self.problem, self.base, {}, linear, numbers, np.zeros(0))


def test_a_formula_s_refit_is_led_by_the_slopes_of_its_regression(monkeypatch: pytest.MonkeyPatch) -> None:
    case = BentFormula(0.2, monkeypatch)
    known = case.slopes(np.zeros(2))
    begun = np.linalg.lstsq(known, 100.0 * case.moves(case.truth), rcond=None)[0]
    before, case.asked = case.at(begun).chi_square, 0
    found = case.refitted(begun, known)
    assert case.asked == 0
    assert before > 400.0 > 42.0 > found.chi_square
    np.testing.assert_allclose(found.numbers, case.truth, atol=0.02)


def test_a_formula_s_refit_computes_slopes_anew_where_they_mislead(monkeypatch: pytest.MonkeyPatch) -> None:
    case = BentFormula(0.2, monkeypatch)
    begun = np.array([0.5, 0.5])
    before = case.at(begun).chi_square
    found = case.refitted(begun, -case.courses)
    assert 0 < case.asked <= force_regression.ANEW
    assert found.chi_square < 1e-2 * before


def test_a_formula_s_refit_ends_where_it_no_longer_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    case, best = BentFormula(0.0, monkeypatch), np.full(2, 3.0)

    def worse(numbers: np.ndarray) -> SimpleNamespace:
        case.runs += 1
        residual = np.full(40, 1.0 + np.sum((numbers - best) ** 2))
        return SimpleNamespace(
            belief=case.base.belief, numbers=numbers, residual=residual, chi_square=float(residual @ residual)
        )

    monkeypatch.setattr(case, "at", worse)
    found = case.refitted(best, 100.0 * case.courses)
    np.testing.assert_array_equal(found.numbers, best)
    # The shares of the shift, then at most four ever shorter steps of slopes of its own.
    assert case.asked <= force_regression.ANEW and case.runs <= 3 + 1 + 4


def test_frames_that_rest_tell_of_no_force() -> None:
    capture = shaken_bar()
    resting = replace(capture.sequences[0], release=8)
    capture = replace(capture, sequences=(resting,))
    belief = soft_belief(capture, free=("part0.youngs_modulus",))
    predictor = Predictor(capture, resting, Settings(0.015, workers=1))
    problem = measured_problem(capture, predictor.predict(belief).position).with_ranges({"a": (0, 5)})
    with pytest.raises(SimulationError, match="no fitted frame moves"):
        missing_force(problem, belief)

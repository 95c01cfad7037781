"""Baselines: each fits what its own model can make, resumes to the bit, and leaves a run that others read."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from bar_capture import bar_capture
from command_example import SIGMA, SPACING, TRUTH, answer, call, make_capture
from mphygs.baselines import field, graph, kinds, law_mixture, laws, neural, springs, training, triplane
from mphygs.baselines.anchors import Anchors, holds_of
from mphygs.baselines.graph_network import HISTORY, STEPS, WIDTH, edges_of
from mphygs.baselines.graph_network import SHAPES as SHAPES_OF_GRAPH
from mphygs.baselines.residual_network import NAMES, SHAPES, starting_weights
from mphygs.baselines.spring_system import Course, SpringRun, Springs
from mphygs.capture.actuators import Force
from mphygs.capture.format import load_capture, save_capture
from mphygs.commands import compare, diagnose, extend, fit, predict, report, view
from mphygs.fit.experiment import Experiment
from mphygs.fit.run import TRAINED, load_run
from mphygs.fit.start import starting_belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Predictor, Settings
from pictured_example import pictured_flower, stages_of_truth
from sensor_example import acceleration_at

EVERYWHERE = np.array([[-1.0] * 3, [1.0] * 3])
NOWHERE = (np.zeros((1, 6, 3)), np.zeros((1, 6, 3)))
OPTIONS = ("--spacing", SPACING, "--workers", 1)
Make = Callable[..., Predictor]


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_capture(tmp_path_factory.mktemp("capture"))


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few anchors, nodes and iterations."""
    monkeypatch.setattr(springs, "ANCHORS", 24)
    monkeypatch.setattr(springs, "STAGES", 3)
    monkeypatch.setattr(neural, "STAGES", 3)
    monkeypatch.setattr(neural, "ITERATIONS", 2)
    monkeypatch.setattr(field, "STAGES", 3)
    monkeypatch.setattr(field, "ITERATIONS", 2)
    monkeypatch.setattr(laws, "STAGES", 3)
    monkeypatch.setattr(laws, "ITERATIONS", 2)
    monkeypatch.setattr(graph, "STAGES", 3)
    monkeypatch.setattr(graph, "ITERATIONS", 8)


def remade(path: Path, out: Path, make: Make, change: Callable[[object], object] = lambda b: b) -> Path:
    """The capture with the markers that another model moves, noise added."""
    capture = load_capture(path)
    belief = change(starting_belief(capture))
    noise = np.random.default_rng(5)
    recordings = []
    for recording in capture.sequences:
        position = make(capture, recording, Settings(SPACING, workers=1)).predict(belief).position
        position = position + SIGMA * noise.standard_normal(position.shape)
        recordings.append(replace(recording, markers=replace(recording.markers, position=position)))
    save_capture(replace(capture, sequences=tuple(recordings)), out)
    return out


def spring_values(path: Path, power: float) -> dict[str, np.ndarray]:
    """Numbers of springs, stiffer towards the tip."""
    capture = load_capture(path)
    belief = starting_belief(capture)
    body = Predictor(capture, capture.sequences[0], Settings(SPACING, workers=1)).body
    anchors = Anchors.of(body, 24)
    usual = springs._usual(belief, capture, Springs.of(anchors.rest))
    along = anchors.rest[:, 0] / anchors.rest[:, 0].max()
    return {
        "anchors": anchors.rest, "held": (~anchors.free).astype(float), "k": usual + power + 0.5 * along,
        "softness": np.array([0.2]), "damping": np.array([np.log(0.3)]),
    }  # fmt: skip


def test_anchors_carry_uniform_strain_as_it_is() -> None:
    body = Predictor(bar_capture(), bar_capture().sequences[0], Settings(0.008, workers=1)).body
    anchors = Anchors.of(body, 60)
    assert 55 <= len(anchors.rest) <= 64 and (~anchors.free).sum() >= 4
    again = holds_of(anchors.rest, (~anchors.free).astype(float), body.boxes)
    assert np.array_equal(again, anchors.hold)
    points = np.random.default_rng(0).uniform([0.005, 0.002, 0.002], [0.055, 0.018, 0.018], (40, 3))
    strain = np.array([[0.1, 0.02, 0.0], [-0.05, 0.2, 0.03], [0.0, 0.0, -0.1]])
    rows = anchors.weights(points)
    assert rows.sum(1) == pytest.approx(np.ones((40, 1)))
    found = rows @ (anchors.rest @ strain.T + [0.01, 0.0, 0.02])
    moved = np.abs(points @ strain.T).max()
    assert found == pytest.approx(points @ strain.T + [0.01, 0.0, 0.02], abs=0.03 * moved)


def test_gradient_of_springs_is_that_of_differences() -> None:
    generator = np.random.default_rng(0)
    rest = np.stack(np.meshgrid(np.arange(4), np.arange(2), np.arange(2), indexing="ij"), -1).reshape(-1, 3)
    rest = 0.01 * rest + 1e-4 * generator.standard_normal(rest.shape)
    system, held = Springs.of(rest), rest[:, 0] < 0.005
    weight = generator.standard_normal((4, *rest.shape))
    course = Course(
        np.array([20, 10, 15]), np.full(3, 2e-3), held, np.repeat(rest[held][None], 46, 0),
        np.tile([0.0, 0.0, -9.81], (3, len(rest), 1)),
    )  # fmt: skip

    def run(numbers: np.ndarray) -> SpringRun:
        stiffness = system.stiffness(numbers[2:], numbers[0])
        return SpringRun.of(system, stiffness, numbers[1], course, rest, np.zeros_like(rest))

    def loss(numbers: np.ndarray) -> float:
        found = run(numbers)
        return float((weight * found.place[found.frames]).sum())

    at = np.r_[0.3, 0.2, 1.0 + 0.1 * generator.standard_normal(len(rest))]
    by_stiffness, by_damping = run(at).gradient(weight)
    by_k, by_softness = system.stiffness_slopes(at[2:], at[0], by_stiffness)
    steps = 1e-6 * np.eye(len(at))
    differences = [(loss(at + step) - loss(at - step)) / 2e-6 for step in steps]
    assert np.r_[by_softness, by_damping, by_k] == pytest.approx(np.array(differences), rel=1e-4, abs=1e-7)


def test_springs_are_stable_to_the_step_that_they_say() -> None:
    rest = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(-1, 3) * 0.01
    system = Springs.of(rest)
    stiffness = system.stiffness(np.full(27, 1.5), 0.0)
    dt = system.longest_step(stiffness, 0.1)
    held = np.arange(27) < 9
    start = rest + 1e-4 * np.random.default_rng(0).standard_normal(rest.shape) * ~held[:, None]
    course = Course(
        np.array([4000]), np.array([dt]), held, np.repeat(rest[held][None], 4001, 0), np.zeros((1, 27, 3))
    )
    run = SpringRun.of(system, stiffness, 0.1, course, start, np.zeros_like(rest))
    assert np.abs(run.place[-1] - rest).max() < 1e-3
    coarse = replace(
        course, steps=np.array([2000] * 2), dt=np.full(2, 4.0 * dt), pull=np.zeros((2, 27, 3))
    )
    with pytest.raises(SimulationError, match="diverges"):
        SpringRun.of(system, stiffness, 0.1, coarse, start, np.zeros_like(rest))


@pytest.mark.parametrize(("whole", "kept"), [((9.0, 7.0, 3.0, np.inf), 2), ((2.0, 7.0, 3.0, 5.0), 0)])
def test_where_iterations_see_samples_the_whole_says_which_stage_is_kept(
    whole: tuple[float, ...], kept: int, sprung: Mapping, tmp_path: Path
) -> None:
    run, seen = replace(load_run(sprung["run"]), folder=tmp_path), []

    def cost_of(values: Mapping[str, np.ndarray]) -> float:
        seen.append(float(values["a"][0]))
        if whole[len(seen) - 1] == np.inf:
            raise SimulationError("the motion is not finite")
        return whole[len(seen) - 1]

    def measure(values: Mapping[str, np.ndarray], number: int) -> tuple[float, dict[str, np.ndarray]]:
        return 1.0 / (1 + number), {"a": np.ones(1)}  # the last sample's is the least

    plan = training.TrainingPlan({"a": 0.1}, 3, 4, cost_of)
    run = training.train(run, lambda: {"a": np.ones(1)}, measure, plan, {}, lambda *_: None, name="it")
    run.save()
    assert len(seen) == 4 and seen == sorted(seen, reverse=True) and seen[0] == 1.0
    assert training.trained_values(load_run(tmp_path))["a"] == [seen[kept]]


def test_a_graph_whose_training_runs_away_is_left_as_it_predicts_best(
    capture: Path, tmp_path: Path, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    costs, train = [], training.train

    def watched(run: object, start: object, measure: object, plan: training.TrainingPlan, *more, **named):
        def whole(values: Mapping[str, np.ndarray]) -> float:
            costs.append(plan.whole(values))
            return costs[-1]

        return train(run, start, measure, replace(plan, whole=whole), *more, **named)

    monkeypatch.setattr(graph, "train", watched)
    monkeypatch.setattr(graph, "RATE", 0.3)
    found = answer(fit.main, capture, "--baseline", "graph", "--out", tmp_path / "run", *OPTIONS)
    assert costs[-1] > 5.0 * min(costs)  # a stage that led to no motion is not among them
    left = found["sequences"]["swing"]["fit"]["rms_over_sigma"]
    assert left == pytest.approx(np.sqrt(2.0 * min(costs)), rel=0.02)


def test_what_begins_is_the_best_of_a_few_stiffnesses() -> None:
    def begun(softest: float) -> float:
        def cost(values: Mapping[str, np.ndarray]) -> float:
            power = float(values["k"][0])
            if power > 1.1 or power < softest:
                raise SimulationError("unstable")
            # worse and worse from the stiffest on, and least far below
            return (power + 0.7) ** 2 if power < 0.2 else 5.0 - power

        found = training.begun_at(lambda p: {"k": np.array([p])}, cost, lambda *_: None, name="it")
        return float(found["k"][0])

    assert begun(-9.0) == -0.75 and begun(-0.6) == -0.5
    with pytest.raises(SimulationError, match="it: no stiffness"):
        begun(2.0)


def test_springs_fit_what_springs_make(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(springs, "ANCHORS", 24)
    monkeypatch.setattr(springs, "STAGES", 7)
    values = spring_values(capture, 0.4)
    path = remade(capture, tmp_path / "made", lambda *a, **k: springs.SpringPredictor(values, *a, **k))
    found = answer(fit.main, path, "--baseline", "springs", "--out", tmp_path / "run", *OPTIONS)
    assert found["baseline"] == "springs" and found["parameters"] == {}
    errors = found["sequences"]
    assert errors["swing"]["fit"]["rms_over_sigma"] < 1.15
    assert errors["swing"]["predict"]["rms_over_sigma"] < 1.6
    assert errors["other"]["predict"]["rms_over_sigma"] < 1.6


def test_a_residual_network_fits_what_one_makes(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(neural, "STAGES", 5)
    weights = starting_weights(7)
    weights["weight2"] = 0.15 * np.random.default_rng(8).standard_normal(SHAPES[NAMES.index("weight2")])
    first = load_capture(capture)
    experiment = Experiment.of(first, Settings(SPACING, workers=1))
    belief = starting_belief(first).with_parameter("bar.youngs_modulus", value=2.5e5)
    weights["scales"] = neural.scales_of(experiment, belief, SPACING).numbers
    path = remade(
        capture, tmp_path / "made", lambda *a, **k: neural.NeuralPredictor(weights, *a, **k),
        lambda b: b.with_parameter("bar.youngs_modulus", value=2.5e5),
    )  # fmt: skip
    elastic = answer(fit.main, path, "--out", tmp_path / "elastic", *OPTIONS)["sequences"]
    found = answer(fit.main, path, "--baseline", "neural", "--out", tmp_path / "run", *OPTIONS)["sequences"]
    before, after = (errors["swing"]["fit"]["rms_over_sigma"] for errors in (elastic, found))
    assert before > 1.5 and after < 1.1
    for name in ("swing", "other"):
        unseen = [errors[name]["predict"]["rms_over_sigma"] for errors in (elastic, found)]
        assert unseen[1] < 0.7 * unseen[0]


def test_a_network_that_says_nothing_is_the_elastic_model(capture: Path) -> None:
    first = load_capture(capture)
    belief = starting_belief(first).with_parameter("bar.youngs_modulus", value=2.5e5)
    scales = neural.scales_of(Experiment.of(first, Settings(SPACING, workers=1)), belief, SPACING)
    values = starting_weights(0) | {"scales": scales.numbers}
    settings = Settings(SPACING, workers=1, dtype="float64")
    for recording in first.sequences:
        alone = Predictor(first, recording, settings).predict(belief).position
        looped = neural.NeuralPredictor(values, first, recording, settings).predict(belief).position
        assert looped == pytest.approx(alone, abs=1e-9)


def swinging_nodes(path: Path) -> dict[str, np.ndarray]:
    """Numbers of a graph network that is a lattice of springs, damped, under gravity: of every node the last
    move, 0.1 of what its neighbours' displacements are beyond its own, less 0.05 of the move. What a layer
    hands on goes through two of its units, one for each sign."""
    capture = load_capture(path)
    nodes = graph.nodes_of(Predictor(capture, capture.sequences[0], Settings(SPACING, workers=1)))
    values = {name: np.zeros(shape) for name, shape in SHAPES_OF_GRAPH.items()}
    move, fall = 1e-3, 9.81 / 100.0**2
    # layer, input, output, factor: strains by edges, messages and updates of three steps, and the last move
    last, stiffness = 1 + 3 * (HISTORY - 1), 0.1 / STEPS
    for layer, read, write, factor in (
        ("edge", 3, 0, 1.0), ("message", 0, 0, 1.0), ("update", WIDTH, 0, 1.0), ("node", last, 3, 1.0),
        ("out", 0, 0, stiffness), ("out", 3, 0, -0.05),
    ):  # fmt: skip
        for axis, sign in np.ndindex(3, 2):
            unit = 2 * ((read if layer == "out" else write) + axis) + sign
            values[f"{layer}.weight0"][unit, read + axis] = 1.0 - 2.0 * sign
            values[f"{layer}.weight1"][write + axis, unit] = factor * (1.0 - 2.0 * sign)
    values["out.bias1"][2] = -fall / move
    held = (~nodes.free).astype(float)
    return values | {"nodes": nodes.rest, "held": held, "move": np.array([move]), "fps": np.array([100.0])}


def test_a_graph_network_fits_what_one_makes(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(graph, "ITERATIONS", 15)
    values = swinging_nodes(capture)
    path = remade(capture, tmp_path / "made", lambda *a, **k: graph.GraphPredictor(values, *a, **k))
    found = answer(fit.main, path, "--baseline", "graph", "--out", tmp_path / "run", *OPTIONS)["sequences"]
    # a network that has learnt nothing leaves its nodes where they were
    markers = {s.name: s.markers for s in load_capture(path).sequences}
    moved = {n: np.sqrt(np.mean(np.sum((m.position - m.at) ** 2, axis=2))) for n, m in markers.items()}
    assert moved["swing"] > 0.005
    assert found["swing"]["fit"]["rms"] < 0.12 * moved["swing"]
    assert found["other"]["predict"]["rms"] < 0.7 * moved["other"]


def stiff_tip(path: Path) -> dict[str, np.ndarray]:
    """Numbers of a field that rises along the bar, by a factor of ten or so."""
    values = field.starting_weights(0) | {"box": np.asarray(load_capture(path).bounds)}
    along = np.linspace(-1.0, 1.0, triplane.RESOLUTION)
    values["planes"][:] = 0.0
    values["planes"][0, 0] = along[None]
    values["weight0"][:] = values["bias0"][:] = 0.0
    values["weight0"][0, 0], values["bias0"][0], values["weight1"][0, 0] = 1.2, 1.3, 1.0
    return values


def test_a_field_fits_what_one_makes(capture: Path, tmp_path: Path) -> None:
    values = stiff_tip(capture)
    path = remade(capture, tmp_path / "made", lambda *a, **k: field.FieldPredictor(values, *a, **k))
    alone = answer(fit.main, path, "--out", tmp_path / "one", *OPTIONS)["sequences"]
    found = answer(fit.main, path, "--baseline", "field", "--out", tmp_path / "run", *OPTIONS)["sequences"]
    assert found["swing"]["fit"]["rms_over_sigma"] < min(1.2, 0.9 * alone["swing"]["fit"]["rms_over_sigma"])
    assert found["other"]["predict"]["rms_over_sigma"] < 1.6


def moving_tip(path: Path, sequence: str) -> dict[str, np.ndarray]:
    """The same, and that a sequence begins with a velocity that rises along the bar."""
    values = stiff_tip(path)
    velocity = {name: np.zeros(shape) for name, shape in field.VELOCITY.items()}
    velocity["planes"][:] = values["planes"]
    velocity["weight0"][0, 0], velocity["bias0"][0] = 1.0, 1.0
    velocity["weight1"][:, 0] = 0.5, 1.0, -0.5
    return values | {f"velocity.{sequence}.{name}": value for name, value in velocity.items()}


def test_the_slopes_of_fields_are_those_of_differences(capture: Path) -> None:
    first = load_capture(capture)
    belief, recording = starting_belief(first), first.sequences[0]
    values = moving_tip(capture, recording.name)
    settings = Settings(SPACING, workers=1, dtype="float64")
    mover = field.FieldPredictor(values, first, recording, settings)
    assert np.abs(mover.velocity).max() > 0.001
    substep = 0.5 * mover.stable_substep(belief)
    mover.stable_substep = lambda _: substep  # the same steps for all differences
    weight = np.random.default_rng(0).standard_normal((12, len(recording.markers.at), 3))
    by_field, by_velocity = mover.field_slopes(belief, 12, weight)
    direction = np.random.default_rng(1).standard_normal(by_field.shape)
    across = 0.01 * np.random.default_rng(2).standard_normal(by_velocity.shape)
    factor, velocity = mover.factor, mover.velocity

    def slope(by: float, speed: float) -> float:
        ends = []
        for step in (1e-4, -1e-4):
            mover.factor = factor * np.exp(by * step * direction).reshape(factor.shape)
            mover.velocity = velocity + speed * step * across
            mover.forget()
            ends.append(float((weight * mover.predict(belief, last=12).position).sum()))
        return (ends[0] - ends[1]) / 2e-4

    assert by_field @ direction == pytest.approx(slope(1.0, 0.0), rel=1e-3)
    assert (by_velocity * across).sum() == pytest.approx(slope(0.0, 1.0), rel=1e-3)


def test_a_velocity_at_the_start_is_of_its_sequence_and_its_capture(
    capture: Path, tmp_path: Path, quick: None
) -> None:
    out = tmp_path / "run"
    answer(fit.main, capture, "--baseline", "field", "--out", out, *OPTIONS)
    run, first = load_run(out), load_capture(capture)
    kept = load_file(out / TRAINED)
    moving = moving_tip(capture, "swing")
    save_file(kept | {f"values.{k}": moving[k] for k in moving if k != "box"}, out / TRAINED)
    make, belief = kinds.maker_of(run), starting_belief(first)
    other = replace(first, name="other", sequences=first.sequences[:1])
    begun = [
        make(of, of.sequence(name), run.settings).velocity
        for of, name in ((first, "swing"), (first, "other"), (other, "swing"))
    ]
    assert np.abs(begun[0]).max() > 0.001 and begun[1] is None and begun[2] is None
    # what a free point does in the first frame, before it is told of any force
    one = make(first, first.sequence("swing"), run.settings)
    moved = one.predict(belief, last=2).position
    one.velocity = None
    one.forget()
    away = moved - one.predict(belief, last=2).position
    assert np.abs(away[0]).max() < 1e-6 and np.abs(away[1]).max() > 1e-6


def half_and_half(path: Path) -> dict[str, np.ndarray]:
    """Numbers of a mixture: a bar whose half at the hold is fixed corotated, and whose other half is Saint
    Venant-Kirchhoff by a third and else resists a change of volume alone."""
    low, high = load_capture(path).bounds
    centres = np.linspace(low, high, 5)[[1, 3]]
    shares = np.array([[0.97, 0.01, 0.01, 0.01], [0.01, 0.67, 0.01, 0.31]])
    return {"weights": np.log(shares), "level": np.array([0.5]), "centres": centres}


def test_laws_fit_what_a_mixture_makes(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(laws, "STAGES", 5)
    monkeypatch.setattr(laws, "ITERATIONS", 5)
    values = half_and_half(capture)
    path = remade(capture, tmp_path / "made", lambda *a, **k: laws.LawsPredictor(values, *a, **k))
    alone = answer(fit.main, path, "--out", tmp_path / "one", *OPTIONS)["sequences"]
    found = answer(fit.main, path, "--baseline", "laws", "--out", tmp_path / "run", *OPTIONS)["sequences"]
    assert found["swing"]["fit"]["rms_over_sigma"] < min(1.1, 0.8 * alone["swing"]["fit"]["rms_over_sigma"])
    assert found["other"]["predict"]["rms_over_sigma"] < 1.2
    # how stiff each half is in shear: what all laws but the dilation say
    got = training.trained_values(load_run(tmp_path / "run"))
    strengths, outer = laws.strengths_of(got["weights"], got["level"]), got["centres"][:, 0] > 0.027
    sheared = strengths.sum(1) - strengths[:, laws.LAWS.index("dilation")]
    inner, outer = sheared[~outer].mean(), sheared[outer].mean()
    truth = laws.strengths_of(values["weights"], values["level"])[:, [0, 2, 3]].sum(1)
    assert inner == pytest.approx(truth[0], rel=0.12)
    assert outer == pytest.approx(truth[1], rel=0.35) and outer < 0.5 * inner


@pytest.mark.parametrize(("number", "law"), [(0, "fixed-corotated"), (2, "neo-hookean")])
def test_a_mixture_of_one_law_is_that_of_the_core(capture: Path, number: int, law: str) -> None:
    first = load_capture(capture)
    belief = starting_belief(first).with_parameter("bar.youngs_modulus", value=2.5e5)
    settings = Settings(SPACING, workers=1, dtype="float64")
    weights = np.full((2, 4), -60.0)
    weights[:, number] = 0.0
    values = half_and_half(capture) | {"weights": weights, "level": np.zeros(1)}
    for recording in first.sequences:
        alone = Predictor(first, recording, settings).predict(replace(belief, law=law)).position
        mixed = laws.LawsPredictor(values, first, recording, settings).predict(belief).position
        assert mixed == pytest.approx(alone, abs=1e-9)


def test_the_stress_of_a_mixture_is_the_slope_of_its_energy() -> None:
    generator = np.random.default_rng(0)
    f = np.eye(3) + 0.2 * generator.standard_normal((6, 3, 3))
    strengths, group = generator.uniform(0.5, 2.0, (2, 4)), np.array([0, 0, 1, 1, 1, 0])
    mu, lambda_ = generator.uniform(1.0, 2.0, (2, 6))

    def energies(f: np.ndarray) -> np.ndarray:
        log_j = np.log(np.linalg.det(f))
        green = 0.5 * (np.swapaxes(f, 1, 2) @ f - np.eye(3))
        trace = np.trace(green, axis1=1, axis2=2)
        neo_hookean = mu * (0.5 * (f**2).sum((1, 2)) - 1.5 - log_j) + 0.5 * lambda_ * log_j**2
        other = mu * (green**2).sum((1, 2)) + 0.5 * lambda_ * trace**2
        return np.array([neo_hookean, other])

    own = strengths[group, 2:].T
    stress = mixture(strengths, group, mu, lambda_).forward(0, 0.0, *NOWHERE, f[None])[1][0]
    along = generator.standard_normal(f.shape)
    step = 1e-6 * along
    slope = (own * (energies(f + step) - energies(f - step))).sum(0) / 2e-6
    assert (stress * along).sum((1, 2)) == pytest.approx(slope, rel=1e-7)
    # transposed: what a change of the deformation and of the strengths does to <stress, bar>
    bar = generator.standard_normal(f.shape)
    hook = mixture(strengths, group, mu, lambda_)
    by_f = hook.reverse(0.0, *(x[0] for x in NOWHERE), f[None], None, bar[None])[2]

    def told(f: np.ndarray, strengths: np.ndarray) -> float:
        stress = mixture(strengths, group, mu, lambda_).forward(0, 0.0, *NOWHERE, f[None])[1]
        return float((stress * bar).sum())

    assert (by_f * along).sum() == pytest.approx(
        (told(f + step, strengths) - told(f - step, strengths)) / 2e-6, rel=1e-7
    )
    for at in np.ndindex(2, 2):
        moved = np.zeros_like(strengths)
        moved[at[0], at[1] + 2] = 1e-3
        difference = told(f, strengths + moved) - told(f, strengths - moved)
        assert hook.bar[at] == pytest.approx(difference / 2e-3, rel=1e-7)


def mixture(
    strengths: np.ndarray, group: np.ndarray, mu: np.ndarray, lambda_: np.ndarray
) -> law_mixture.MixtureStress:
    return law_mixture.MixtureStress(strengths, group, mu, lambda_, np.float64)


def test_the_slopes_of_a_mixture_are_those_of_differences(capture: Path) -> None:
    first = load_capture(capture)
    belief, values = starting_belief(first), half_and_half(capture)
    settings = Settings(SPACING, workers=1, dtype="float64")
    mover = laws.LawsPredictor(values, first, first.sequences[0], settings)
    substep = 0.5 * mover.stable_substep(belief)
    mover.stable_substep = lambda _: substep  # the same steps for all differences
    generator = np.random.default_rng(0)
    weight = generator.standard_normal((12, len(first.sequences[0].markers.at), 3))
    slopes = mover.slopes(belief, 12, weight)
    for name in ("weights", "level"):
        along, ends = generator.standard_normal(values[name].shape), []
        for step in (1e-4, -1e-4):
            mover.take(values | {name: values[name] + step * along})
            ends.append(float((weight * mover.predict(belief, last=12).position).sum()))
        assert float((slopes[name] * along).sum()) == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=1e-3)


def test_a_graph_joins_each_node_to_its_nearest() -> None:
    rest = np.stack([np.arange(20.0), np.zeros(20), np.zeros(20)], axis=1)
    pairs = {tuple(pair) for pair in edges_of(rest).T.tolist()}
    assert all((a, a + 1) in pairs and (a + 1, a) in pairs for a in range(19))
    assert not any(a == b for a, b in pairs) and (0, 19) not in pairs


@pytest.mark.parametrize("name", ["springs", "neural", "graph", "field", "laws"])
def test_is_stopped_and_resumed_to_the_bit(
    capture: Path, tmp_path: Path, name: str, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = answer(fit.main, capture, "--baseline", name, "--out", tmp_path / "whole", "--seed", 3, *OPTIONS)
    write, count = training._write, 0

    def stop(path: Path, *arguments: object, **options: object) -> None:
        nonlocal count
        write(path, *arguments, **options)
        count += 1
        if count == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(training, "_write", stop)
    out = tmp_path / "stopped"
    code, _, err = call(fit.main, capture, "--baseline", name, "--out", out, "--seed", 3, *OPTIONS)
    assert code != 0 and "--resume" in err
    code, _, err = call(compare.main, out, "--workers", 1)
    assert code == 2 and "is not complete" in err.splitlines()[-1]
    monkeypatch.setattr(training, "_write", write)
    resumed = answer(fit.main, "--out", out, "--resume", "--workers", 1)
    assert resumed["sequences"] == whole["sequences"]
    kept = [load_file(folder / TRAINED) for folder in (tmp_path / "whole", out)]
    names = [key for key in kept[0] if key.startswith("values.")]
    assert names and all(np.array_equal(kept[0][key], kept[1][key]) for key in names)
    assert [len(r.costs) for r in load_run(out).history] == [
        len(r.costs) for r in load_run(tmp_path / "whole").history
    ]


@pytest.fixture(scope="module")
def sprung(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, object]:
    """A quick run of springs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(springs, "ANCHORS", 24)
        patch.setattr(springs, "STAGES", 2)
        out = tmp_path_factory.mktemp("runs") / "springs"
        return answer(fit.main, capture, "--baseline", "springs", "--out", out, *OPTIONS)


def test_others_read_the_run_of_a_baseline(sprung: Mapping, tmp_path: Path) -> None:
    run = Path(sprung["run"])
    compared = answer(compare.main, run, "--workers", 1)["sequences"]
    predicted = answer(predict.main, run, "--out", tmp_path / "p", "--workers", 1)["sequences"]
    for name, where in (("swing", "fit"), ("swing", "predict"), ("other", "predict")):
        told = sprung["sequences"][name][where]
        assert compared[name][where] == told and predicted[name][where] == told
    with np.load(tmp_path / "p" / "other.npz") as arrays:
        assert np.isfinite(arrays["surface"]).all() and len(arrays["surface"][0]) > 100
    assert Path(answer(report.main, run, "--workers", 1)["report"]).is_file()


@pytest.mark.parametrize("command", [diagnose, extend, view])
def test_what_asks_about_physics_refuses_a_baseline(sprung: Mapping, command: object) -> None:
    more = ["viscosity"] if command is extend else []
    code, out, err = call(command.main, sprung["run"], *more)
    assert (code, out) == (2, "")
    assert "is the baseline 'springs'; expected a fit of the model" in err.splitlines()[-1]


def test_damaged_numbers_are_told_in_one_line(sprung: Mapping, tmp_path: Path) -> None:
    run = shutil.copytree(sprung["run"], tmp_path / "run")
    (run / TRAINED).write_bytes(b"no tensors")
    code, _, err = call(compare.main, run)
    assert code == 2 and f"{TRAINED}: cannot be read" in err.splitlines()[-1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--baseline", "springs", "--effects", "viscosity"], "--baseline springs: not with --effects"),
        (["--baseline", "neural", "--transfer", "mls"], "--baseline neural: not with --transfer"),
        (["--baseline", "graph", "--feedback", "1"], "--baseline graph: not with --feedback"),
        (["--baseline", "laws", "--law", "fixed-corotated"], "--baseline laws: not with --law"),
        (["--baseline", "prior"], "--baseline prior: "),
    ],
)
def test_what_does_not_go_together_is_refused(
    capture: Path, tmp_path: Path, arguments: list[str], words: str
) -> None:
    code, out, err = call(fit.main, capture, "--out", tmp_path / "run", *arguments)
    assert (code, out) == (2, "") and words in err.splitlines()[-1]


@pytest.mark.parametrize("name", ["springs", "neural", "graph", "field", "laws"])
@pytest.mark.parametrize(
    ("more", "word"),
    [
        (lambda s: {"sensors": (acceleration_at(s.markers.at[0], s.frames),)}, "sensors"),
        (lambda s: {"actuators": (Force(np.ones((s.frames, 3)), "pull", box=EVERYWHERE),)}, "loads of"),
    ],
)
def test_what_a_model_of_its_own_does_not_know_of_is_refused(
    capture: Path, tmp_path: Path, name: str, more: Callable[[object], dict], word: str
) -> None:
    whole = load_capture(capture)
    sequence = replace(whole.sequences[0], **more(whole.sequences[0]))
    save_capture(replace(whole, sequences=(sequence, *whole.sequences[1:])), tmp_path / "capture")
    code, out, err = call(fit.main, tmp_path / "capture", "--baseline", name, "--out", tmp_path / "run")
    line = f"--baseline {name}: sequence '{sequence.name}' has {word}"
    assert (code, out) == (2, "") and line in err.splitlines()[-1]


def test_one_material_is_fitted_to_markers_as_several_are(tmp_path: Path) -> None:
    capture = make_capture(tmp_path / "made", eta=0.0)
    found = answer(fit.main, capture, "--baseline", "homogeneous", "--out", tmp_path / "run", *OPTIONS)
    modulus = found["parameters"]["object.youngs_modulus"]
    assert modulus["value"] == pytest.approx(TRUTH["bar.youngs_modulus"], rel=0.01)
    assert abs(modulus["value"] - TRUTH["bar.youngs_modulus"]) < 3.0 * modulus["std"]
    assert found["baseline"] == "homogeneous" and found["sequences"]["swing"]["fit"]["rms_over_sigma"] < 1.1
    again = answer(compare.main, tmp_path / "run", "--workers", 1)["sequences"]
    assert again["swing"]["fit"] == found["sequences"]["swing"]["fit"]


@pytest.fixture(scope="module")
def flower(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flower in pictures, its stages in a folder of their own in it."""
    folder = tmp_path_factory.mktemp("flower")
    stages_of_truth(pictured_flower(folder / "daisy"), folder / "stages")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", ["springs", "neural", "graph", "field", "laws"])
def test_of_pictures_a_baseline_follows_the_tracks(
    name: str, flower: Path, tmp_path: Path, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(neural, "STAGES", 1)
    options = ("--spacing", 0.009, "--workers", 1, "--prestress", "paper", "--stages", flower / "stages")
    out = ("--out", tmp_path / "run")
    found = answer(fit.main, flower / "daisy", "--baseline", name, *out, *options)["sequences"]
    assert {"psnr", "iou", "chamfer_px", "rms"} <= set(found["frog"]["fit"])
    again = answer(compare.main, tmp_path / "run", "--workers", 1)["sequences"]
    assert again["turned"]["predict"]["iou"] == found["turned"]["predict"]["iou"] > 0.0


@pytest.mark.slow
def test_materials_by_looks_are_near_those_of_the_kind(flower: Path, tmp_path: Path) -> None:
    options = ("--spacing", 0.009, "--workers", 1, "--prestress", "paper", "--stages", flower / "stages")
    found = answer(fit.main, flower / "daisy", "--baseline", "prior", "--out", tmp_path / "run", *options)
    assert found["parameters"] == {} and found["sequences"]["turned"]["predict"]["iou"] > 0.3
    run = load_run(tmp_path / "run")
    truth = list(json.loads((flower / "daisy" / "answer.json").read_text())["parts"].values())
    said = [[run.belief[f"{p}.{k}"].value for k in ("youngs_modulus", "density")] for p in run.belief.parts]
    away = np.log10(np.array(said) / [[t["E"], t["rho"]] for t in truth])
    assert np.abs(away).max() < 0.6 and np.sqrt(np.mean(away**2)) < 0.25

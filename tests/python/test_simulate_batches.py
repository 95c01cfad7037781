"""Candidates that are differentiated together have the derivatives that they have alone."""

from __future__ import annotations

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.diagnose.effect_variants import smooth_variants
from mphygs.diagnose.periodic_variants import swing_variants
from mphygs.model.registry import effect
from mphygs.simulate import prediction
from mphygs.simulate.batches import APART, DEAR, PAIR, Batch, batches_of
from mphygs.simulate.material_points import MaterialPoints
from mphygs.simulate.prediction import Predictor, Settings
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.settings import TRANSFERS
from mphygs.simulate.total_lagrangian import TotalLagrangian


@pytest.mark.parametrize("workers", [1, 2])
def test_unlike_constants_of_one_effect_do_not_mix(workers: int) -> None:
    capture = bar_capture(frames=12, fps=100.0, fit=(0, 12))
    belief = bar_belief(capture, youngs_modulus=6e4, free=())
    predictor = Predictor(capture, capture.sequences[0], Settings(0.01, workers=workers, dtype="float64"))
    ways = smooth_variants(belief, predictor.body, names=["relaxation", "wind", "tether", "gravity"])
    ways += swing_variants(belief, effect("base_motion"), [3.0, 9.0])
    columns = [pair for way in ways for pair in way.columns]
    together = predictor.predict(belief, candidates=columns).jacobian
    assert len(columns) > 25
    for k, column in enumerate(columns):
        alone = predictor.predict(belief, candidates=[column]).jacobian[..., 0]
        name = f"{column[1].key} of column {k}"
        assert np.abs(alone).max() > 0.0, name
        assert together[..., k] == pytest.approx(alone, rel=1e-9, abs=1e-12 * np.abs(alone).max()), name
    # and they are unlike: sine and cosine, slow and fast
    sines = together[..., -12:].reshape(-1, 4, 3)[..., 1]
    cosine = sines.T @ sines / np.outer(*[np.linalg.norm(sines, axis=0)] * 2)
    assert (np.abs(cosine - np.eye(4)) < 0.999).all()


def shared_out(
    monkeypatch: pytest.MonkeyPatch, transfer: str
) -> tuple[list[tuple[object, object]], list[Batch]]:
    """All smooth candidates of a bar, and the runs that their derivatives are shared out to."""
    capture = bar_capture(frames=4, fps=100.0, fit=(0, 4))
    belief = bar_belief(capture, youngs_modulus=6e4, free=())
    settings = Settings(0.01, workers=1, dtype="float32", transfer=transfer)
    predictor = Predictor(capture, capture.sequences[0], settings)
    ways = smooth_variants(belief, predictor.body) + swing_variants(belief, effect("base_motion"), [3.0, 9.0])
    columns = [pair for way in ways for pair in way.columns]
    found: list[Batch] = []

    def batches(*args: object, **options: object) -> list[Batch]:
        found[:] = batches_of(*args, **options)
        return found

    monkeypatch.setattr(prediction, "batches_of", batches)
    plain = predictor.predict(belief).position
    together = predictor.predict(belief, candidates=columns).position
    assert together == pytest.approx(plain, abs=1e-7)
    if transfer == "total-lagrangian":
        assert np.array_equal(together, plain)
    members = sorted(i for batch in found for i in batch.members)
    moves = [pair for pair in columns if prediction.acts_in_simulation(pair[1])]
    assert members == list(range(len(moves))) and len(members) > 40
    return moves, found


def test_dear_effects_do_not_burden_the_runs_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    _, found = shared_out(monkeypatch, "mls")
    assert not any(any(batch.apart) for batch in found)
    dear = [batch for batch in found if any(effect(name).site in DEAR for name in batch.active)]
    active = {name for batch in dear for name in batch.active}
    assert {"viscosity", "relaxation", "air_drag", "wind", "fibre"} <= active
    assert all(effect(name).site in DEAR for name in active)
    # Pairs of them; the others fill as few runs as there can be.
    assert all(len(batch.members) <= PAIR for batch in dear)
    light = [len(batch.members) for batch in found if batch not in dear]
    assert len(light) == -(-sum(light) // MaterialPoints.batch) and max(light) <= MaterialPoints.batch
    # Of winds along six axes no two can share a run: each is joined by what can be told beside it.
    winds = [batch for batch in dear if "wind" in batch.active]
    assert len(winds) == 6 and sum(len(batch.members) for batch in dear) > 1.8 * len(dear)


def test_effects_that_are_kept_apart_share_as_few_runs_as_there_can_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    moves, found = shared_out(monkeypatch, "total-lagrangian")
    sizes = [len(batch.members) for batch in found]
    assert len(found) == -(-sum(sizes) // TotalLagrangian.batch) and max(sizes) <= TotalLagrangian.batch
    apart: dict[str, int] = {}
    for batch in found:
        assert all(effect(name).site not in APART for name in batch.active)
        for i, own in zip(batch.members, batch.apart, strict=True):
            name = moves[i][1].key.split(".")[0]
            assert own is None or own[0] == [name]
            assert (own is not None) is (effect(name).site in APART), name
            apart[name] = apart.get(name, 0) + (own is not None)
    assert apart["wind"] == 6 and apart["relaxation"] == 3 and apart["base_motion"] == 12
    assert apart["tether"] == apart["attached_mass"] == 0


@pytest.mark.parametrize("rest", ["stress-free", "equilibrium"])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_directions_that_share_a_register_are_those_told_alone(rest: str, count: int) -> None:
    shake = 0.01 * np.sin(np.linspace(0.0, 6.0, 10))[:, None] * [0.3, 1.0, 0.4]
    capture = bar_capture(frames=10, fps=100.0, fit=(0, 10), rest=rest, motion=shake)
    mode = "equilibrium" if rest == "equilibrium" else "off"
    keys = ("part0.youngs_modulus", "part0.density")
    belief = bar_belief(capture, youngs_modulus=6e4, free=keys, prestress=mode)
    predictor = Predictor(capture, capture.sequences[0], Settings(0.01, workers=1, dtype="float32"))
    columns = [(belief, belief[key]) for key in keys]
    columns += smooth_variants(belief, predictor.body, names=["gravity"])[0].columns
    assert len(columns) == 5
    chosen = columns[:count]
    together = predictor.predict(belief, candidates=chosen).jacobian
    precise = Predictor(capture, capture.sequences[0], Settings(0.01, workers=1, dtype="float64"))
    for k, column in enumerate(chosen):
        alone = predictor.predict(belief, candidates=[column]).jacobian[..., 0]
        assert np.abs(alone).max() > 0.0
        # The same operations in the same order, lane by lane; in another program they may be contracted.
        assert together[..., k] == pytest.approx(alone, rel=1e-4, abs=1e-5 * np.abs(alone).max())
        true = precise.predict(belief, candidates=[column]).jacobian[..., 0]
        assert together[..., k] == pytest.approx(true, rel=1e-2, abs=1e-3 * np.abs(true).max())


# Beside the materials each has a strength of its own; strong enough to act in a tenth of a second.
ACTING: dict[str, dict[str, float]] = {
    "viscosity": {"eta": 20.0},
    "relaxation": {"ratio": 0.5, "tau": 0.05},
    "stiffening": {"c_2": 2e4},
    "fibre": {"k_f": 2e4},
    "eigenstrain": {"rate": 0.3},
    "plasticity": {"yield_stress": 300.0},
    "air_drag": {"c_d": 3.0},
    "wind": {"w_x": 2.0, "w_y": -3.0, "c_d": 2.0},
    "contact": {"d": -1e-3, "n_x": 0.1, "n_y": 0.0, "n_z": 1.0, "mu": 0.3, "stiffness": 1e6},
}


@pytest.mark.parametrize("count", [1, 2, 5, 7])
@pytest.mark.parametrize("names", [[name] for name in ACTING] + [["viscosity", "relaxation", "wind"]])
def test_effects_share_a_register_as_the_law_does(names: list[str], count: int) -> None:
    shake = 0.02 * np.sin(np.linspace(0.0, 6.0, 12))[:, None] * [0.3, 1.0, 0.4]
    capture = bar_capture(frames=12, fps=100.0, fit=(0, 12), motion=shake)
    keys = ("part0.youngs_modulus", "part0.density")
    without = belief = bar_belief(capture, youngs_modulus=6e4, free=keys)
    for name in names:
        belief = belief.with_effect(name, ACTING[name])
    predictor = Predictor(capture, capture.sequences[0], Settings(0.01, workers=1, dtype="float32"))
    precise = Predictor(capture, capture.sequences[0], Settings(0.01, workers=1, dtype="float64"))
    columns = [(belief, belief[f"{name}.{next(iter(ACTING[name]))}"]) for name in names]
    columns += [(belief, belief[key]) for key in keys]
    columns += smooth_variants(belief, predictor.body, names=["gravity"])[0].columns
    chosen = columns[:count]
    together = predictor.predict(belief, candidates=chosen)
    for k, column in enumerate(chosen):
        true = precise.predict(belief, candidates=[column])
        assert together.position == pytest.approx(true.position, abs=2e-6)
        truth = true.jacobian[..., 0]
        assert np.abs(truth).max() > 0.0, column[1].key
        error = np.abs(together.jacobian[..., k] - truth).max()
        assert error < 5e-3 * np.abs(truth).max(), column[1].key
    still = predictor.predict(without)
    assert np.abs(still.position - together.position).max() > 1e-5  # the effect acts


@pytest.mark.parametrize("count", [0, 1, 3])
def test_what_is_passed_over_out_of_reach_of_a_wall_adds_nothing(count: int) -> None:
    capture = bar_capture(frames=12, fps=100.0, fit=(0, 12))
    keys = ("part0.youngs_modulus", "part0.density")
    plain = bar_belief(capture, youngs_modulus=6e4, free=keys)
    wall = plain.with_effect("contact", ACTING["contact"])
    # Still air without drag reaches everywhere: beside it no point is passed over.
    everywhere = wall.with_effect("air_drag", {"c_d": 0.0})
    predictor = Predictor(capture, capture.sequences[0], Settings(0.01, workers=1, dtype="float64"))
    wanted = ("contact.d", *keys)[:count]
    near, whole = (predictor.predict(b, keys=wanted, substep=2e-4) for b in (wall, everywhere))
    still = predictor.predict(plain, substep=2e-4)
    assert np.abs(still.position - near.position).max() > 1e-5  # it is touched
    assert near.position == pytest.approx(whole.position, abs=1e-12)
    for k in range(count):
        slope = whole.jacobian[..., k]
        assert near.jacobian[..., k] == pytest.approx(slope, abs=1e-9 * np.abs(slope).max())


@pytest.mark.parametrize("transfer", TRANSFERS)
@pytest.mark.parametrize("rest", ["stress-free", "equilibrium"])
def test_threads_in_a_run_leave_no_trace(rest: str, transfer: str) -> None:
    shake = 0.01 * np.sin(np.linspace(0.0, 2.0, 4))[:, None] * [0.3, 1.0, 0.4]
    capture = bar_capture(frames=4, fps=100.0, fit=(0, 4), rest=rest, motion=shake, lengths=(0.05, 0.05))
    mode = "equilibrium" if rest == "equilibrium" else "off"
    keys = ("part0.youngs_modulus", "part1.youngs_modulus", "part1.density")
    belief = bar_belief(capture, youngs_modulus=6e4, free=keys, prestress=mode)
    belief = belief.with_effect("viscosity", {"eta": 5.0}).with_effect("air_drag", {"c_d": 2.0})
    seen = []
    for workers in (1, 2, 3):
        settings = Settings(0.005, workers=workers, dtype="float32", transfer=transfer)
        predictor = Predictor(capture, capture.sequences[0], settings)
        seen.append(predictor.predict(belief, keys=[p.key for p in belief.free]))
        alone = predictor.predict(belief)
        assert np.array_equal(alone.position, predictor.predict(belief).position)
        seen.append(alone)
    assert np.abs(seen[0].jacobian).max() > 0.0
    for one in seen[2::2]:
        assert np.array_equal(one.position, seen[0].position)
        assert np.array_equal(one.jacobian, seen[0].jacobian)
    for one in seen[3::2]:
        assert np.array_equal(one.position, seen[1].position)


@pytest.mark.parametrize("transfer", TRANSFERS)
def test_threads_in_a_gradient_leave_no_trace(transfer: str) -> None:
    capture = bar_capture(frames=6, fps=100.0, fit=(0, 6))
    keys = ("part0.youngs_modulus", "part0.density")
    belief = bar_belief(capture, youngs_modulus=6e4, free=keys).with_effect("viscosity", {"eta": 5.0})
    seen = []
    for workers in (1, 2, 3):
        settings = Settings(0.01, workers=workers, transfer=transfer)
        predictor = Predictor(capture, capture.sequences[0], settings)
        assert predictor.workers == workers
        found, slope = predict_with_gradient(predictor, belief, lambda p: p - p[:1], keys=keys, last=6)
        model = predictor.model_of(belief)
        assert model.threads == workers
        seen.append((found.position, slope))
    assert np.abs(seen[0][1]).min() > 0.0
    for position, slope in seen[1:]:
        assert np.array_equal(position, seen[0][0])
        assert np.array_equal(slope, seen[0][1])


@pytest.mark.parametrize(
    ("name", "key"), [("gravity", "delta_g_x"), ("base_motion", "a_x"), ("mass_damping", "alpha")]
)
def test_the_rest_shape_is_asked_for_what_may_change_it(name: str, key: str) -> None:
    """What it does not answer to has no slope of it, whether it is asked or not."""
    capture = bar_capture(frames=4, fps=100.0, fit=(0, 4), rest="equilibrium")
    belief = bar_belief(capture, youngs_modulus=6e4, free=("part0.density",), prestress="equilibrium")
    predictor = Predictor(capture, capture.sequences[0], Settings(0.01, workers=1, dtype="float64"))
    owner = belief.with_effect(name)
    parameter, density = owner[f"{name}.{key}"], owner["part0.density"]
    shape = predictor.rest_shape
    changes = [np.abs(slope["deformation0"]).max() for slope in shape.tangent(owner, [parameter, density])]
    assert shape.answers(owner, density) and changes[1] > 0.0
    assert shape.answers(owner, parameter) is (name == "gravity")
    assert bool(changes[0] > 0.0) is (name == "gravity")


@pytest.mark.parametrize("name", ["gravity", "attached_mass", "tether", "wind", "density_gradient", "fibre"])
def test_candidates_at_rest_share_the_solution_of_the_model_without_them(name: str) -> None:
    capture = bar_capture(frames=4, fps=100.0, fit=(0, 4), rest="equilibrium")
    belief = bar_belief(capture, youngs_modulus=6e4, free=("part0.density",), prestress="equilibrium")
    predictor = Predictor(capture, capture.sequences[0], Settings(0.01, workers=1, dtype="float64"))
    shape = predictor.rest_shape
    ways = smooth_variants(belief, predictor.body, names=[name])
    told = 0.0
    for owner, parameter in ways[0].columns:
        assert shape.rests_as(owner, belief) is (name != "fibre")
        alone = shape.tangent(owner, [parameter])[0]
        shared = shape.tangent(owner, [parameter], beside=belief)[0]
        for key in ("deformation0", "volume_ratio"):
            size = np.abs(alone[key]).max()
            told = max(told, float(size))
            assert shared[key] == pytest.approx(alone[key], abs=1e-6 * size + 1e-12)
    assert told > 0.0

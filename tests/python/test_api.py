"""The interface in Python: the commands' numbers, their errors, and nothing printed."""

import inspect
import json
import subprocess
import sys
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import numpy as np
import pytest
import torch

import mphygs
from command_example import ETA, SPACING, TRUTH, answer, call, make_capture
from mphygs.api.results import Estimate
from mphygs.commands import compare as compare_command
from mphygs.commands import diagnose as diagnose_command
from mphygs.commands import extend as extend_command
from mphygs.commands import fit as fit_command
from mphygs.commands import predict as predict_command
from mphygs.model import registry

# Of a run and a second one: where it stands and how long it took.
OWN = ("run", "seconds")


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_capture(tmp_path_factory.mktemp("capture"))


@pytest.fixture(scope="module")
def elastic(capture: Path) -> "mphygs.Fit":
    return mphygs.fit(capture, spacing=SPACING, workers=1)


@pytest.fixture(scope="module")
def commanded(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    out = tmp_path_factory.mktemp("runs") / "elastic"
    return answer(fit_command.main, capture, "--out", out, "--spacing", SPACING, "--workers", 1)


def same(ours: dict, theirs: dict, *, but: tuple[str, ...] = OWN) -> bool:
    kept = [{k: v for k, v in document.items() if k not in but} for document in (ours, theirs)]
    return kept[0] == kept[1]


def test_importing_it_loads_nothing_and_names_everything() -> None:
    line = (
        "import sys, mphygs; heavy = {'numpy', 'torch', 'tyro', 'scipy'} & set(sys.modules);"
        "print(sorted(heavy)); print(all(hasattr(mphygs, n) for n in mphygs.__all__))"
    )
    out = subprocess.run([sys.executable, "-c", line], capture_output=True, text=True, check=True)
    assert out.stdout.split() == ["[]", "True"]
    with pytest.raises(AttributeError, match="no attribute 'fitt'"):
        mphygs.fitt  # noqa: B018


def test_a_package_is_called_like_the_function_of_its_name() -> None:
    assert mphygs.fit.start.__name__ == "mphygs.fit.start"
    assert list(inspect.signature(mphygs.fit).parameters)[:2] == ["capture", "out"]
    assert "progress" in inspect.signature(mphygs.discover).parameters


def test_fit_is_that_of_the_command(elastic: "mphygs.Fit", commanded: dict) -> None:
    assert same(elastic.document, commanded)
    for key, entry in commanded["parameters"].items():
        assert (elastic.parameters[key].value, elastic.parameters[key].std) == (entry["value"], entry["std"])
    assert elastic.sequences["other"]["fit"] is None
    with pytest.raises(FrozenInstanceError):
        elastic.run = Path()


def test_compare_is_that_of_the_command(elastic: "mphygs.Fit", commanded: dict) -> None:
    found = mphygs.compare(elastic, workers=1)
    theirs = answer(compare_command.main, commanded["run"], "--workers", 1)
    assert same(found.document, theirs, but=("pictures",))
    assert found.adequate is False and found.sequences["swing"]["fit"].rms_over_sigma > 1.3
    assert found.compared["swing"].predicted.shape == (24, 12, 3)
    assert len(found.plot("other").axes) >= 6
    with pytest.raises(mphygs.InputError, match="'third' was not compared; expected one of swing, other"):
        found.plot("third")


@pytest.mark.slow
def test_diagnose_and_extend_are_those_of_the_commands(
    elastic: "mphygs.Fit", commanded: dict, tmp_path: Path
) -> None:
    names = ("viscosity", "air_drag")
    found = mphygs.diagnose(elastic, effects=names, workers=1)
    theirs = answer(diagnose_command.main, commanded["run"], "--effects", ",".join(names), "--workers", 1)
    assert found.document == theirs
    assert (found.verdict, found.effects) == ("missing", ("viscosity",))
    assert [row["effect"] for row in found.rows()][0] == "viscosity"
    grown = mphygs.extend(elastic, "viscosity", workers=1)
    told = answer(extend_command.main, commanded["run"], "viscosity", "--out", tmp_path / "e", "--workers", 1)
    assert same(grown.document, told)
    assert abs(grown.parameters["viscosity.eta"].value - ETA) < 0.1 * ETA
    assert grown.names == ("first", "viscosity")
    assert len(grown.plot().axes[0].lines) == 4
    assert mphygs.compare(grown, workers=1).adequate


def test_discover_takes_a_capture_in_memory(capture: Path) -> None:
    own = mphygs.load_capture(capture)
    swing = replace(own.sequences[0], fit=(0, 14))
    found = mphygs.discover(replace(own, sequences=(swing,)), effects="viscosity", spacing=SPACING, workers=1)
    assert (found.verdict, found.effects) == ("missing", ("viscosity",))
    assert json.loads((found.run / "capture" / "capture.json").read_text())["sequences"][0]["fit"] == [0, 14]


def test_simulate_is_predict_of_the_command(elastic: "mphygs.Fit", capture: Path, tmp_path: Path) -> None:
    model = mphygs.Model.of_run(elastic)
    answer(predict_command.main, elastic.run, "--out", tmp_path / "p", "--workers", 1)
    for name in ("swing", "other"):
        motion = mphygs.simulate(model, name)
        with np.load(tmp_path / "p" / f"{name}.npz") as kept:
            assert np.array_equal(motion.position, kept["position"])
            assert np.array_equal(motion.times, kept["times"])
    # Arrays in: points and a hold that moves.
    shift = np.zeros((10, 3))
    shift[:, 1] = np.linspace(0.0, 0.005, 10)
    hold = mphygs.Hold(np.array([[-1.0, -1, -1], [1e-4, 1, 1]]), shift, np.tile([1.0, 0, 0, 0], (10, 1)))
    points = np.array([[0.0, 0.006, 0.006], [0.054, 0.006, 0.006]])
    moved = mphygs.simulate(model, mphygs.Sequence("mine", 100.0, 10, held=(hold,)), points=points)
    assert moved.position.shape == (10, 2, 3)
    assert np.allclose(moved.position[:, 0], points[0] + shift, atol=2e-6)
    assert len(moved.rows()) == 20
    stiff = mphygs.simulate(model.with_parameters({"bar.youngs_modulus": 1e6}))
    assert np.ptp(stiff.position[:, -1, 2]) < 0.5 * np.ptp(mphygs.simulate(model).position[:, -1, 2])


def test_gradient_follows_differences(capture: Path) -> None:
    model = mphygs.Model.of(capture, spacing=SPACING, dtype="float64", workers=1)
    model = model.with_parameters(TRUTH).with_effect("viscosity", {"eta": ETA})
    at = {"bar.youngs_modulus": 2.5e5, "viscosity.eta": ETA, "bar.poissons_ratio": 0.4}
    given = {key: torch.tensor(value, dtype=torch.float64, requires_grad=True) for key, value in at.items()}
    weight = torch.linspace(-1.0, 1.0, 12 * 12 * 3, dtype=torch.float64).reshape(12, 12, 3)

    def loss(values: dict) -> torch.Tensor:
        return (weight * mphygs.rollout(model, values, "swing", frames=12, substep=2e-5)).sum()

    loss(given).backward()
    for key, value in at.items():
        step = 1e-4 * value
        ends = [float(loss(at | {key: value + sign * step})) for sign in (1, -1)]
        assert float(given[key].grad) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-3)


def test_errors_are_typed_and_say_the_line_of_the_command(elastic: "mphygs.Fit", capture: Path) -> None:
    code, _, said = call(fit_command.main, capture, "--effects", "viscosty")
    with pytest.raises(mphygs.InputError) as raised:
        mphygs.fit(capture, effects=["viscosty"])
    assert code == 2 and said.splitlines()[-1] == f"mphygs fit: {raised.value}"
    assert isinstance(raised.value, ValueError) and raised.value.__cause__ is not None
    for wrong, words in (
        (lambda: mphygs.load_capture("nowhere"), "nowhere: is not a capture"),
        (lambda: mphygs.fit(capture, workers=0), "--workers: got 0; expected 1 or more"),
        (lambda: mphygs.fit(capture, schedule="slow"), "--schedule: got 'slow'; expected one of fast, paper"),
        (lambda: mphygs.compare(capture), "is not a run"),
        (lambda: mphygs.extend(elastic, "nothing"), "unknown effect 'nothing'"),
        (lambda: mphygs.Model.of(capture).with_parameters({"rod.density": 1}), "'rod.density' is not in"),
        (lambda: mphygs.Model.of(capture).with_parameters({"bar.density": -1}), "bar.density = -1.0"),
        (lambda: mphygs.Model.of(capture).with_effect("viscosity", {"nu": 1}), "has no number 'nu'"),
        (lambda: mphygs.simulate(mphygs.Model.of(capture), "third"), 'no sequence "third"'),
        (lambda: mphygs.simulate(mphygs.Model.of(capture), points=np.zeros(3)), "points of shape"),
    ):
        with pytest.raises(mphygs.InputError, match=words) as one:
            wrong()
        assert "\n" not in str(one.value)


def test_progress_is_told_and_nothing_is_printed(capture: Path, capfd: pytest.CaptureFixture[str]) -> None:
    told: list[tuple[float, str]] = []
    found = mphygs.fit(
        capture, spacing=SPACING, workers=1, progress=lambda share, text: told.append((share, text))
    )
    shares = [share for share, _ in told]
    assert len(told) > 5 and shares == sorted(shares) and 0.5 < shares[-1] <= 1.0
    assert all(text and "\n" not in text for _, text in told)
    html = found._repr_html_()
    assert "bar.youngs_modulus" in html and "<table>" in html
    found.plot().savefig(found.run / "plot.png")
    assert capfd.readouterr() == ("", "")


def test_a_run_goes_with_its_result(capture: Path, tmp_path: Path) -> None:
    found = mphygs.fit(capture, spacing=SPACING, workers=1)
    folder = found.run
    grown = mphygs.extend(found, ["viscosity"], workers=1)
    del found
    assert (grown.run / "run.json").is_file() and grown.run.parent == folder.parent
    del grown
    assert not folder.exists()
    kept = mphygs.fit(capture, out=tmp_path / "kept", spacing=SPACING, workers=1)
    assert kept.run == tmp_path / "kept"
    del kept
    assert (tmp_path / "kept" / "run.json").is_file()


def test_an_effect_in_python_without_a_file(
    capture: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(registry, "_USER", {})

    @mphygs.register_effect
    class LinearDrag:
        """Force against the motion, in proportion to it."""

        name = "linear_drag"
        parameters = (mphygs.ParameterSpec("c", "1/s", null=0.0, lower=0.0, upper=1e3, scale=1.0),)

        def force(self, state, parameters):
            return -parameters["c"] * state.mass[:, None] * state.velocity

    model = mphygs.Model.of(capture, spacing=SPACING, workers=1).with_parameters(TRUTH)
    free = mphygs.simulate(model, frames=12)
    damped = mphygs.simulate(model.with_effect("linear_drag", {"c": 20.0}), frames=12)
    assert np.ptp(damped.position[:, -1, 2]) < 0.9 * np.ptp(free.position[:, -1, 2])


def test_data_frames_and_the_line_where_pandas_is_missing(
    elastic: "mphygs.Fit", monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as missing:
        missing.setitem(sys.modules, "pandas", None)
        with pytest.raises(mphygs.MissingPackageError, match="pandas is not installed; expected it"):
            elastic.to_dataframe()
    pytest.importorskip("pandas")
    frame = elastic.to_dataframe()
    assert list(frame["parameter"]) == list(elastic.parameters)
    assert frame["value"][0] == elastic.parameters[frame["parameter"][0]].value


def test_a_number_prints_as_people_write_it() -> None:
    estimate = Estimate(value=74.5874, std=8.152, unit="Pa s", determined=True)
    assert str(estimate) == "74.587 +- 8.2 Pa s"
    loose = replace(estimate, std=None, unit="-", determined=False)
    assert str(loose) == "74.587, not determined"

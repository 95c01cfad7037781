"""A small flower in pictures through the commands: fit, predict, compare, ablations, a homogeneous model."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from command_example import answer, call
from mphygs.baselines import homogeneous
from mphygs.baselines.targets import Pictures
from mphygs.capture.errors import CaptureError
from mphygs.capture.features import ColourFeatures
from mphygs.capture.format import load_capture
from mphygs.capture.mask_groups import Superpixels
from mphygs.capture.view_folders import rest_views_of
from mphygs.commands import compare, fit, predict, report
from mphygs.fit import image_fit, paper
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.of_run import experiment_of, pictured_of
from mphygs.fit.pictured import Pictured
from mphygs.fit.pictured_run import with_shares
from mphygs.fit.run import load_run
from mphygs.model.belief import Belief
from mphygs.render.gaussian_features import gaussian_features
from mphygs.render.video_loss import VideoWeights, video_loss
from mphygs.scene.object_files import write_features
from mphygs.scene.ply import read_gaussians
from mphygs.simulate.errors import SimulationError
from page_driver import opened
from pictured_example import SHOOT, pictured_flower, stages_of_truth

SPACING = 0.009
# The paper's way to carry gravity at rest needs no rest shape to be solved for.
OPTIONS = ("--spacing", SPACING, "--workers", 1, "--prestress", "paper")


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pictured_flower(tmp_path_factory.mktemp("flower") / "daisy")


@pytest.fixture(scope="module")
def stages(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("stages")
    stages_of_truth(capture, home)
    return home


@pytest.fixture(scope="module")
def fitted(capture: Path, stages: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    out = tmp_path_factory.mktemp("runs") / "full"
    return answer(fit.main, capture, "--out", out, "--stages", stages, *OPTIONS)


def test_fit_finds_the_stem_and_predicts_the_pictures(fitted: dict, capture: Path) -> None:
    truth = json.loads((capture / "answer.json").read_text())["parts"]["stem"]["E"]
    found = fitted["parameters"]["segment-00.youngs_modulus"]
    assert found["determined"] and 0.5 < found["value"] / truth < 2.0
    for name, label in (("frog", "fit"), ("frog", "predict"), ("turned", "predict")):
        error = fitted["sequences"][name][label]
        assert error["rms_over_sigma"] < 2.0 and error["rms"] < 1.5e-3
        assert error["iou"] > 0.6 and error["chamfer_px"] < 0.5 and error["psnr"] > 17.0
    assert fitted["sequences"]["turned"]["fit"] is None
    run = load_run(fitted["run"])
    assert run.history[-1].name == "pictures" and len(run.belief.likenesses) > 4
    assert run.stages.is_dir() and run.belief.prestress == "paper"


def test_boundaries_and_the_grid_are_in_the_standard_errors(fitted: dict) -> None:
    run = load_run(fitted["run"])
    experiment, belief = experiment_of(run, workers=1)
    rows = experiment.problem(run.settings.spacing).evaluate(belief).jacobian
    noise = np.linalg.pinv(rows.T @ rows, hermitian=True)
    number = [p.key for p in belief.free].index("segment-00.youngs_modulus")
    # what a finer grid would change
    assert run.covariance[number, number] > 1.02 * noise[number, number]
    # and boundaries, were they as unsure as a tenth of the stem's radius
    parts = experiment.capture.parts
    assert {part.boundary for part in parts} == {0.0}
    stem = replace(parts[0], boundary=0.1 * parts[0].volume / parts[0].area)
    unsure = replace(experiment, capture=replace(experiment.capture, parts=(stem, *parts[1:])))
    more = with_shares(run, unsure, print)
    added = more.covariance - run.covariance
    assert 0.5 < np.sqrt(added[number, number]) / (3 * np.log(1.1)) < 1.1
    assert more.information[number, number] < run.information[number, number]


def test_a_finer_grid_that_cannot_carry_the_model_costs_no_fit(
    fitted: dict, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = load_run(fitted["run"])
    experiment, _ = experiment_of(run, workers=1)

    def refuse(*_args: object, **_options: object) -> None:
        raise SimulationError("too soft")

    monkeypatch.setattr(Experiment, "_refined", refuse)
    said = []
    alone = with_shares(run, experiment, said.append)
    assert said == ["what a finer grid would change is not in the standard errors: too soft"]
    assert np.trace(alone.covariance) < np.trace(run.covariance)


def test_pictures_tell_a_wrong_motion_from_the_right_one(fitted: dict) -> None:
    run = load_run(fitted["run"])
    experiment, belief = experiment_of(run, workers=1)
    pictured = pictured_of(run, experiment)
    right = pictured.errors(belief, names=["frog"])["frog"]["all"]
    soft = belief.with_parameter("segment-00.youngs_modulus", value=1e5)
    wrong = pictured.errors(soft, names=["frog"])["frog"]["all"]
    assert wrong["iou"] < right["iou"] - 0.02 and wrong["chamfer_px"] > 1.5 * right["chamfer_px"]
    assert wrong["psnr"] < right["psnr"]


def test_what_a_baseline_sees_of_pictures_has_the_slope_of_differences(fitted: dict) -> None:
    run = load_run(fitted["run"])
    experiment, belief = experiment_of(run, workers=1)
    pictured = pictured_of(run, experiment)
    target = Pictures.of(pictured, "frog", (0, 12))
    position = pictured.moved("frog", belief, last=12).position
    _, bar = target.cost(position, (2, 5))
    assert target.weight((2, 5)) == 3 and not bar[:2].any() and not bar[5:].any()
    along = np.random.default_rng(0).standard_normal((12, 1, 3)) * np.ones((1, position.shape[1], 1))
    ends = [target.cost(position + step * along, (2, 5))[0] for step in (5e-5, -5e-5)]
    assert (bar * along).sum() == pytest.approx((ends[0] - ends[1]) / 1e-4, rel=0.05)


def test_looks_in_the_videos_are_held_against_those_at_rest(
    fitted: dict, capture: Path, tmp_path: Path
) -> None:
    run = load_run(fitted["run"])
    experiment, belief = experiment_of(run, workers=1)
    without = pictured_of(run, experiment)
    assert without.looks is None  # stages without features
    stages = tmp_path / "stages"
    shutil.copytree(run.stages, stages)
    gaussians = read_gaussians(stages / "rest" / "gaussians.ply")
    views = rest_views_of(load_capture(capture)).read()
    (stages / "features").mkdir()
    found = gaussian_features(gaussians, views, ColourFeatures(), Superpixels(), made_by="colour")
    write_features(stages / "features" / "features.npz", found)
    pictured = Pictured.of(experiment, without.source, stages)
    span = experiment.fitted["frog"]
    watched = image_fit.watch(pictured, "frog", span, looks=True)
    frame = watched.fitted[-1]
    assert {seen.features.shape[2] for seen in watched.pictures[frame]} == {3}
    plain = image_fit.watch(pictured, "frog", span, looks=False).pictures[frame]
    assert {seen.features for seen in plain} == {None}
    with pytest.raises(CaptureError, match="features.npz: made_by: got 'magic'"):
        _ = replace(pictured.looks, made_by="magic").extractor
    soft = belief.with_parameter("segment-00.youngs_modulus", value=1e5)
    placement, losses = pictured.placement("frog"), []
    for one in (belief, soft):
        moved = pictured.moved("frog", one, last=frame + 1).position[frame]
        drawn = pictured.drawn.at(torch.from_numpy(placement.to_world(moved)))
        losses.append(float(video_loss(drawn, watched.pictures[frame]).features))
    assert 0.0 < losses[0] < 0.9 * losses[1]
    assert pictured.coloured(torch.from_numpy(placement.to_world(moved))).features.shape[1] == 0


def test_predict_writes_a_video_beside_the_prediction(fitted: dict, tmp_path: Path) -> None:
    found = answer(predict.main, fitted["run"], "--out", tmp_path, "--sequences", "turned", "--workers", 1)
    entry = found["sequences"]["turned"]
    assert entry["predict"]["iou"] == pytest.approx(fitted["sequences"]["turned"]["predict"]["iou"])
    video = cv2.VideoCapture(entry["film"])
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == SHOOT.frames
    ok, image = video.read()
    assert ok and image.shape == (2 * SHOOT.size, 2 * SHOOT.size, 3)
    left, right = image[:, : SHOOT.size].astype(float), image[:, SHOOT.size :].astype(float)
    assert left.max() > 100 and np.abs(left - right).mean() < 0.25 * left[left.max(2) > 30].mean()


@pytest.mark.slow
def test_compare_and_report_tell_of_pictures(fitted: dict) -> None:
    found = answer(compare.main, fitted["run"], "--workers", 1)
    error = found["sequences"]["frog"]["predict"]
    assert {"rms", "max", "rms_over_sigma", "count", "psnr", "iou", "chamfer_px"} == set(error)
    assert all(Path(path).is_file() for path in (*found["films"], *found["pictures"]))
    code, out, _ = call(compare.main, fitted["run"], "--workers", 1)
    assert code == 0 and "PSNR dB" in out and "frog.mp4" in out
    path = Path(answer(report.main, fitted["run"], "--workers", 1)["report"])
    page = path.read_text()
    assert path.stat().st_size < 5_000_000
    with opened(path.as_uri()) as shown:
        film = shown.locator("#film-0")
        assert len(shown.evaluate("JSON.parse(document.getElementById('data').textContent).films")) == 2
        drawn = film.locator("img").nth(1)
        first = drawn.get_attribute("src")
        for role, value in (("edge", 20), ("time", 7)):
            film.locator(f"[data-role={role}]").evaluate(
                f"s => {{ s.value = '{value}'; s.dispatchEvent(new Event('input')); }}"
            )
        assert film.get_attribute("data-frame") == "7" and drawn.get_attribute("src") != first
        assert "20%" in drawn.evaluate("i => i.style.clipPath")
        assert drawn.evaluate("i => i.naturalWidth") == SHOOT.size
    assert "PSNR dB" in page and "frog: video | rendering" in page


@pytest.mark.slow
@pytest.mark.parametrize("left_out", ["lg,l2d", "windows,l2d", "prestress,ldt"])
def test_parts_of_the_method_can_be_left_out(
    left_out: str, capture: Path, stages: Path, fitted: dict, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    options = ("--stages", stages, "--without", left_out, "--frames", "0:8", *OPTIONS)
    found = answer(fit.main, capture, "--out", out, *options)
    run, full = load_run(out), load_run(fitted["run"])
    names = [stage.name for stage in run.history]
    assert ("pictures" in names) is ("l2d" not in left_out)
    assert bool(run.belief.likenesses) is ("lg" not in left_out)
    assert ("coarse, first quarter" in names) is ("windows" not in left_out)
    assert run.belief.prestress == ("off" if "prestress" in left_out else full.belief.prestress)
    assert found["sequences"]["frog"]["fit"]["psnr"] > 10.0


@pytest.mark.slow
def test_homogeneous_has_one_material(
    capture: Path, stages: Path, fitted: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, loss = tmp_path / "run", homogeneous.silhouette_loss

    def of_what_can_be_run(pictured: object, watched: object, belief: Belief) -> float:
        if belief["object.youngs_modulus"].value < 2e4:
            raise SimulationError("too soft")
        return loss(pictured, watched, belief)

    monkeypatch.setattr(homogeneous, "silhouette_loss", of_what_can_be_run)
    found = answer(fit.main, capture, "--out", out, "--stages", stages, "--baseline", "homogeneous", *OPTIONS)
    assert set(found["parameters"]) == {"object.youngs_modulus", "object.density"}
    truth = json.loads((capture / "answer.json").read_text())["parts"]
    modulus = found["parameters"]["object.youngs_modulus"]["value"]
    assert 0.3 * min(p["E"] for p in truth.values()) < modulus < 3 * max(p["E"] for p in truth.values())
    assert found["sequences"]["frog"]["fit"]["iou"] > 0.5
    assert load_run(out).history[-1].name == "silhouettes"
    again = answer(predict.main, out, "--out", tmp_path / "p", "--sequences", "frog", "--workers", 1)
    assert again["sequences"]["frog"]["fit"]["iou"] == found["sequences"]["frog"]["fit"]["iou"]
    resumed = answer(fit.main, "--out", out, "--resume", "--stages", stages, "--workers", 1)
    assert resumed["sequences"] == found["sequences"]
    code, _, err = call(fit.main, "--out", out, "--resume", "--stages", tmp_path)
    assert code == 2 and f"--stages: got {tmp_path}, but {out} began with {stages}" in err.splitlines()[-1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--without", "magic"], "--without: unknown 'magic'"),
        (["--baseline", "homogeneous", "--without", "lg"], "--baseline homogeneous: not with --without"),
    ],
)
def test_options_are_refused_in_one_line(capture: Path, tmp_path: Path, arguments: list, words: str) -> None:
    code, out, err = call(fit.main, capture, "--out", tmp_path / "run", *arguments)
    assert (code, out) == (2, "") and words in err.splitlines()[-1]
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
@pytest.mark.parametrize("schedule", ["fast", "paper"])
def test_a_step_on_pictures_lowers_their_loss(
    schedule: str, fitted: dict, tmp_path: Path, monkeypatch
) -> None:
    run = load_run(fitted["run"])
    experiment, belief = experiment_of(run, workers=1)
    pictured = pictured_of(run, experiment)
    key = "segment-00.youngs_modulus"
    soft = belief.with_parameter(key, value=0.5 * belief[key].value)
    if schedule == "fast":
        evaluation = experiment.problem(run.settings.spacing).evaluate(soft)
        # the tracks are not to lead back
        flat = replace(evaluation, slopes=1e-9 * evaluation.jacobian)
        solution = Solution(soft, flat, (flat.cost,), True, "")
        found = image_fit.fit_to_pictures(pictured, solution, weights=VideoWeights())
    else:
        monkeypatch.setattr(image_fit, "ITERATIONS", 12)
        monkeypatch.setattr(paper, "ITERATIONS", 12)
        found = image_fit.fit_to_pictures_by_adam(pictured, soft, weights=VideoWeights())
    assert found.history[-1] < 0.97 * found.history[0] and found.left_out[-1] < found.left_out[0]
    assert soft[key].value * 1.1 < found.belief[key].value < 1.6 * belief[key].value


def test_a_bad_file_of_a_stage_ends_in_one_line_and_nothing_is_lost(
    capture: Path, stages: Path, tmp_path: Path
) -> None:
    home = tmp_path / "home"
    shutil.copytree(stages, home)
    (home / "stages" / "track" / "frog" / "tracks.npz").write_bytes(b"no")
    code, out, err = call(fit.main, capture, "--out", tmp_path / "run", "--stages", home, *OPTIONS)
    assert (code, out) == (2, "")
    assert "tracks.npz: is not an .npz file, or is truncated" in err.splitlines()[-1]
    assert (home / "stages" / "object" / "particles.npz").is_file()

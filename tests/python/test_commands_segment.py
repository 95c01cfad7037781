"""`reconstruct` and `segment`: from rest views to parts, kept when run again, and refused in one line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from command_example import answer, call
from mesh_picture import cameras_around, draw_mesh, dumbbell, write_rest_views
from mphygs.capture.cameras import Camera
from mphygs.capture.images import write_image
from mphygs.capture.transforms import write_transforms
from mphygs.commands import reconstruct, segment
from mphygs.scene.object_files import read_particles, read_parts
from mphygs.scene.ply import read_gaussians, write_gaussians
from mphygs.scene.quadrature import fill

SIZE = 64
QUICK = ("--iterations", 250, "--most-gaussians", 2500)
OBJECT = ("--features", "colour", "--particles", 3000)


def write_capture(folder: Path, **changed: object) -> Path:
    """A capture of the dumbbell at rest, and of two frames of it that nobody fits to."""
    cameras = cameras_around(12, SIZE)
    write_rest_views(folder / "rest_views", cameras)
    write_motion(folder / "views" / "still", dumbbell())
    document = {
        "format": "mphygs-capture/1",
        "name": "dumbbell",
        "gravity": [0.0, 0.0, -9.81],
        "object": {"views": "rest_views", "rest": "equilibrium"},
        "sequences": [{"name": "still", "fps": 50.0, "frames": 1, "views": "views/still"}],
    } | changed
    (folder / "capture.json").write_text(json.dumps(document))
    return folder


def write_motion(folder: Path, mesh: trimesh.Trimesh) -> None:
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    cameras: list[Camera] = cameras_around(3, SIZE, first=0.3)
    for camera in cameras:
        colour, mask = draw_mesh(camera, mesh)
        write_image(folder / "images" / f"{camera.name}.png", colour)
        write_image(folder / "masks" / f"{camera.name}.png", mask)
    files = [f"images/{camera.name}.png" for camera in cameras]
    write_transforms(folder / "transforms.json", cameras, files, [0] * len(cameras))


def dumbbell_volume() -> float:
    """[m^3], two balls and the part of the bar that is between them."""
    balls = dumbbell().split()[:2]
    between = (0.03 - 0.025) - (-0.035 + 0.016)
    return sum(ball.volume for ball in balls) + 0.012**2 * between


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_capture(tmp_path_factory.mktemp("capture"))


@pytest.fixture(scope="module")
def done(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with the object at rest, its features and its segments."""
    run = tmp_path_factory.mktemp("run")
    found = answer(reconstruct.main, capture, "--out", run, *QUICK)
    assert found["state"] == "new" and found["iou"] > 0.93 and found["psnr"] > 25
    answer(segment.main, capture, "--out", run, *OBJECT)
    return run


def test_an_object_is_segmented_from_its_views(capture: Path, done: Path) -> None:
    found = answer(segment.main, capture, "--out", done, *OBJECT)
    assert found["features"]["source"] == "colour, superpixels"
    particles = read_particles(done / "stages/object/particles.npz")
    parts = read_parts(done / "stages/object/parts")
    assert list(found["segments"]) == [part.name for part in parts]
    assert particles.inside.sum() == found["particles"]["inside"] == pytest.approx(3000, rel=0.15)
    volume = sum(part.volume for part in parts)
    assert volume == pytest.approx(dumbbell_volume(), rel=0.08)
    assert volume == pytest.approx(particles.inside.sum() * particles.spacing**3, rel=0.03)
    assert len(fill(parts, spacing=8e-3).cell) > 20
    for name in ("rest", "object"):
        assert (done / "stages" / name / "picture.png").stat().st_size > 5000


def test_what_is_made_is_kept_and_what_is_ones_own_is_used(capture: Path, done: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(done, run)
    path = run / "stages/rest/gaussians.ply"
    before = path.read_bytes()
    assert answer(reconstruct.main, capture, "--out", run, *QUICK)["state"] == "made"
    # options of another stage do not make this one again
    answer(segment.main, capture, "--out", run, *OBJECT, "--segments", 1)
    assert path.read_bytes() == before
    assert len(read_parts(run / "stages/object/parts")) == 1
    gaussians = read_gaussians(path)
    write_gaussians(path, gaussians.each(lambda tensor: tensor[: gaussians.count // 2]))
    found = answer(reconstruct.main, capture, "--out", run, *QUICK)
    assert found["state"] == "own" and found["gaussians"] == gaussians.count // 2
    np.savez(run / "stages/features/features.npz", appearance=np.zeros((3, 2)))
    code, _, err = call(segment.main, capture, "--out", run, *OBJECT)
    assert code == 2 and 'has no "affinity"' in err.splitlines()[-1]


def test_an_object_given_as_gaussians_is_looked_at_from_all_sides(done: Path, tmp_path: Path) -> None:
    folder = tmp_path / "capture"
    folder.mkdir()
    shutil.copy(done / "stages/rest/gaussians.ply", folder / "object.ply")
    document = {
        "format": "mphygs-capture/1", "name": "ply", "gravity": [0, 0, -9.81],
        "object": {"gaussians": "object.ply", "rest": "equilibrium"},
        "sequences": [{"name": "none", "fps": 50.0, "frames": 1}],
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(document))
    # pictures as coarse as those the Gaussians were made from: in finer ones they are thinner
    answer(segment.main, folder, "--out", tmp_path / "run", *OBJECT, "--longest", SIZE)
    volume = sum(part.volume for part in read_parts(tmp_path / "run/stages/object/parts"))
    assert volume == pytest.approx(dumbbell_volume(), rel=0.1)


def test_bad_captures_and_options_end_in_one_line(capture: Path, tmp_path: Path) -> None:
    def refused(folder: Path, *said: str, options: tuple[object, ...] = (), main=segment.main) -> None:
        code, out, err = call(main, folder, "--out", tmp_path / "run", *options)
        assert code == 2 and out == "", err
        for text in said:
            assert text in err.splitlines()[-1]
        assert not (tmp_path / "run/stages/rest/gaussians.ply").exists()

    refused(capture, "--features: got 'dream'", options=("--features", "dream"))
    refused(capture, "--masks: got 'dream'", options=("--masks", "dream"))
    refused(capture, "--alike -1", options=("--alike", -1))
    refused(capture, "--iterations 0", options=("--iterations", 0), main=reconstruct.main)

    def copied(name: str) -> Path:
        shutil.copytree(capture, tmp_path / name)
        return tmp_path / name

    other = copied("other")
    write_motion(other / "views/still", dumbbell().apply_scale(0.4))
    refused(other, 'sequence "still"', "times as large as the rest views")
    wrong = copied("wrong")
    path = wrong / "rest_views/transforms.json"
    document = json.loads(path.read_text())
    turned = np.array(document["frames"][4]["transform_matrix"])
    turned[:3, 3] += [0.06, -0.06, 0.06]
    document["frames"][4]["transform_matrix"] = turned.tolist()
    path.write_text(json.dumps(document))
    refused(wrong, '"view04"')
    empty = copied("empty")
    write_image(empty / "rest_views/masks/view03.png", np.zeros((SIZE, SIZE)))
    refused(empty, "view03", "the mask is empty")
    small = copied("small")
    write_image(small / "rest_views/masks/view03.png", np.ones((SIZE // 2, SIZE)))
    refused(small, "view03", f"is {SIZE} x {SIZE // 2} pixels")

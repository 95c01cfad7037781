"""The unit of a reconstruction: metres per unit, or a length that was measured."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command_example import answer, call
from gaussian_example import gaussians
from mphygs.capture.digest import digest_of
from mphygs.capture.errors import CaptureError
from mphygs.capture.format import load_capture, save_capture
from mphygs.capture.layouts import read_points
from mphygs.capture.view_folders import rest_views_of, sequence_views_of
from mphygs.commands import doctor, init, reconstruct
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.ply import read_gaussians, write_gaussians
from views_example import COUNT, SIZE, Rest, camera

PINHOLE = f"PINHOLE {SIZE} {SIZE} 60 60 {SIZE / 2} {SIZE / 2}"
# Metres per unit of the reconstructions here, whose unit is that of no ruler.
METRES = 0.0375


def rest_views(folder: Path, *, colmap: bool = True) -> Path:
    """A capture's folder with rest views in the unit of a reconstruction."""
    rest = Rest(folder / "rest", unit=1.0 / METRES)
    if colmap:
        rest.write_colmap("sparse/0", PINHOLE, unit=1.0 / METRES)
    else:
        rest.write()
    return folder


def capture(folder: Path, **keys: object) -> Path:
    """The same with its capture.json, of which keys stand beside the views."""
    document = {
        "format": "mphygs-capture/1", "name": "x", "gravity": [0, 0, -9.81],
        "object": {"views": "rest", "rest": "stress-free", **keys},
        "sequences": [{"name": "a", "fps": 30, "frames": 2}],
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(document))
    return folder


def between(a: int, b: int) -> float:
    return float(np.linalg.norm(camera(a).position - camera(b).position))


@pytest.mark.parametrize("colmap", [True, False])
@pytest.mark.parametrize(
    "ends",
    [
        ["view0", "view3"],
        ["view0.png", "images/view3.png"],
        [camera(0).position / METRES, camera(3).position / METRES],
    ],
)
def test_a_known_length_makes_metres(colmap: bool, ends: list, tmp_path: Path) -> None:
    ends = [end if isinstance(end, str) else end.tolist() for end in ends]
    folder = capture(rest_views(tmp_path, colmap=colmap), known_length=[ends, between(0, 3)])
    found = load_capture(folder)
    assert found.views_scale == pytest.approx(METRES, rel=1e-9)
    views = rest_views_of(found)
    for k in range(COUNT):
        seen = views.views[f"view{k}"].camera
        np.testing.assert_allclose(seen.position, camera(k).position, atol=1e-9)
        np.testing.assert_allclose(
            seen.camera_from_world[:3, :3], camera(k).camera_from_world[:3, :3], atol=1e-9
        )
    assert len(views.read()) == COUNT


def test_points_of_a_model_are_ends_as_well(tmp_path: Path) -> None:
    folder = capture(rest_views(tmp_path), known_length=[[7, 90], 0.04])
    found = load_capture(folder)
    assert found.views_scale == pytest.approx(METRES)
    points = read_points(found.views, found.views_scale)
    np.testing.assert_allclose(points.positions, [[-0.01, 0, 0], [0.03, 0, 0]], atol=1e-12)
    folder = capture(folder, known_length=[[7, (camera(1).position / METRES).tolist()], 0.4])
    assert load_capture(folder).views_scale > 0


def test_a_scale_makes_metres_and_stays_with_the_capture(tmp_path: Path) -> None:
    found = load_capture(capture(rest_views(tmp_path), scale=METRES))
    np.testing.assert_allclose(
        rest_views_of(found).views["view2"].camera.position, camera(2).position, atol=1e-9
    )
    save_capture(found, tmp_path / "again")
    again = load_capture(tmp_path / "again")
    assert again.views_scale == METRES
    np.testing.assert_allclose(
        rest_views_of(again).views["view2"].camera.position, camera(2).position, atol=1e-9
    )


def test_what_was_made_in_another_unit_is_made_anew(tmp_path: Path) -> None:
    folder = rest_views(tmp_path)
    loaded = [load_capture(capture(folder, **keys)) for keys in ({}, {"scale": 2.0}, {"scale": 3.0})]
    digests = {digest_of(each.views, each.views_scale) for each in loaded}
    assert len(digests) == 3


def test_a_motion_has_a_unit_of_its_own(tmp_path: Path) -> None:
    folder = capture(rest_views(tmp_path), scale=METRES)
    names = [f"images/cam{k}/{frame}.png" for k in range(2) for frame in range(2)]
    motion = Rest(folder / "motion", names, unit=1000.0)
    for k, entry in enumerate(motion.document["frames"]):
        entry |= {"camera": f"cam{k // 2}", "frame": k % 2}
        entry["transform_matrix"] = motion.document["frames"][k - k % 2]["transform_matrix"]
    motion.write()
    document = json.loads((folder / "capture.json").read_text())
    document["sequences"][0] |= {"views": "motion", "known_length": [["cam0", "cam1"], between(0, 2)]}
    (folder / "capture.json").write_text(json.dumps(document))
    recording = load_capture(folder).sequence("a")
    assert recording.views_scale == pytest.approx(1e-3)
    seen = sequence_views_of(recording).views["cam1", 1].camera
    np.testing.assert_allclose(seen.position, camera(2).position, atol=1e-9)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"scale": 0}, "object.scale: is 0; expected metres per unit of the reconstruction"),
        ({"scale": "mm"}, 'object.scale: is "mm"; expected a number'),
        ({"scale": 1, "known_length": [["view0", "view1"], 1]}, "known_length: stands beside scale"),
        ({"known_length": ["view0", "view1", 1]}, "known_length: is no length between two places"),
        ({"known_length": [["view0", "view9"], 1]}, '"view9" is no picture; expected a picture of rest'),
        ({"known_length": [["view0", "view0"], 1]}, "known_length[0]: names one place twice"),
        ({"known_length": [["view0", "view1"], 0]}, "known_length[1]: is 0; expected a length above zero"),
        ({"known_length": [[7, 8], 1]}, "is 8, which is no point of the model; expected one of its 2 points"),
        ({"known_length": [[7, None], 1]}, "known_length[0][1]: is null; expected [[a, b], metres]"),
        ({"known_length": [[[0, 0], [1, 0, 0]], 1]}, "known_length[0][0]: has shape (2,)"),
    ],
)
def test_units_that_are_refused(keys: dict, words: str, tmp_path: Path) -> None:
    with pytest.raises(CaptureError) as caught:
        load_capture(capture(rest_views(tmp_path), **keys))
    line = str(caught.value)
    assert words in line and "\n" not in line and "expected" in line


def test_points_and_units_without_their_model(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="a transforms.json has no points"):
        load_capture(capture(rest_views(tmp_path, colmap=False), known_length=[[7, 90], 1]))
    document = json.loads((tmp_path / "capture.json").read_text())
    document["object"].pop("known_length")
    document["sequences"][0]["scale"] = 2.0
    (tmp_path / "capture.json").write_text(json.dumps(document))
    with pytest.raises(CaptureError, match=r"sequences\[0\].scale: stands where no views are"):
        load_capture(tmp_path)


@pytest.mark.parametrize(("unit", "factor"), [(1e3, "0.001"), (1e-3, "1000")])
def test_units_that_are_off_by_1000(unit: float, factor: str, tmp_path: Path) -> None:
    folder = capture(rest_views(tmp_path), scale=METRES * unit)
    with pytest.raises(CaptureError, match=f"look off by 1000: set scale to {factor} times its value"):
        rest_views_of(load_capture(folder)).read()


# ---- the commands -----------------------------------------------------------------------------
def with_motion(folder: Path) -> Path:
    """Rest views and pictures of a motion, both of one COLMAP reconstruction."""
    rest_views(folder)
    names = [f"images/cam{k}/{frame}.png" for k in range(COUNT) for frame in range(2)]
    motion = Rest(folder / "motion", names[:COUNT], unit=1.0 / METRES)
    motion.write_colmap("sparse/0", PINHOLE, unit=1.0 / METRES)
    return folder


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--scale", METRES),
        ("--known-length", f"view0, view3, {between(0, 3)!r}"),
        ("--known-length", "7,90,0.04"),
    ],
)
def test_init_states_the_unit(option: str, value: object, tmp_path: Path) -> None:
    folder = with_motion(tmp_path)
    found = answer(init.main, folder, "--fps", 30, "--frames", 2, option, value)
    made = load_capture(folder)
    assert made.views_scale == pytest.approx(METRES)
    assert made.sequence("motion").views_scale == pytest.approx(METRES)
    assert "known_length" in found["document"]["object"] or option == "--scale"


def test_a_unit_that_nobody_states_is_asked_for(tmp_path: Path) -> None:
    folder = with_motion(tmp_path)
    code, out, _ = call(init.main, folder, "--fps", 30, "--frames", 2)
    assert code == 0 and "object: lengths of its COLMAP model are taken for metres" in out
    assert any("state scale or known_length" in line for line in answer(doctor.main, folder)["findings"])
    document = json.loads((folder / "capture.json").read_text())
    for entry in (document["object"], document["sequences"][0]):
        entry["scale"] = METRES
    (folder / "capture.json").write_text(json.dumps(document))
    assert not any("COLMAP" in line for line in answer(doctor.main, folder)["findings"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--known-length", "view0,view3"), "--known-length: got 'view0,view3'; expected A,B,METRES"),
        (("--known-length", "view0,view3,x"), "expected A,B,METRES"),
        (("--known-length", "view0,view3,1", "--scale", 2), "--known-length: --scale is given as well"),
        (("--known-length", "view0,nowhere,1"), '"nowhere" is no picture'),
        (("--scale", -1), "scale: is -1"),
    ],
)
def test_init_leaves_nothing_of_a_unit_that_is_none(options: tuple, words: str, tmp_path: Path) -> None:
    folder = with_motion(tmp_path)
    code, out, said = call(init.main, folder, "--fps", 30, "--frames", 2, *options)
    assert (code, out) == (2, "") and said.count("\n") == 1 and words in said
    assert not (folder / "capture.json").exists()


def splats(folder: Path, unit: float, **keys: object) -> Path:
    """A capture whose object is a 3DGS .ply in another unit."""
    folder.mkdir(exist_ok=True)
    write_gaussians(folder / "object.ply", in_unit(unit))
    document = {
        "format": "mphygs-capture/1", "name": "x", "gravity": [0, 0, -9.81],
        "object": {"gaussians": "object.ply", "rest": "stress-free", **keys},
        "sequences": [{"name": "a", "fps": 30, "frames": 2}],
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(document))
    return folder


def in_unit(unit: float) -> Gaussians:
    known = gaussians(60, features=0)
    return replace(known, positions=unit * known.positions, scales=unit * known.scales)


@pytest.mark.parametrize("keys", [{"scale": METRES}, {"known_length": [[[0, 0, 0], [0, 0, 2]], 2 * METRES]}])
def test_gaussians_of_another_program_are_made_metres(keys: dict[str, object], tmp_path: Path) -> None:
    folder = splats(tmp_path / "capture", 1.0 / METRES, **keys)
    found = load_capture(folder)
    assert found.gaussians_scale == pytest.approx(METRES)
    answer(reconstruct.main, folder, "--out", tmp_path / "run")
    made = read_gaussians(tmp_path / "run" / "stages" / "rest" / "gaussians.ply")
    true = in_unit(1.0)
    assert made.positions.numpy() == pytest.approx(true.positions.numpy(), rel=1e-5, abs=1e-7)
    assert made.scales.numpy() == pytest.approx(true.scales.numpy(), rel=1e-5)
    assert made.opacities.numpy() == pytest.approx(true.opacities.numpy(), abs=1e-5)
    save_capture(found, tmp_path / "again")
    assert load_capture(tmp_path / "again").gaussians_scale == found.gaussians_scale
    # Another scale is another object: what was made of the first one is not taken for it.
    splats(folder, 1.0 / METRES, scale=2 * METRES)
    answer(reconstruct.main, folder, "--out", tmp_path / "run")
    again = read_gaussians(tmp_path / "run" / "stages" / "rest" / "gaussians.ply")
    assert again.positions.numpy() == pytest.approx(2.0 * true.positions.numpy(), rel=1e-5, abs=1e-7)


def test_gaussians_of_no_sensible_size_say_what_to_state(tmp_path: Path) -> None:
    code, line = call(reconstruct.main, splats(tmp_path / "capture", 1000.0), "--out", tmp_path / "run")[::2]
    assert code == 2 and "m; expected 0.001 to 20 m; state scale" in line
    folder = splats(tmp_path / "named", 1.0, known_length=[["a", "b"], 0.1])
    code, line = call(reconstruct.main, folder, "--out", tmp_path / "other")[::2]
    assert code == 2 and "Gaussians have no pictures" in line


def test_init_tells_gaussians_from_meshes(tmp_path: Path) -> None:
    write_gaussians(tmp_path / "scene.ply", in_unit(1.0 / METRES))
    Rest(tmp_path / "motion", [f"images/cam{k}/0.png" for k in range(2)]).write()
    transforms = json.loads((tmp_path / "motion" / "transforms.json").read_text())
    for k, entry in enumerate(transforms["frames"]):
        entry |= {"camera": f"cam{k}", "frame": 0}
    (tmp_path / "motion" / "transforms.json").write_text(json.dumps(transforms))
    options = (tmp_path, "--fps", 30, "--frames", 1)
    assert "expected --scale" in call(init.main, *options, "--known-length", "a,b,1")[2]
    told = answer(init.main, *options, "--scale", METRES)["document"]
    assert told["object"]["gaussians"] == "scene.ply" and told["object"]["scale"] == METRES
    assert "scale" not in told["sequences"][0]
    assert load_capture(tmp_path).gaussians_scale == METRES

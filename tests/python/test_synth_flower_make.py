"""A flower's capture reads back, its pictures show what moved, and its truth is the truth."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from flower_example import SMALL, small_flower
from mphygs.capture.cameras import Camera
from mphygs.capture.format import load_capture
from mphygs.capture.view_folders import rest_views_of, sequence_views_of
from mphygs.scene.agreement import check_first_frame
from mphygs.synth.flower import SPECIES, make_flower
from mphygs.synth.flower.recording_settings import Shoot


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("flower") / "daisy"
    small_flower(path, hidden=("air_drag:c_d=40",))
    return path


def surface(folder: Path, take: str) -> np.ndarray:
    with np.load(folder / "truth" / f"{take}_surface.npz") as arrays:
        return arrays["vertices"].astype(float)


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def near(mask: np.ndarray, pixel: np.ndarray, reach: int = 1) -> np.ndarray:
    """The largest value of a mask (H, W) within `reach` pixels of places (N, 2) [px]."""
    padded = np.pad(mask, reach)
    column, row = np.floor(pixel).astype(int).T
    steps = [(i, j) for i in range(2 * reach + 1) for j in range(2 * reach + 1)]
    return np.max([padded[row + i, column + j] for i, j in steps], axis=0)


def triangulated(cameras: list[Camera], pixels: np.ndarray) -> np.ndarray:
    """The point (3,) nearest to the lines of sight."""
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    for camera, pixel in zip(cameras, pixels, strict=True):
        ray = camera.rays(pixel)
        across = np.eye(3) - np.outer(ray, ray)
        matrix, right = matrix + across, right + across @ camera.position
    return np.linalg.solve(matrix, right)


def test_it_reads_back_as_a_capture_in_pictures(folder) -> None:
    capture = load_capture(folder)
    assert capture.parts == () and capture.rest == "equilibrium" and capture.known.mass > 1e-3
    rest = rest_views_of(capture)
    assert len(rest.views) == SMALL.rest_views
    assert [s.name for s in capture.sequences] == ["frog", "turned"]
    for sequence in capture.sequences:
        assert sequence.frames == 8 and sequence.markers is None
        views = sequence_views_of(sequence, rest)
        assert len(views.cameras) == 3 and len(views.read(7)) == 3
        assert len(views.correspondences) >= 3 and set(views.contact) == set(views.cameras)
        hold = sequence.held[0]
        assert np.allclose(hold.position[0], 0) and np.abs(np.diff(hold.position, axis=0)).max() > 1e-5
    first, second = capture.sequences
    assert (first.fit, first.predict, second.fit, second.predict) == ((0, 4), (4, 6), (0, 0), (0, 8))


def test_masks_are_the_silhouettes_of_what_moved(folder) -> None:
    capture = load_capture(folder)
    rest = rest_views_of(capture)
    shown = [(view.read(), surface(folder, "frog")[0]) for view in rest.views.values()]
    for sequence in capture.sequences:
        views = sequence_views_of(sequence, rest)
        for frame in (0, 7):
            shown += [(photo, surface(folder, sequence.name)[frame]) for photo in views.read(frame)]
    for photo, vertices in shown:
        pixel, depth = photo.camera.project(vertices)
        assert (depth > 0).all() and (pixel >= 0).all() and (pixel <= 64).all()
        assert near(photo.mask, pixel).min() > 0
        rows, columns = np.nonzero(photo.mask)
        low, high = pixel.min(axis=0), pixel.max(axis=0)
        assert np.abs([columns.min() - low[0], rows.min() - low[1]]).max() < 1.2
        assert np.abs([columns.max() + 1 - high[0], rows.max() + 1 - high[1]]).max() < 1.2
        # black where nothing is, coloured where the flower is
        assert photo.colour[photo.mask == 0].max(initial=0) == 0
        assert photo.colour[photo.mask == 1].max(axis=1).min() > 0.05
        assert 0.02 < photo.mask.mean() < 0.4


def test_true_tracks_lie_on_the_flower_in_every_picture(folder) -> None:
    capture, truth = load_capture(folder), load_capture(folder / "truth")
    assert [part.name for part in truth.parts] == ["stem", "receptacle", "leaves", "petals"]
    for seen, sequence in zip(capture.sequences, truth.sequences, strict=True):
        tracks = sequence.markers.position
        assert tracks.shape == (8, SMALL.tracks, 3)
        assert np.abs(tracks[0] - sequence.markers.at).max() < 1e-6
        views = sequence_views_of(seen, rest_views_of(capture))
        for frame in range(8):
            for photo in views.read(frame):
                assert near(photo.mask, photo.camera.project(tracks[frame])[0]).min() > 0
        held = sequence.held[0].box
        inside = ((sequence.markers.at >= held[0]) & (sequence.markers.at <= held[1])).all(axis=1)
        rotation, shift = sequence.held[0].poses(np.arange(8) / 50.0, 50.0)
        rigid = np.einsum("tij,mj->tmi", rotation, sequence.markers.at[inside]) + shift[:, None]
        assert inside.any() and np.abs(tracks[:, inside] - rigid).max() < 1e-6
    # it bends: away from the hold it does not follow rigidly
    everywhere = np.einsum("tij,mj->tmi", rotation, sequence.markers.at) + shift[:, None]
    assert np.abs(tracks - everywhere).max() > 2e-4


def test_it_starts_at_rest_and_the_answer_says_what_it_is_made_of(folder) -> None:
    answer = json.loads((folder / "answer.json").read_text())
    truth = load_capture(folder / "truth")
    for take in ("frog", "turned"):
        moved = surface(folder, take)
        assert np.abs(moved[1] - moved[0]).max() < 3e-4 < np.abs(moved[-1] - moved[0]).max()
    for part in truth.parts:
        said = answer["parts"][part.name]
        assert said["mass"] == pytest.approx(said["rho"] * part.volume, rel=1e-6)
        assert truth.known.density[part.name] == said["rho"]
    total = sum(said["mass"] for said in answer["parts"].values())
    assert load_capture(folder).known.mass == pytest.approx(total)
    assert answer["hidden"] == ["air_drag"] and answer["effects"]["air_drag"]["c_d"] == 40.0
    apart = answer["differences"]["without_all"]
    assert all(1e-6 < apart[take]["rms_difference_m"] < 5e-3 for take in ("frog", "turned"))
    assert answer["rest"] == "equilibrium" and min(answer["largest_motion_m"]) > 2e-4


def test_what_is_pointed_at_is_where_it_is(folder) -> None:
    capture = load_capture(folder)
    rest = rest_views_of(capture)
    sequence = capture.sequences[0]
    views = sequence_views_of(sequence, rest)
    hold = sequence.held[0]
    cameras = {name: views.views[name, 0].camera for name in views.cameras}
    place = np.array([0.0, 0.0, 0.5 * hold.box[1, 2]])
    for frame in (0, 5):
        rotation, shift = hold.poses(np.array([frame / 50.0]), 50.0)
        pixels = [views.contact[name][frame] for name in cameras]
        found = triangulated(list(cameras.values()), np.array(pixels))
        assert np.linalg.norm(found - rotation[0] @ place - shift[0]) < 4e-3
    vertices = surface(folder, "frog")[0]
    rest_rig = {name: view.camera for name, view in rest.views.items()}
    for point in views.correspondences:
        for side, known in ((point.rest, rest_rig), (point.first, cameras)):
            found = triangulated([known[name] for name in side], np.array(list(side.values())))
            assert np.linalg.norm(vertices - found, axis=1).min() < 6e-3


def test_first_frames_fit_the_rest_views(folder) -> None:
    capture = load_capture(folder)
    rest = rest_views_of(capture)
    for sequence in capture.sequences:
        views = sequence_views_of(sequence, rest)
        found = check_first_frame(rest.read(), views.read(0), views.correspondences)
        assert max(found.error.values()) < 1.5 and 0.85 < found.size < 1.15 and found.colours > 0.5


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(folder, tmp_path) -> None:
    again = tmp_path / "again"
    # begun from the simulation alone, as after an interruption while pictures were drawn
    shutil.copytree(folder, again)
    shutil.rmtree(again / "views")
    shutil.rmtree(again / "rest_views")
    for name in ("answer.json", "capture.json", "truth/frog_surface.npz"):
        (again / name).unlink()
    kept = (again / "truth" / "turned_surface.npz").stat().st_mtime_ns
    small_flower(again, hidden=("air_drag:c_d=40",))
    assert (again / "truth" / "turned_surface.npz").stat().st_mtime_ns == kept
    assert files(again) == files(folder)
    other = tmp_path / "other"
    small_flower(other, seed=2)
    one, two = files(folder), files(other)
    pictures = [name for name in one if name.endswith(".png") and "images" in name]
    assert len(pictures) == 8 + 2 * 3 * 8
    assert all(one[name] != two[name] for name in pictures)
    assert one["truth/stem.ply"] != two["truth/stem.ply"]


def test_a_folder_of_something_else_is_left_alone(folder, tmp_path) -> None:
    before = files(folder)
    with pytest.raises(ValueError, match="made of other options"):
        small_flower(folder, seed=9)
    assert files(folder) == before
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(ValueError, match="holds something else"):
        small_flower(tmp_path)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"species": "cactus"}, "expected one of"),
        ({"hidden": ("smoke",)}, "expected one of"),
        ({"hidden": ("time_offset",)}, "faults of the measurement"),
        ({"hidden": ("viscosity", "viscosity")}, "every name once"),
    ],
)
def test_what_cannot_be_made_is_refused_before_anything_is_written(arguments, said, tmp_path) -> None:
    with pytest.raises(ValueError, match=said):
        small_flower(tmp_path / "x", **arguments)
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("options", [{"size": 8}, {"cameras": 1}, {"noise": 0.9}, {"spacing_share": 0.1}])
def test_a_shoot_that_shows_nothing_is_refused(options) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        Shoot(**options)


@pytest.mark.slow
@pytest.mark.parametrize("name", SPECIES)
def test_every_species_can_be_moved(name, tmp_path) -> None:
    made = make_flower(name, tmp_path / name, shoot=Shoot(size=32, frames=40, spacing_share=1.2, cameras=2))
    assert all(1e-3 < far < 0.2 for far in made.answer["largest_motion_m"])

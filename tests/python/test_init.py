"""The init command: a capture.json for a folder of files."""

import io
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from command_example import answer, call, make_capture
from mphygs.capture.draft import read_csv
from mphygs.capture.format import load_capture
from mphygs.commands import init

HELD = "-1,-1,-1:1e-4,1,1"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_capture(tmp_path_factory.mktemp("made"))


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """The files of a capture without its capture.json."""
    out = shutil.copytree(made, tmp_path / "files")
    (out / "capture.json").unlink()
    return out


def test_it_is_the_capture_that_the_files_came_from(folder: Path, made: Path) -> None:
    found = answer(init.main, folder, "--fps", 100, "--held", HELD, "--sigma", 1e-4, "--mass", 0.0078)
    assert json.loads((folder / "capture.json").read_text()) == found["document"]
    ours, theirs = load_capture(folder), load_capture(made)
    assert ours.name == "files" and ours.known.mass == 0.0078
    assert np.array_equal(ours.parts[0].vertices, theirs.parts[0].vertices)
    for one in theirs.sequences:
        other = ours.sequence(one.name)
        assert (other.fps, other.frames) == (one.fps, one.frames) and other.fit == (0, 14)
        assert np.array_equal(other.markers.position, one.markers.position, equal_nan=True)
        assert np.abs(other.markers.at - one.markers.at).max() < 3e-3
        # The hold of the shaken one moves as its file says.
        assert other.held[0].is_fixed == one.held[0].is_fixed
        assert np.array_equal(other.held[0].position, one.held[0].position) or one.held[0].is_fixed


def test_a_table_in_millimetres(folder: Path, made: Path) -> None:
    position = load_capture(made).sequence("swing").markers.position
    for path in folder.glob("*.npz"):
        path.unlink()
    mesh = trimesh.load(folder / "bar.ply")
    mesh.apply_scale(1000.0)
    mesh.export(folder / "bar.ply")
    names = [f"m{k}_{axis}" for k in range(position.shape[1]) for axis in "xyz"]
    rows = [",".join(["time", *names])]
    for k, frame in enumerate(position):
        cells = ["" if np.isnan(v) else repr(1e3 * float(v)) for v in frame.ravel()]
        rows.append(",".join([str(k / 100), *cells]))
    (folder / "drop.csv").write_text("\n".join(rows) + "\n")
    scales = ("--scale", 1e-3, "--marker-scale", 1e-3)
    answer(init.main, folder, "--fps", 100, "--held", HELD, *scales)
    found = load_capture(folder)
    assert [s.name for s in found.sequences] == ["drop"]
    assert np.allclose(found.sequence("drop").markers.position, position, atol=1e-12, equal_nan=True)
    assert found.diagonal == pytest.approx(load_capture(made).diagonal)
    assert read_csv(folder / "drop.csv")[1][:2] == ("m0", "m1")


@pytest.mark.parametrize("kind", [".npz", ".csv"])
def test_zeros_for_gaps_at_the_beginning_are_no_place(kind: str, made: Path, tmp_path: Path) -> None:
    position = load_capture(made).sequence("swing").markers.position.copy()
    position[:3, 5] = 0.0
    shutil.copyfile(made / "bar.ply", tmp_path / "bar.ply")
    if kind == ".npz":
        np.savez(tmp_path / "a.npz", position=position)
    else:
        rows = [",".join("" if np.isnan(v) else repr(float(v)) for v in frame.ravel()) for frame in position]
        (tmp_path / "a.csv").write_text("\n".join(rows))
    answer(init.main, tmp_path, "--fps", 100, "--held", HELD)
    markers = load_capture(tmp_path).sequence("a").markers
    assert np.abs(markers.at - load_capture(made).sequence("swing").markers.at).max() < 3e-3
    assert np.isnan(markers.position[:3, 5]).all()


def test_it_asks_where_a_terminal_is_there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO(f"{HELD}\n100\n100\n")
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stdin", terminal)
    code, _, said = call(init.main, folder)
    assert code == 0 and "what holds it" in said and "frames per second of swing_markers.npz" in said
    assert not load_capture(folder).sequence("other").held[0].is_fixed


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--held", HELD), "--fps: other_markers.npz does not say its rate; expected frames per second"),
        (("--fps", 100, "--held", "1,2"), "--held: got '1,2'; expected x,y,z:x,y,z, or none"),
        (("--fps", 100), "--held: 0 boxes; expected 1, one for each motion of other"),
        (("--fps", 100, "--held", HELD, "--gravity", "9.81"), "--gravity: got '9.81'; expected 3 numbers"),
        (("--fps", 100, "--held", HELD, "--share", 0), "--share: got 0; expected above 0, at most 1"),
        (("--fps", 100, "--held", HELD, "--scale", 1000), "capture.json"),
        (("--fps", 100, "--held", "5,5,5:6,6,6"), "held[0]"),
    ],
)
def test_what_cannot_be_meant_leaves_nothing(folder: Path, arguments: tuple, words: str) -> None:
    before = sorted(folder.iterdir())
    code, out, said = call(init.main, folder, *arguments)
    assert (code, out) == (2, "") and said.count("\n") == 1 and words in said
    assert sorted(folder.iterdir()) == before


def test_nothing_is_replaced(made: Path, tmp_path: Path) -> None:
    code, _, said = call(init.main, made, "--fps", 100)
    assert code == 2 and "capture.json: is there already; expected a folder without one" in said
    (tmp_path / "broken.npz").write_bytes(b"PK")
    code, _, said = call(init.main, tmp_path)
    assert code == 2 and "broken.npz: cannot be read" in said
    (tmp_path / "broken.npz").unlink()
    code, _, said = call(init.main, tmp_path)
    assert code == 2 and "has no mesh, no folder of views at rest and no Gaussians" in said


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1,2,3,4\n", "has 1 rows of 4 columns; expected a row a frame, three columns a marker"),
        ("a_x,a_y,a_z\n1,2,x\n", 'frame 0, column 3: is "x"; expected a number'),
        ("1,2,3\n1,2\n", "frame 1: has 2 columns; expected 3"),
        ("", "is empty"),
    ],
)
def test_tables_that_are_none(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(ValueError, match="t.csv") as raised:
        read_csv(tmp_path / "t.csv")
    assert words in str(raised.value)

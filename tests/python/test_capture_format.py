"""A capture folder as a whole: what is read, what is refused and how."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from capture_example import FRAMES, Example, bar, shared
from mphygs.capture.errors import CaptureError
from mphygs.capture.format import load_capture, save_capture
from mphygs.capture.meshes import write_mesh


def test_the_example_is_read(tmp_path: Path) -> None:
    capture = Example(tmp_path).load()
    assert capture.name == "example" and capture.folder == tmp_path and capture.rest == "stress-free"
    assert np.array_equal(capture.gravity, [0, 0, -9.81])
    assert [part.name for part in capture.parts] == ["low", "high"]
    assert np.allclose([part.volume for part in capture.parts], 0.05 * 0.02 * 0.02, rtol=1e-6)
    assert np.allclose(capture.bounds, [[0, -0.01, -0.01], [0.1, 0.01, 0.01]], atol=1e-9)
    assert np.isclose(capture.diagonal, np.linalg.norm([0.1, 0.02, 0.02]))
    assert capture.known.density == {"low": 1000.0} and capture.known.poissons_ratio == 0.4
    assert capture.known.mass == 0.04
    a, b = capture.sequences
    assert (a.fps, a.frames, a.fit, a.predict, a.release) == (50.0, FRAMES, (0, 8), (8, FRAMES), 6)
    assert (b.fit, b.predict, b.release, b.markers, b.views, b.loads) == (
        (0, 0),
        (0, 0),
        None,
        None,
        None,
        (),
    )
    assert b.held[0].is_fixed and capture.sequence("b.2") is b
    with pytest.raises(KeyError, match=r'no sequence \\"c\\"; expected one of a, b.2|no sequence "c"'):
        capture.sequence("c")


def test_the_file_itself_may_be_named(tmp_path: Path) -> None:
    example = Example(tmp_path)
    example.write()
    assert load_capture(str(tmp_path / "capture.json")).folder == tmp_path


def test_known_values_per_part_or_for_all(tmp_path: Path) -> None:
    example = Example(tmp_path)
    example.document["object"]["known"] = {"density": 1070, "poissons_ratio": {"high": 0.3}}
    known = example.load().known
    assert known.density == {"low": 1070.0, "high": 1070.0} and known.poissons_ratio == {"high": 0.3}
    assert known.mass is None
    del example.document["object"]["known"]
    known = example.load().known
    assert known.density == {} and known.poissons_ratio is None and known.mass is None


def test_gaussians_or_views_instead_of_parts(tmp_path: Path) -> None:
    example = Example(tmp_path)
    known = {"density": 1070}
    example.document["object"] = {"gaussians": "low.ply", "rest": "equilibrium", "known": known}
    capture = example.load()
    assert capture.gaussians == tmp_path / "low.ply" and capture.parts == () and capture.views is None
    assert capture.bounds is None and capture.diagonal is None and capture.known.density == {"object": 1070.0}
    example.document["object"] = {"views": "rest", "rest": "equilibrium"}
    assert 'object.views: "rest" does not exist' in example.complaint()
    (tmp_path / "rest" / "sparse" / "0").mkdir(parents=True)
    assert example.load().views == tmp_path / "rest"
    assert example.load().found_as == "solid"
    example.document["object"]["as"] = "auto"
    capture = example.load()
    assert capture.found_as == "auto"
    save_capture(capture, tmp_path / "again")
    assert load_capture(tmp_path / "again").found_as == "auto"
    example.document["object"]["as"] = "shell"
    assert 'object.as: is "shell"; expected one of solid, auto' in example.complaint()
    example.document["object"] = {"gaussians": "high.stl", "rest": "equilibrium"}
    assert "object.gaussians" in example.complaint() and "is not a .ply file" in example.complaint()


def test_measured_video(tmp_path: Path) -> None:
    example = Example(tmp_path)
    (tmp_path / "video").mkdir()
    example.sequence["views"] = "video"
    assert "sequences[0].views" in example.complaint() and "holds no cameras" in example.complaint()
    (tmp_path / "video" / "transforms.json").write_text("{}")
    del example.sequence["markers"]
    assert example.load().sequence("a").views == tmp_path / "video"


def set_key(*path: str | int, value: object) -> Callable[[Example], None]:
    """A change of one value of the document."""

    def change(example: Example) -> None:
        node = example.document
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = value

    return change


def test_one_body_as_two_parts_is_refused(tmp_path: Path) -> None:
    example = Example(tmp_path)
    parts = example.document["object"]["parts"]
    parts[1] = {"name": "high", "mesh": "high.ply"}
    whole = bar((0.0, -0.01, -0.01), (0.1, 0.01, 0.01))
    for name in ("low", "high"):
        whole.export(tmp_path / f"{name}.ply")
    line = example.complaint()
    assert 'object.parts[1].mesh: part "high" lies inside part "low", which owns the material there' in line
    # Stated before the outer one, an inner part is one.
    bar((0.01, -0.005, -0.005), (0.03, 0.005, 0.005)).export(tmp_path / "low.ply")
    assert [part.name for part in example.load().parts] == ["low", "high"]


def drop(*path: str | int) -> Callable[[Example], None]:
    """A change that takes one key out of the document."""

    def change(example: Example) -> None:
        node = example.document
        for key in path[:-1]:
            node = node[key]
        del node[path[-1]]

    return change


def rename_first(name: str) -> Callable[[Example], None]:
    """Another name for the first part, of which then no density is given."""

    def change(example: Example) -> None:
        example.document["object"]["parts"][0]["name"] = name
        del example.document["object"]["known"]["density"]

    return change


OBJECT, PART, FIRST = ("object",), ("object", "parts", 0), ("sequences", 0)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            set_key("format", value="mphygs-capture/2"),
            'format: is "mphygs-capture/2"; expected "mphygs-capture/1"',
        ),
        (drop("format"), '"format" is missing'),
        (drop("gravity"), '"gravity" is missing'),
        (set_key("gravity", value=[0, -9.81]), "gravity: has shape (2,); expected an array of shape (3,)"),
        (set_key("gravity", value="down"), 'gravity: is "down"; expected an array of shape (3,)'),
        (set_key("gravity", value=[0, 0, -9810]), "gravity: is 9810 m/s^2 strong; expected at most 300"),
        (set_key("name", value=3), "name: is 3; expected a text"),
        (set_key("extra", value=3), "extra: unknown key"),
        (set_key("sequence", value=[]), 'sequence: unknown key (did you mean "sequences"?)'),
        (set_key("sequences", value=[]), "sequences: is empty; expected at least one sequence"),
        (set_key("sequences", value={}), "sequences: is an object {...}; expected a list"),
        (set_key(*OBJECT, value=[]), "object: is a list; expected an object"),
        (
            set_key(*OBJECT, "rest", value="sagging"),
            'rest: is "sagging"; expected "stress-free" or "equilibrium"',
        ),
        (drop(*OBJECT, "rest"), 'object: "rest" is missing'),
        (drop(*OBJECT, "parts"), "object: has no geometry; expected exactly one of parts, gaussians, views"),
        (
            set_key(*OBJECT, "gaussians", value="low.ply"),
            "object: has parts and gaussians; expected exactly one of",
        ),
        (set_key(*OBJECT, "as", value="auto"), "object.as: stands beside parts; expected views or gaussians"),
        (set_key(*OBJECT, "parts", value=[]), "object.parts: is empty; expected at least one part"),
        (set_key(*PART, "colour", value="red"), "object.parts[0].colour: unknown key"),
        (set_key(*PART, "mesh", value="no.ply"), 'object.parts[0].mesh: "no.ply" does not exist'),
        (
            set_key(*PART, "mesh", value="/low.ply"),
            'object.parts[0].mesh: is "/low.ply"; expected a path relative',
        ),
        (
            set_key(*PART, "mesh", value="../low.ply"),
            'object.parts[0].mesh: "../low.ply" leads out of the folder',
        ),
        (set_key(*PART, "mesh", value="hold.npz"), "hold.npz: is an archive; expected a closed"),
        (set_key(*PART, "scale", value=0), "object.parts[0].scale: is 0; expected a number above zero"),
        (
            rename_first("high"),
            'object.parts[1].name: "high" is given twice; expected every name',
        ),
        (rename_first("a.b"), 'object.parts[0].name: is "a.b"; expected letters'),
        (rename_first("../a"), 'object.parts[0].name: is "../a"; expected letters'),
        (
            set_key(*OBJECT, "known", "density", "low", value=-5),
            "known.density.low: is -5; expected a density above",
        ),
        (
            set_key(*OBJECT, "known", "density", "low", value=1.07),
            "known.density.low: is 1.07 kg/m^3; expected 5 to",
        ),
        (set_key(*OBJECT, "known", "density", value={"stem": 1}), "known.density.stem: unknown key"),
        (set_key(*OBJECT, "known", "density", value="x"), 'known.density: is "x"; expected a number'),
        (
            set_key(*OBJECT, "known", "poissons_ratio", value=0.5),
            "poissons_ratio: is 0.5; expected a Poisson's ratio",
        ),
        (
            set_key(*OBJECT, "known", "poissons_ratio", value={"low": -0.3}),
            "known.poissons_ratio.low: is -0.3; expected a Poisson's ratio from 0 to below 0.4995",
        ),
        (set_key(*OBJECT, "known", "mass", value=0), "known.mass: is 0; expected a mass above zero"),
        (
            set_key(*OBJECT, "known", "mass", value=40),
            "object.known.mass: 40 kg in 4e-05 m^3 is 1e+06 kg/m^3",
        ),
        (
            set_key(*OBJECT, "known", "mass", value=0.01),
            "object.known.mass: 0.01 kg is less than the 0.02 kg",
        ),
        (set_key(*OBJECT, "known", "youngs_modulus", value=1), "known.youngs_modulus: unknown key"),
        (set_key(*FIRST, "fps", value=0), "sequences[0].fps: is 0; expected frames per second from 0.1"),
        (set_key(*FIRST, "fps", value="30"), 'sequences[0].fps: is "30"; expected a number'),
        (set_key(*FIRST, "frames", value=0), "sequences[0].frames: is 0; expected at least 1"),
        (set_key(*FIRST, "frames", value=12.0), "sequences[0].frames: is 12.0; expected an integer"),
        (
            set_key(*FIRST, "fit", value=[0, 13]),
            "sequences[0].fit: is [0, 13]; expected [a, b] with 0 <= a <= b <= 12",
        ),
        (set_key(*FIRST, "fit", value=[5, 4]), "sequences[0].fit: is [5, 4]"),
        (set_key(*FIRST, "predict", value=[-1, 4]), "sequences[0].predict: is [-1, 4]"),
        (set_key(*FIRST, "predict", value=[1, 4, 5]), "sequences[0].predict: has 3 elements"),
        (
            set_key(*FIRST, "release", value=12),
            "sequences[0].release: is 12; expected a frame of the sequence, 0 to 11",
        ),
        (set_key(*FIRST, "release", value=-1), "sequences[0].release: is -1"),
        (set_key(*FIRST, "release", value=None), "sequences[0].release: is null; expected an integer"),
        (set_key(*FIRST, "name", value="b.2"), 'sequences[1].name: "b.2" is given twice'),
        (set_key(*FIRST, "name", value="a,b"), 'sequences[0].name: is "a,b"; expected letters'),
        (set_key(*FIRST, "held", value={}), "sequences[0].held: is an object {...}; expected a list"),
        (set_key(*FIRST, "hold", value=[]), 'sequences[0].hold: unknown key (did you mean "held"?)'),
        (
            drop(*FIRST, "markers"),
            "sequences[0].fit: nothing is measured in this sequence; expected markers or views",
        ),
        (set_key(*FIRST, "views", value="x"), 'sequences[0].views: "x" does not exist'),
    ],
)
def test_faults_of_the_document(tmp_path: Path, spoil: Callable[[Example], None], message: str) -> None:
    line = Example(tmp_path).complaint(spoil)
    assert message in line
    assert line.startswith(str(tmp_path / "capture.json")) or "hold.npz" in line


def test_json_faults_name_the_line(tmp_path: Path) -> None:
    example = Example(tmp_path)
    text = (example.write() / "capture.json").read_text().replace('"gravity":', '\n"gravity"')
    (tmp_path / "capture.json").write_text(text)
    with pytest.raises(CaptureError, match=r"capture.json: line 2 column 11: Expecting ':' delimiter"):
        load_capture(tmp_path)
    (tmp_path / "capture.json").write_text("[]")
    with pytest.raises(CaptureError, match=r"capture.json: is a list; expected an object"):
        load_capture(tmp_path)


def test_no_capture_there(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none", tmp_path / "none" / "capture.json"):
        with pytest.raises(CaptureError, match=r"is not a capture; expected a folder with a capture.json"):
            load_capture(path)


def scaled(low: float, high: float) -> Callable[[Example], None]:
    """A change of the scales of the two parts."""

    def change(example: Example) -> None:
        for part, scale in zip(example.document["object"]["parts"], (low, high), strict=True):
            part["scale"] = scale

    return change


@pytest.mark.parametrize(
    ("low", "high", "message"),
    [
        (
            1000.0,
            1.0,
            "parts[0].scale: the object is 104 m across; expected 0.001 to 20 m; its units look off by 1000",
        ),
        (1.0, 1.0, "parts[1].scale: the object is 104 m across"),
        (1e-3, 1e-6, "the object is 0.000104 m across"),
        (1e-3, 1e-3, 'parts[0].scale: part "low" is 5.74e-05 m across in an object of 0.104 m'),
    ],
)
def test_units_off_by_a_thousand_name_the_scale_to_set(
    tmp_path: Path, low: float, high: float, message: str
) -> None:
    line = Example(tmp_path).complaint(scaled(low, high))
    assert message in line and "set scale to" in line


def test_an_open_mesh(tmp_path: Path) -> None:
    mesh = trimesh.creation.box()
    mesh.update_faces(np.arange(12) > 1)
    mesh.export(tmp_path / "open.ply")
    line = Example(tmp_path).complaint(set_key(*PART, "mesh", value="open.ply"))
    assert "open.ply: is not closed: 4 open edges" in line and "expected a closed surface" in line


@pytest.mark.parametrize("name", ["p1", "p2", "p3", "p4", "p5"])
def test_practice_captures_load(name: str) -> None:
    capture = load_capture(shared("practice", name))
    assert capture.name == name and 0.1 < capture.diagonal < 0.2
    for sequence in capture.sequences:
        assert sequence.markers is not None and sequence.frames == 80
        missing = np.isnan(sequence.markers.position).mean()
        assert 0.015 < missing < 0.025
        rest = sequence.markers.position[0] - sequence.markers.at
        assert np.nanstd(rest) < 2 * sequence.markers.sigma


def test_silicone_beam_loads() -> None:
    capture = load_capture(shared("silicone-beam"))
    assert capture.known.density == {"beam": 1070.0}
    assert np.isclose(capture.parts[0].volume, 9e-5, rtol=1e-6)
    assert capture.sequence("load101-a").loads[0].start_frame == 51


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        (("sequences", 0, "fps"), 1e-6, "fps: is 1e-06; expected frames per second from 0.1"),
        (("sequences", 0, "fps"), 1e308, "fps: is 1e+308; expected frames per second"),
        (("sequences", 0, "fps"), 0.001, "fps: is 0.001"),
        (("sequences", 0, "frames"), 10**12, "frames: is 1000000000000; expected at least 1, at most"),
        (("sequences", 0, "markers", "sigma"), 1e-320, "sigma: is 1e-320; expected a standard deviation"),
        (("sequences", 0, "markers", "sigma"), 1e300, "sigma: is 1e+300"),
        (("sequences", 0, "markers", "at", 1, 0), 1e300, "at[1][0]: is 1e+300; expected a number of at most"),
        (("sequences", 0, "loads", 0, "force"), [0, 0, -1e6], "force: 1e+06 N on an object of about 0.04 kg"),
        (("sequences", 0, "loads", 0, "force"), [1e4, 0, 0], "times its weight; expected at most"),
        (
            ("sequences", 0, "loads", 0, "force", 2),
            1e300,
            "force[2]: is 1e+300; expected a number of at most",
        ),
        (("sequences", 0, "held", 0, "box", 0, 0), -1e300, "box[0][0]: is -1e+300"),
        (("sequences", 0, "release"), 1e300, "release: is 1e+300; expected an integer"),
        (("gravity", 2), 1e300, "gravity[2]: is 1e+300"),
        (("gravity", 2), -9810, "gravity: is 9810 m/s^2 strong"),
        (("object", "known", "mass"), 1e300, "mass: is 1e+300"),
        (("object", "known", "mass"), 5e-324, "mass: is 5e-324"),
        (("object", "known", "density"), {"low": 1e300}, "density.low: is 1e+300"),
        (("object", "known", "density"), 1e-300, "is 1e-300 kg/m^3; expected 5 to"),
        (("object", "parts", 0, "scale"), 1e300, "scale: is 1e+300"),
        (("object", "parts", 0, "scale"), 1e-300, "scale: is 1e-300"),
        (("object", "parts", 0, "name"), "x" * 5000, "name: is a text of 5000 characters"),
        (("sequences", 0, "name"), "n" * 150, "at most 100 bytes"),
        (("sequences", 0, "name"), "a\u0007b", "name: holds characters that do not print"),
        (("name",), "\u001b[2J", "name: holds characters that do not print"),
        (("name",), 7, "name: is 7; expected a text"),
        (("sequences", 0, "markers", "file"), "x\u001b[31m" * 900, "file: "),
    ],
)
def test_values_that_cannot_be_meant(keys: tuple, value: object, words: str, tmp_path: Path) -> None:
    example = Example(tmp_path)
    inner = example.document
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    line = example.complaint()
    assert words in line and line.isprintable() and len(line) < 2000


@pytest.mark.parametrize("thickness", [1e-6, 2e-5, 5e-5])
def test_a_part_too_thin_for_any_grid(thickness: float, tmp_path: Path) -> None:
    example = Example(tmp_path)
    sheet = bar((0, -0.05, 0.0), (0.1, 0.05, thickness))
    write_mesh(tmp_path / "low.ply", sheet.vertices, sheet.faces)
    example.document["object"] |= {"parts": [{"name": "low", "mesh": "low.ply"}], "known": {}}
    line = example.complaint()
    assert 'part "low" is' in line and "m thick" in line and "expected at least 1/1500" in line

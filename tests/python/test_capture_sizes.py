"""Sizes that files claim are looked at before anything of them is unpacked."""

from __future__ import annotations

import io
import itertools
import json
import resource
import struct
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from capture_example import AT, FRAMES, Example
from mphygs.capture.errors import CaptureError
from mphygs.capture.files import read_arrays
from mphygs.capture.images import ImageFile
from mphygs.capture.meshes import read_mesh, write_mesh
from mphygs.scene.object_files import read_features, read_particles
from mphygs.scene.ply import read_gaussians

GIGABYTE = 1 << 30


@pytest.fixture(autouse=True)
def frugal():  # noqa: ANN201
    """Two seconds, and no more memory than a good input takes."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + GIGABYTE, limits[1]))
    began = time.process_time()
    try:
        yield
        assert time.process_time() - began < 2.0
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


def header(descr: str = "'<f8'", shape: str = "(12, 4, 3)", version: int = 1, more: str = "") -> bytes:
    """The header of an .npy that says so, in that version of the format."""
    told = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, {more}}}".encode() + b"\n"
    size = struct.pack("<H" if version == 1 else "<I", len(told))
    return b"\x93NUMPY" + bytes([version, 0]) + size + told


def packed(path: Path, content: bytes, *, zeros: int = 0, name: str = "position.npy", **more: int) -> None:
    """An .npz of one member: content, then so many zeros, in pieces of a megabyte."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        info = zipfile.ZipInfo(name)
        info.compress_type = more.get("compress_type", zipfile.ZIP_DEFLATED)
        with archive.open(info, "w", force_zip64=True) as member:
            member.write(content)
            for _ in range(zeros):
                member.write(bytes(1 << 20))


def claims(path: Path, *, size: int) -> None:
    """Let an .npz say that its first member unpacks to so many bytes."""
    data = bytearray(path.read_bytes())
    at = data.rfind(b"PK\x01\x02")
    data[at + 24 : at + 28] = struct.pack("<I", size)
    path.write_bytes(data)


def encrypted(path: Path) -> None:
    data = bytearray(path.read_bytes())
    for magic, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.find(magic) + offset] |= 1
    path.write_bytes(data)


DATA = np.zeros((FRAMES, len(AT), 3)).tobytes()
# What makes the file, and what is said of it.
ARRAYS: dict[str, tuple[Callable[[Path], object], str]] = {
    "bomb of another shape": (
        lambda p: packed(p, header(shape="(12, 4, 500000)"), zeros=180), "has shape (12, 4, 500000)"
    ),
    "more frames": (lambda p: packed(p, header(shape="(99000000, 4, 3)")), "has 99000000 frames"),
    "more markers": (lambda p: packed(p, header(shape="(12, 99000000, 3)")), "has 99000000 markers"),
    "655 TiB": (lambda p: packed(p, header(shape=f"({10**10}, 3000, 3)")), "has 10000000000 frames"),
    "shape beyond integers": (lambda p: packed(p, header(shape=f"({10**30}, 4, 3)")), "frames; expected 12"),
    "shape of truth values": (lambda p: packed(p, header(shape="(True, 4, 3)") + DATA), "damaged"),
    "negative shape": (lambda p: packed(p, header(shape="(-12, 4, 3)") + DATA), "damaged"),
    "shape of texts": (lambda p: packed(p, header(shape="('12', 4, 3)") + DATA), "damaged"),
    "shape a list": (lambda p: packed(p, header(shape="[12, 4, 3]") + DATA), "damaged"),
    "no shape": (lambda p: packed(p, header(shape="None") + DATA), "damaged"),
    "nested header": (lambda p: packed(p, header(shape="(" * 3000 + ")" * 3000)), "damaged"),
    "code in the header": (lambda p: packed(p, header(shape="exec('1')") + DATA), "damaged"),
    "header of 4 GB": (
        lambda p: packed(p, b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**32 - 1), zeros=1), "damaged"
    ),
    "header of 1 MB": (lambda p: packed(p, header(version=2, more=" " * 10**6) + DATA), "damaged"),
    "header that ends early": (lambda p: packed(p, header()[:40]), "damaged"),
    "no header": (lambda p: packed(p, b"x" * 400), "damaged"),
    "empty member": (lambda p: packed(p, b""), "damaged"),
    "odd type": (lambda p: packed(p, header(descr="'zz'") + DATA), "damaged"),
    "huge type": (lambda p: packed(p, header(descr="'<U100000000'")), "holds <U100000000"),
    "objects": (lambda p: packed(p, header(descr="'|O'") + DATA), "holds Python objects"),
    "record": (lambda p: packed(p, header(descr="[('a', '<f8')]") + DATA), "holds [('a', '<f8')]"),
    "more data than said": (lambda p: packed(p, header() + DATA, zeros=64), "damaged"),
    "less data than said": (lambda p: packed(p, header() + DATA[:-8]), "damaged"),
    "size of another file": (
        lambda p: (packed(p, header() + DATA), claims(p, size=1 << 31)), "truncated"
    ),
    "encrypted": (lambda p: (packed(p, header() + DATA), encrypted(p)), "is encrypted"),
    "another packing": (
        lambda p: packed(p, header() + DATA, compress_type=zipfile.ZIP_LZMA), "is packed by method 14"
    ),
    "wrong sum": (
        lambda p: (packed(p, header() + DATA), p.write_bytes(p.read_bytes().replace(b"PK\1\2", b"PK\1\3"))),
        "truncated",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", ARRAYS)
def test_arrays_of_a_capture(kind: str, tmp_path: Path) -> None:
    make, words = ARRAYS[kind]
    example = Example(tmp_path)
    make(tmp_path / "markers.npz")
    line = example.complaint()
    assert "markers.npz" in line and words in line


@pytest.mark.parametrize("kind", ["header of 4 GB", "nested header", "encrypted", "objects", "empty member"])
def test_the_motion_of_a_hold(kind: str, tmp_path: Path) -> None:
    example = Example(tmp_path)
    ARRAYS[kind][0](tmp_path / "hold.npz")
    assert "hold.npz" in example.complaint()


def test_good_arrays_of_every_version_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    for version in (1, 2, 3):
        packed(path, header(version=version) + DATA)
        assert read_arrays(path, {"position": (FRAMES, 4, 3)})["position"].shape == (FRAMES, 4, 3)
    by_columns = np.asfortranarray(np.arange(24.0).reshape(4, 6))
    np.savez(path, position=by_columns)
    assert np.array_equal(read_arrays(path, {"position": (4, None)})["position"], by_columns)
    np.savez(path, position=np.float32(3.0), text=np.array("a"))
    assert read_arrays(path, {"position": ()}, others=True)["position"] == 3.0


def test_arrays_whose_size_nothing_states_are_not_endless(tmp_path: Path) -> None:
    path, endless = tmp_path / "particles.npz", header(shape="(90000000, 3)")
    for make, read in (
        (lambda: packed(path, endless), read_particles),
        (
            lambda: packed(path, header(shape="(90000000, 3)"), name="appearance.npy"),
            lambda p: read_features(p, 5),
        ),
        (
            lambda: packed(path, header(shape="(90000000, 3)")),
            lambda p: read_arrays(p, {"position": (None, 3)}),
        ),
    ):
        make()
        with pytest.raises(CaptureError, match=r"particles.npz.*(has no|at most 40000000 numbers)"):
            read(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, shape in (
            ("position", (5, 3)),
            ("label", (5,)),
            ("signed_distance", (5,)),
            ("spacing", ()),
        ):
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, np.zeros(shape))
        archive.writestr("appearance.npy", header(shape="(90000000, 9)"))
    with pytest.raises(CaptureError, match="appearance: has shape"):
        read_particles(path)


def test_an_archive_of_very_many_files(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(30_000):
            archive.writestr(f"array-{number:06d}.npy", b"")
    with pytest.raises(CaptureError, match="holds more files than any .npz"):
        read_arrays(path, {"position": (None, 3)})


# ---- pictures ---------------------------------------------------------------------------------
def png(width: int, height: int, *, data: bytes = b"", more: bytes = b"") -> bytes:
    """A PNG that says that it is so large."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        crc = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", crc)

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + more + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def jpeg(width: int, height: int, *, turn: int = 0) -> bytes:
    """A small grey JPEG, brighter to the right and in its upper half; turn: its EXIF mark, 0 for none."""
    image = np.zeros((height, width), np.uint8)
    image[: height // 2, width // 2 :] = 200
    data = cv2.imencode(".jpg", image)[1].tobytes()
    if not turn:
        return data
    exif = b"Exif\0\0II*\0" + struct.pack("<IHHHIII", 8, 1, 0x0112, 3, 1, turn, 0)
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (png(16_000, 16_000, data=zlib.compress(bytes(100))), "is 16000 x 16000 pixels; expected 64 x 64"),
        (png(2**31 - 1, 2**31 - 1), "expected 64 x 64"),
        (png(0, 64), "is no image"),
        (png(64, 64, data=b"no"), "damaged"),
        (png(64, 64)[:30], "damaged"),
        (jpeg(64, 32), "is 64 x 32 pixels"),
        (jpeg(64, 64).replace(b"\x0b\x08\x00\x40\x00\x40", b"\x0b\x08\xff\xff\xff\xff"),
         "is 65535 x 65535 pixels"),
        (jpeg(64, 64)[:100], "is no image"),
        (jpeg(64, 64, turn=6), "is marked to be turned when shown (EXIF orientation 6)"),
        (jpeg(64, 64, turn=3), "EXIF orientation 3"),
        (b"GIF89a" + bytes(50), "is no image"),
        (b"BM" + bytes(80), "is no image"),
        (b"", "is no image"),
    ],
)  # fmt: skip
def test_pictures_by_their_heads(content: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(content)
    with pytest.raises(CaptureError) as caught:
        ImageFile(path).read((64, 64), ", as its camera")
    line = str(caught.value)
    assert line.startswith(str(path)) and words in line and "expected" in line


@pytest.mark.parametrize("turn", range(1, 9))
def test_marks_to_turn_a_picture_are_obeyed_where_sizes_tell(turn: int, tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(jpeg(64, 32, turn=turn))
    if turn in (2, 3, 4):
        with pytest.raises(CaptureError, match=f"orientation {turn}"):
            ImageFile(path).read((64, 32))
        return
    stored = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED) / 255.0
    if turn == 1:
        turned, size = stored, (64, 32)
    else:
        turned, size = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) / 255.0, (32, 64)
    assert np.allclose(ImageFile(path).read((64, 32)).colour[..., 0], stored, atol=0.02)
    assert np.allclose(ImageFile(path).read(size).colour[..., 0], turned, atol=0.02)


def test_a_picture_that_nothing_states_the_size_of(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png(20_000, 20_000))
    with pytest.raises(CaptureError, match="is 20000 x 20000 pixels; expected at most"):
        ImageFile(path).read()
    path.write_bytes(jpeg(8, 6))
    assert ImageFile(path).size() == (8, 6) and ImageFile(path).read().colour.shape == (6, 8, 3)


# ---- meshes and Gaussians ---------------------------------------------------------------------
def zipped(content: bytes, name: str = "3D/3dmodel.model", *, zeros: int = 0) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open(zipfile.ZipInfo(name), "w", force_zip64=True) as member:
            member.write(content)
            for _ in range(zeros):
                member.write(bytes(1 << 20))
    return buffer.getvalue()


def glb(document: object) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return b"glTF" + struct.pack("<III", 2, 20 + len(text), len(text)) + b"JSON" + text


def ply(form: str, count: object) -> bytes:
    """Three numbers, said to be so many points."""
    head = f"ply\nformat {form} 1.0\nelement vertex {count}\n"
    return (head + "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n1 2 3\n").encode()


STL = bytes(80) + struct.pack("<I", 2**32 - 1)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.zip", zipped(b"solid", "a.stl", zeros=2), "is an archive"),
        ("a.stl", zipped(b"solid", "a.stl"), "is an archive"),
        ("a.ply", b"\x1f\x8b\x08" + bytes(90), "is an archive"),
        ("a.bz2", b"BZh9" + bytes(90), "is an archive"),
        ("a.stl", STL, "expected a closed"),
        ("a.glb", glb({"accessors": [{"count": 10**11}]}), "100000000000 numbers"),
        ("a.glb", glb({"accessors": [{"count": "many"}]}), "cannot be read as a mesh"),
        ("a.glb", b"glTF", "cannot be read as a mesh"),
        ("a.gltf", b"[" * 100_000, "cannot be read as a mesh"),
        ("a.ply", ply("binary_little_endian", 10**14), "cannot be read as a mesh"),
        ("a.ply", ply("ascii", 10**14), "expected a closed"),
        ("a.off", b"OFF\n99999999999 99999999999 0\n0 0 0\n", "expected a closed"),
        ("a.obj", b"f 1 2 99999999999\n", "expected a closed"),
    ],
)  # fmt: skip
def test_meshes_that_claim_too_much(name: str, content: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(CaptureError) as caught:
        read_mesh(path)
    assert words in str(caught.value) and str(path) in str(caught.value)


def test_a_zipped_format_says_what_it_unpacks_to(tmp_path: Path) -> None:
    path = tmp_path / "a.3mf"
    path.write_bytes(zipped(b"<model>", zeros=3))
    data = bytearray(path.read_bytes())
    at = data.rfind(b"PK\x01\x02")
    data[at + 24 : at + 28] = struct.pack("<I", 1 << 30)
    path.write_bytes(data)
    with pytest.raises(CaptureError, match="unpacks to 1073741824 bytes"):
        read_mesh(path)
    path.write_bytes(b"PK\x03\x04" + bytes(40))
    with pytest.raises(CaptureError, match="is no zip file"):
        read_mesh(path)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("count", ["1000000000", "99999999999999999999", "9" * 5000])
def test_gaussians_that_claim_too_much(form: str, count: str, tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(ply(form, count))
    with pytest.raises(CaptureError, match=r"truncated|is not vertex"):
        read_gaussians(path)


# ---- several bodies in one mesh ---------------------------------------------------------------
def cube(size: float = 1.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents=[size] * 3)
    mesh.apply_translation(at)
    return mesh


def turned_inward(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


@pytest.mark.parametrize("kind", ["ply", "stl", "obj", "off"])
@pytest.mark.parametrize(
    ("meshes", "found"),
    [
        ([cube(), cube()], "stand there twice"),
        ([cube(), cube(), cube(at=(3, 0, 0))], "stand there twice"),
        ([cube(), cube(0.5)], "is turned outward inside another one"),
        ([cube(), cube(0.5, (0.1, 0, 0)), cube(at=(4, 0, 0))], "is turned outward inside another one"),
        ([cube(), turned_inward(cube(0.5))], 1 - 0.125),
        ([cube(), cube(at=(3, 0, 0))], 2.0),
        ([cube(), cube(at=(1, 0, 0))], 2.0),
        ([cube(), turned_inward(cube(at=(3, 0, 0)))], 2.0),
        ([turned_inward(cube())], 1.0),
        ([cube(), turned_inward(cube(0.5)), cube(0.2)], 1 - 0.125 + 0.008),
    ],
)
def test_bodies_in_one_file(
    meshes: list[trimesh.Trimesh], found: float | str, kind: str, tmp_path: Path
) -> None:
    path = tmp_path / f"m.{kind}"
    path.write_bytes(_exported(trimesh.util.concatenate(meshes), kind))
    if isinstance(found, str):
        with pytest.raises(CaptureError, match=found):
            read_mesh(path)
    else:
        vertices, faces = read_mesh(path)
        assert trimesh.Trimesh(vertices, faces, process=False).volume == pytest.approx(found, rel=1e-5)


def test_slivers_are_no_triangles_twice(tmp_path: Path) -> None:
    mesh = cube()
    vertices, faces = np.array(mesh.vertices), [tuple(face) for face in mesh.faces.tolist()]
    a, b, c = faces.pop()
    d = next(int(v) for f in faces if {a, b} < set(f) for v in f if v not in (a, b))
    faces = [f for f in faces if not {a, b, d} <= set(f)]
    # three corners close together on the edge: two slivers beside it are the same to five digits
    shares = np.array([0.5, 0.5 + 1e-9, 0.5 + 2e-9])[:, None]
    chain = [a, len(vertices), len(vertices) + 1, len(vertices) + 2, b]
    vertices = np.concatenate([vertices, vertices[a] * (1.0 - shares) + vertices[b] * shares])
    for k, m in itertools.pairwise(chain):
        faces += [(k, m, c), (m, k, d)]
    write_mesh(tmp_path / "m.ply", vertices, np.array(faces))
    vertices, faces = read_mesh(tmp_path / "m.ply")
    assert trimesh.Trimesh(vertices, faces, process=False).volume == pytest.approx(1.0)


def _exported(mesh: trimesh.Trimesh, kind: str) -> bytes:
    content = mesh.export(file_type=kind)
    return content.encode() if isinstance(content, str) else content


@pytest.mark.parametrize("end", ["endsolid", "endsolid one", "end solid", "  end solid one", "END SOLID"])
def test_bodies_that_end_without_a_name(end: str, tmp_path: Path) -> None:
    text = "\n".join(
        cube(at=at).export(file_type="stl_ascii").rsplit("endsolid", 1)[0] + end
        for at in ((0, 0, 0), (3, 0, 0))
    )
    path = tmp_path / "m.stl"
    path.write_text((text.upper() if end.isupper() else text) + "\n")
    vertices, faces = read_mesh(path)
    assert trimesh.Trimesh(vertices, faces, process=False).volume == pytest.approx(2.0)

"""Gaussians in and out of .ply, with the names, order and encodings of the original."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from gaussian_example import gaussians
from mphygs.capture.errors import CaptureError
from mphygs.scene.ply import read_gaussians, write_gaussians


@pytest.mark.parametrize(("degree", "features"), [(0, 0), (1, 2), (2, 0), (3, 5)])
def test_written_gaussians_come_back(tmp_path: Path, degree: int, features: int) -> None:
    written = gaussians(20, degree=degree, features=features)
    write_gaussians(tmp_path / "a.ply", written)
    for have, want in zip(read_gaussians(tmp_path / "a.ply").tensors(), written.tensors(), strict=True):
        assert have.dtype == torch.float32
        torch.testing.assert_close(have, want.float(), atol=2e-6, rtol=1e-5)


def test_names_order_and_encodings(tmp_path: Path) -> None:
    one = gaussians(1, degree=1, features=0)
    write_gaussians(tmp_path / "a.ply", one)
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    lines = header.decode().split("\n")
    assert lines[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 1"]
    names = [line.removeprefix("property float ") for line in lines[3:-1]]
    assert names == [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
        *(f"f_rest_{k}" for k in range(9)),
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]
    row = dict(zip(names, np.frombuffer(body, "<f4"), strict=True))
    # f_rest: the three coefficients of red, then those of green, then those of blue
    assert row["f_rest_1"] == pytest.approx(one.harmonics[0, 2, 0].item())
    assert row["f_rest_3"] == pytest.approx(one.harmonics[0, 1, 1].item())
    assert row["f_dc_2"] == pytest.approx(one.harmonics[0, 0, 2].item())
    assert row["opacity"] == pytest.approx(torch.logit(one.opacities[0]).item(), rel=1e-5)
    assert row["scale_1"] == pytest.approx(one.scales[0, 1].log().item(), rel=1e-5)
    assert row["rot_0"] == pytest.approx(one.rotations[0, 0].item())


def test_opaque_ones_can_be_written(tmp_path: Path) -> None:
    solid = gaussians(2).each(lambda tensor: torch.ones_like(tensor))
    write_gaussians(tmp_path / "a.ply", solid)
    torch.testing.assert_close(read_gaussians(tmp_path / "a.ply").opacities, torch.ones(2), atol=2e-6, rtol=0)


HEADER = """ply
format {format} 1.0
comment made elsewhere
element vertex 2
""" + "".join(
    f"property {kind} {name}\n"
    for kind, name in [
        *(("double", name) for name in ("x", "y", "z")),
        *(("float", name) for name in ("f_dc_0", "f_dc_1", "f_dc_2", "opacity")),
        *(("float", f"scale_{k}") for k in range(3)),
        *(("float", f"rot_{k}") for k in range(4)),
        ("uchar", "label"),
    ]
)
ROWS = [(*(0.1, 0.2, 0.3), *(1, 2, 3, 0), *(-3, -4, -5), *(1, 0, 0, 0), 7), (0,) * 10 + (0, 1, 0, 0, 9)]
KIND = [("", "{}f8")] * 3 + [("", "{}f4")] * 11 + [("", "u1")]


def packed(order: str) -> bytes:
    kind = np.dtype([(f"c{k}", form.format(order)) for k, (_, form) in enumerate(KIND)])
    return np.array(ROWS, dtype=kind).tobytes()


@pytest.mark.parametrize(
    ("form", "body"),
    [
        ("binary_little_endian", packed("<")),
        ("binary_big_endian", packed(">")),
        ("ascii", "\n".join(" ".join(map(str, row)) for row in ROWS).encode()),
    ],
)
def test_other_encodings_types_and_properties(tmp_path: Path, form: str, body: bytes) -> None:
    faces = "element face 1\nproperty list uchar int vertex_indices\n"
    (tmp_path / "a.ply").write_bytes((HEADER.format(format=form) + faces + "end_header\n").encode() + body)
    read = read_gaussians(tmp_path / "a.ply")
    torch.testing.assert_close(read.positions[0], torch.tensor([0.1, 0.2, 0.3]))
    torch.testing.assert_close(read.scales[0].log(), torch.tensor([-3.0, -4.0, -5.0]))
    torch.testing.assert_close(read.opacities, torch.tensor([0.5, 0.5]))
    assert read.rotations[1].tolist() == [0, 1, 0, 0] and read.harmonics[0, 0].tolist() == [1, 2, 3]


def text(old: str, new: str) -> bytes:
    assert old in HEADER
    header = HEADER.replace(old, new).format(format="binary_little_endian") + "end_header\n"
    return header.encode() + packed("<")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is not a .ply file"),
        (b"solid stl", "is not a .ply file"),
        (b"ply\nformat ascii 1.0\n", "is not a .ply file"),
        (text("format {format}", "format zip"), "has no known format line"),
        (text("element vertex", "element face"), "its first element is not vertex"),
        (text("vertex 2", "vertex 3"), "is truncated after 2 Gaussians; expected 3"),
        (text("property float opacity", "property float alpha"), 'has no property "opacity"'),
        (text("property uchar label", "property list uchar int label"), "cannot use"),
        (text("property uchar label", "property uchar x"), "has a property twice"),
        (text("property float f_dc_2", "property float f_rest_0"), "has 1 properties f_rest_*"),
        (text("", "")[:-29] + np.full(7, np.nan, "<f4").tobytes() + b"0", "is not finite in Gaussian 1"),
        (text("", "")[:-17] + bytes(17), "Gaussian 1 has a zero quaternion"),
    ],
)
def test_files_that_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(CaptureError) as caught:
        read_gaussians(tmp_path / "a.ply")
    line = str(caught.value)
    assert message in line and "expected" in line and str(tmp_path) in line and "\n" not in line


def test_a_file_of_none_is_refused(tmp_path: Path) -> None:
    write_gaussians(tmp_path / "a.ply", gaussians(3))
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(data.replace(b"vertex 3", b"vertex 0"))
    with pytest.raises(CaptureError, match="holds no Gaussian"):
        read_gaussians(tmp_path / "a.ply")

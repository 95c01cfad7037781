"""Gaussians in the .ply of 3D Gaussian splatting, as its original code writes them.

Opacities are stored as logits, scales as logarithms, quaternions wxyz; colour coefficients as f_dc_0..2 and
f_rest_*, the latter all of red first, then green, then blue. Features are added as feature_*.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from mphygs.capture.checks import SIZE
from mphygs.capture.errors import fault
from mphygs.capture.written import replace_file
from mphygs.scene.gaussians import HARMONIC_COUNTS, Gaussians

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
_EXPECTED = "a .ply of 3D Gaussian splatting"
_LONGEST_HEADER, _LARGEST = 100_000, 1_000_000_000  # bytes
MOST = (0.05, 0.95)  # of the Gaussians along each axis: a few always fly about
_LOGIT_LIMIT = 1e-6  # from 0 and 1, where the logit has no value


def read_gaussians(path: Path, scale: float = 1.0) -> Gaussians:
    """The Gaussians (float32) in the .ply at `path`; properties that are not Gaussians' own are passed over.

    scale: metres per unit of the file. Raises CaptureError, one line, where the file is no such .ply, is
    truncated, holds numbers that are not finite, or an object of no sensible size.
    """
    table = _read_vertices(path)
    if not len(table):
        raise fault(str(path), "holds no Gaussian", _EXPECTED)
    names = table.dtype.names or ()

    def columns(*wanted: str) -> np.ndarray:
        for name in wanted:
            if name not in names:
                raise fault(str(path), f'has no property "{name}"', _EXPECTED)
        if not wanted:
            return np.zeros((len(table), 0), dtype=np.float32)
        values = np.stack([table[name] for name in wanted], axis=1).astype(np.float32)
        if not np.isfinite(values).all():
            row, column = np.argwhere(~np.isfinite(values))[0]
            raise fault(f"{path}: {wanted[column]}", f"is not finite in Gaussian {row}", "numbers")
        return values

    def numbered(stem: str, count: int) -> list[str]:
        return [f"{stem}_{index}" for index in range(count)]

    rest_count = sum(name.startswith("f_rest_") for name in names)
    if rest_count % 3 or rest_count // 3 + 1 not in HARMONIC_COUNTS:
        raise fault(str(path), f"has {rest_count} properties f_rest_*", "0, 9, 24 or 45")
    constant = columns(*numbered("f_dc", 3))[:, None, :]
    rest = columns(*numbered("f_rest", rest_count)).reshape(len(table), 3, -1).transpose(0, 2, 1)
    feature_count = sum(name.startswith("feature_") for name in names)
    rotations = columns(*numbered("rot", 4))
    lengths = np.linalg.norm(rotations, axis=1)
    if not (lengths > 0).all():
        raise fault(
            f"{path}: rot_0", f"Gaussian {int(np.argmin(lengths))} has a zero quaternion", "w, x, y, z"
        )
    with np.errstate(over="ignore"):
        scales = np.exp(columns(*numbered("scale", 3)))
        opacities = 1 / (1 + np.exp(-columns("opacity")[:, 0]))
        scales = scales * np.float32(scale)
        places = columns("x", "y", "z") * np.float32(scale)
    if not np.isfinite(scales).all():
        raise fault(f"{path}: scale_0", "is too large", "logarithms of scales [m]")
    _check_size(path, places, scales)
    arrays = (
        places,
        rotations,
        scales,
        opacities,
        np.concatenate([constant, rest], axis=1),
        columns(*numbered("feature", feature_count)),
    )
    return Gaussians(*(torch.from_numpy(np.ascontiguousarray(array)) for array in arrays))


def _check_size(path: Path, places: np.ndarray, scales: np.ndarray) -> None:
    """Raises CaptureError where most of the Gaussians, at places (N, 3) and of scales (N, 3) [m], make an
    object as large as none is."""
    with np.errstate(over="ignore"):
        apart = np.linalg.norm(np.ptp(np.quantile(places.astype(float), MOST, axis=0), axis=0))
        size = float(apart + np.median(scales.max(axis=1).astype(float)))
    if not SIZE[0] <= size <= SIZE[1]:
        what = f"its Gaussians make an object of {size:.3g} m"
        expected = f"{SIZE[0]:g} to {SIZE[1]:g} m; state scale, metres per unit of the file"
        raise fault(str(path), what, expected)


def write_gaussians(path: Path, gaussians: Gaussians) -> None:
    """Write `gaussians` as a binary little-endian .ply that 3DGS viewers open.

    Opacities of exactly 0 or 1 are written as 1e-6 from there.
    """
    arrays = [tensor.detach().to(torch.float64).numpy() for tensor in gaussians.tensors()]
    positions, rotations, scales, opacities, harmonics, features = arrays
    rest = harmonics[:, 1:].transpose(0, 2, 1).reshape(len(positions), -1)
    held = np.clip(opacities, _LOGIT_LIMIT, 1 - _LOGIT_LIMIT)
    columns = {
        **dict(zip(("x", "y", "z"), positions.T, strict=True)),
        **dict.fromkeys(("nx", "ny", "nz"), np.zeros(len(positions))),
        **{f"f_dc_{index}": harmonics[:, 0, index] for index in range(3)},
        **{f"f_rest_{index}": column for index, column in enumerate(rest.T)},
        "opacity": np.log(held / (1 - held)),
        **{f"scale_{index}": column for index, column in enumerate(np.log(np.maximum(scales, 1e-30)).T)},
        **{f"rot_{index}": column for index, column in enumerate(rotations.T)},
        **{f"feature_{index}": column for index, column in enumerate(features.T)},
    }
    table = np.empty(len(positions), dtype=[(name, "<f4") for name in columns])
    for name, column in columns.items():
        table[name] = column
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    header += [f"property float {name}" for name in columns] + ["end_header", ""]
    replace_file(path, "\n".join(header).encode("ascii") + table.tobytes())


def _read_vertices(path: Path) -> np.ndarray:
    """The rows of the first element, which must be `vertex`, as a structured array."""
    try:
        if path.stat().st_size > _LARGEST:
            raise fault(str(path), f"has more than {_LARGEST} bytes", _EXPECTED)
        data = path.read_bytes()
    except OSError as error:
        raise fault(str(path), f"cannot be read ({error.strerror})", _EXPECTED) from error
    end = data.find(b"end_header", 0, _LONGEST_HEADER)
    newline = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0 or newline < 0:
        raise fault(str(path), "is not a .ply file", _EXPECTED)
    try:
        lines = [line.split() for line in data[:end].decode("ascii").splitlines()]
    except UnicodeDecodeError as error:
        raise fault(str(path), "has a header that is not ASCII", _EXPECTED) from error
    words = [line for line in lines if line and line[0] in ("format", "element", "property")]
    elements = [index for index, line in enumerate(words) if line[0] == "element"]
    first = words[elements[0]] if elements else []
    if not words or words[0][0] != "format" or words[0][1:2] == [] or words[0][1] not in _ORDERS:
        raise fault(str(path), "has no known format line", f"one of {', '.join(_ORDERS)}")
    if len(first) != 3 or first[1] != "vertex" or not first[2].isdigit() or len(first[2]) > 12:
        raise fault(str(path), "its first element is not vertex", _EXPECTED)
    stop = elements[1] if len(elements) > 1 else len(words)
    fields = []
    for line in words[elements[0] + 1 : stop]:
        if len(line) != 3 or line[1] not in _TYPES:
            raise fault(str(path), f'cannot use "{" ".join(line)}"', "properties of one number each")
        fields.append((line[2], _ORDERS[words[0][1]] + _TYPES[line[1]]))
    if len({name for name, _ in fields}) < len(fields):
        raise fault(str(path), "has a property twice", "every property once")
    count, body = int(first[2]), data[newline + 1 :]
    if count * len(fields) > len(body):
        raise fault(str(path), f"is truncated: it says that it holds {count} Gaussians", _EXPECTED)
    if words[0][1] == "ascii":
        try:
            numbers = np.array(body.split(None, count * len(fields))[: count * len(fields)], dtype=np.float64)
            rows = numbers.reshape(count, len(fields))
        except ValueError as error:
            raise fault(str(path), "is truncated or holds what is no number", _EXPECTED) from error
        return np.rec.fromarrays(list(rows.T), names=[name for name, _ in fields])
    kind = np.dtype(fields)
    if len(body) < count * kind.itemsize:
        whole = len(body) // max(kind.itemsize, 1)
        raise fault(str(path), f"is truncated after {whole} Gaussians", f"{count}, as its header says")
    return np.frombuffer(body, dtype=kind, count=count)

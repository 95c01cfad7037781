"""Arrays of an .npz. Their sizes are known from its headers before anything of them is unpacked."""

from __future__ import annotations

import ast
import math
import struct
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mphygs.capture.errors import CaptureError, fault

MOST_NUMBERS = 40_000_000  # of all arrays of one file whose sizes nothing else states
_LARGEST_DIRECTORY = 1 << 20  # bytes: tens of thousands of arrays
_LONGEST_HEADER = 10_000  # bytes
_DAMAGED = (
    ValueError, OSError, EOFError, KeyError, NotImplementedError, RuntimeError, zipfile.BadZipFile,
    zlib.error, struct.error,
)  # fmt: skip


@dataclass(frozen=True)
class Head:
    """What an array's header says. start: bytes before its numbers."""

    dtype: np.dtype
    shape: tuple[int, ...]
    by_columns: bool
    start: int

    @property
    def size(self) -> int:
        """Bytes of its numbers."""
        return math.prod(self.shape) * self.dtype.itemsize


class Archive:
    """The arrays of an open .npz. names: in its order."""

    def __init__(self, path: Path, stream: zipfile.ZipFile) -> None:
        self._path, self._stream = path, stream
        self._members = {info.filename.removesuffix(".npy"): info for info in stream.infolist()}
        self.names = tuple(self._members)
        self._numbers = 0

    def head(self, name: str) -> Head:
        """What the header of an array says. Raises CaptureError where it is none, or not to be read."""
        where, expected = f"{self._path}: {name}", "an array of numbers"
        info = self._members[name]
        if info.flag_bits & 1:
            raise fault(where, "is encrypted", expected)
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise fault(where, f"is packed by method {info.compress_type}", "as numpy.savez packs it")
        try:
            with self._stream.open(info) as member:
                head = _read_head(member.read(_LONGEST_HEADER + 12))
        except _DAMAGED as error:
            raise fault(where, "is truncated or damaged", expected) from error
        if head.dtype.hasobject:
            raise fault(where, "holds Python objects, which are not read", expected)
        return head

    def read(self, name: str, *, stated: bool = False) -> np.ndarray:
        """An array. stated: its size is known to be as it should be; others may not be larger than what is
        read of a file. Raises CaptureError where it is, or is damaged."""
        where, head, info = f"{self._path}: {name}", self.head(name), self._members[name]
        if not stated:
            self._numbers += max(math.prod(head.shape), head.size // 8)
        if self._numbers > MOST_NUMBERS:
            raise fault(where, f"has shape {head.shape}", f"at most {MOST_NUMBERS} numbers in a file")
        try:
            if info.file_size != head.start + head.size:
                raise ValueError("its sizes do not agree")
            with self._stream.open(info) as member:
                member.read(head.start)
                content = member.read(head.size)
                if len(content) != head.size or member.read(1):
                    raise ValueError("its sizes do not agree")
        except _DAMAGED as error:
            raise fault(where, "is truncated or damaged", "an array of numbers") from error
        array = np.frombuffer(content, dtype=head.dtype)
        return array.reshape(head.shape, order="F" if head.by_columns else "C")


@contextmanager
def open_archive(path: Path, expected: str) -> Iterator[Archive]:
    """The arrays of the .npz at `path`. Raises CaptureError, saying what was expected, where it is none."""
    try:
        stream = path.open("rb")
    except OSError as error:
        raise fault(str(path), f"cannot be read ({error.strerror})", expected) from error
    with stream:
        if stream.read(6) == b"\x93NUMPY":
            raise fault(str(path), "is a single array, and so is not an .npz file", expected)
        try:
            if _directory_size(stream) > _LARGEST_DIRECTORY:
                raise fault(str(path), "holds more files than any .npz", expected)
            archive = zipfile.ZipFile(stream)
        except CaptureError:
            raise
        except _DAMAGED as error:
            raise fault(str(path), "is not an .npz file, or is truncated", expected) from error
        with archive:
            yield Archive(path, archive)


def _directory_size(stream) -> int:  # noqa: ANN001 (a binary file)
    """Bytes of a zip file's list of contents, by the record at its end."""
    stream.seek(0, 2)
    stream.seek(max(0, stream.tell() - 65_557))
    tail = stream.read()
    at = tail.rfind(b"PK\x05\x06")
    return struct.unpack_from("<I", tail, at + 12)[0] if 0 <= at <= len(tail) - 22 else 0


def _read_head(content: bytes) -> Head:
    """The header of an .npy, whose beginning is given. Raises ValueError where it is none."""
    if content[:6] != b"\x93NUMPY" or len(content) < 12:
        raise ValueError("no .npy")
    wide = content[6] > 1
    start = 12 if wide else 10
    length = struct.unpack_from("<I" if wide else "<H", content, 8)[0]
    if length > _LONGEST_HEADER or start + length > len(content):
        raise ValueError("a header that is too long, or ends early")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            told = ast.literal_eval(content[start : start + length].decode("utf-8").strip())
            dtype = np.dtype(told["descr"])
        except (SyntaxError, TypeError, MemoryError, RecursionError) as error:
            raise ValueError("no header") from error
    shape, by_columns = told["shape"], told["fortran_order"]
    if not isinstance(shape, tuple) or not isinstance(by_columns, bool):
        raise ValueError("no shape")
    if not all(type(count) is int and count >= 0 for count in shape):
        raise ValueError("a shape that is none")
    return Head(dtype, shape, by_columns, start + length)

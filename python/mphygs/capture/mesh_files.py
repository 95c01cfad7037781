"""What is looked at in a mesh file before its reader unpacks it."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from pathlib import Path

from mphygs.capture.errors import CaptureError, fault

MOST_BYTES = 1 << 29  # of a file, and of what is packed in one
_ARCHIVES = (b"PK\x03\x04", b"PK\x05\x06", b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"7z\xbc\xaf", b"Rar!")
# Formats that are zip files by their nature.
_ZIPPED = (".3mf",)
_GLTF = (".glb", ".gltf")


def mesh_content(path: Path, expected: str) -> bytes:
    """The content of a mesh file, as its reader takes it.

    Raises CaptureError for an archive where the format is none, and for a file that has, or says that it
    unpacks to, more than MOST_BYTES.
    """
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise fault(str(path), f"has {size} bytes", f"{expected} of at most {MOST_BYTES}")
        content = path.read_bytes()
    except OSError as error:
        raise fault(str(path), f"cannot be read ({error.strerror})", expected) from error
    kind = path.suffix.lower()
    if content.startswith(_ARCHIVES):
        if kind not in _ZIPPED:
            raise fault(str(path), "is an archive", f"{expected}, unpacked")
        _check_zipped(path, content, expected)
    if kind in _GLTF:
        _check_gltf(path, content, expected)
    if kind == ".stl" and content.lstrip()[:5].lower() == b"solid":
        # as some programs end a body
        content = re.sub(rb"(?mi)^(\s*)end\s+solid\b", rb"\1endsolid", content)
    return content


def _check_zipped(path: Path, content: bytes, expected: str) -> None:
    try:
        members = zipfile.ZipFile(io.BytesIO(content)).infolist()
    except (ValueError, OSError, EOFError, NotImplementedError, zipfile.BadZipFile, struct.error) as error:
        raise fault(str(path), "is no zip file, or is truncated", expected) from error
    # no more is unpacked than is said here
    unpacked = sum(info.file_size for info in members)
    if unpacked > MOST_BYTES:
        raise fault(str(path), f"unpacks to {unpacked} bytes", f"{expected} of at most {MOST_BYTES}")
    for info in members:
        if info.flag_bits & 1:
            raise fault(str(path), "is encrypted", expected)


def _check_gltf(path: Path, content: bytes, expected: str) -> None:
    """Arrays that say that they hold more than the file does."""
    text = content
    if content[:4] == b"glTF":
        text = content[20 : 20 + struct.unpack_from("<I", content.ljust(16, b"\0"), 12)[0]]
    try:
        told = json.loads(text)
        counts = [int(accessor["count"]) for accessor in told.get("accessors", ())]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise fault(str(path), "cannot be read as a mesh, or is truncated", expected) from error
    if any(not 0 <= count <= len(content) for count in counts):
        raise CaptureError(f"{path}: says that it holds {max(counts)} numbers; expected {expected}")

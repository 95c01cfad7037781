"""What the head of a PNG or a JPEG says of its picture, before anything of it is unpacked."""

from __future__ import annotations

import struct
from dataclasses import dataclass

_PNG = b"\x89PNG\r\n\x1a\n"
# Segments of a JPEG that begin a picture; the other markers between are tables.
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_ORIENTATION = 0x0112


@dataclass(frozen=True)
class PictureHead:
    """width, height: of the pixels as they are stored [px]; turn: EXIF's mark of how to show them, 1 to 8."""

    width: int
    height: int
    turn: int = 1

    @property
    def shown(self) -> tuple[int, int]:
        """Width and height as the mark says to show it [px]."""
        return (self.height, self.width) if self.turn >= 5 else (self.width, self.height)


def picture_head(data: bytes) -> PictureHead | None:
    """The head of a PNG or JPEG; None for anything else, and where it ends early."""
    try:
        if data.startswith(_PNG):
            return _png(data)
        return _jpeg(data) if data.startswith(b"\xff\xd8") else None
    except (struct.error, IndexError):
        return None


def _png(data: bytes) -> PictureHead | None:
    if data[12:16] != b"IHDR":
        return None
    width, height = struct.unpack_from(">II", data, 16)
    at, turn = 8, 1
    while at + 8 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind = data[at + 4 : at + 8]
        if kind == b"eXIf":
            turn = _turn(data[at + 8 : at + 8 + length])
        if kind == b"IDAT":
            break
        at += 12 + length
    return PictureHead(width, height, turn)


def _jpeg(data: bytes) -> PictureHead | None:
    at, turn = 2, 1
    while True:
        while data[at] == 0xFF and data[at + 1] == 0xFF:  # fill bytes
            at += 1
        if data[at] != 0xFF:
            return None
        marker, length = data[at + 1], struct.unpack_from(">H", data, at + 2)[0]
        if marker in _FRAMES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return PictureHead(width, height, turn)
        if marker == 0xE1 and data[at + 4 : at + 10] == b"Exif\0\0":
            turn = _turn(data[at + 10 : at + 2 + length])
        at += 2 + length


def _turn(exif: bytes) -> int:
    """The mark in an EXIF block's first directory; 1 where there is none."""
    order = {b"II": "<", b"MM": ">"}.get(exif[:2])
    if order is None:
        return 1
    try:
        at = struct.unpack_from(order + "I", exif, 4)[0]
        for k in range(struct.unpack_from(order + "H", exif, at)[0]):
            tag, kind, _, value = struct.unpack_from(order + "HHIH", exif, at + 2 + 12 * k)
            if tag == _ORIENTATION and kind == 3:
                return value if 1 <= value <= 8 else 1
    except struct.error:
        pass
    return 1

"""One picture that a camera file speaks of: which camera, which frame, which files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mphygs.capture.cameras import Camera


@dataclass(frozen=True, eq=False)
class Shot:
    """camera: as it stood for this picture; image: an image or a video; mask: given for this picture alone;
    frame: index in the sequence, None where none is given; where: file and key it was read from."""

    camera: Camera
    image: Path
    mask: Path | None
    frame: int | None
    where: str

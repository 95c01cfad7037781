"""How a flower is recorded: pictures, cameras, frames, and how finely its truth is computed."""

from __future__ import annotations

from dataclasses import dataclass

LEAST = {"size": 16, "rest_views": 3, "cameras": 2, "frames": 8, "tracks": 20}


@dataclass(frozen=True)
class Shoot:
    """size: of the square pictures [px]; rest_views, cameras: how many; frames: of each of the two motions;
    tracks: number of true tracks; noise: of the pictures, standard deviation of a range of 1; spacing_share:
    of the grid of the truth over the default spacing of a fit.

    Raises ValueError for numbers with which nothing can be recorded."""

    size: int = 256
    rest_views: int = 32
    cameras: int = 5
    frames: int = 100
    tracks: int = 200
    noise: float = 0.0
    spacing_share: float = 0.62

    def __post_init__(self) -> None:
        for name, least in LEAST.items():
            if getattr(self, name) < least:
                raise ValueError(f"{name} {getattr(self, name)}: expected {least} or more")
        if not 0.0 <= self.noise <= 0.5:
            raise ValueError(f"noise {self.noise}: expected 0 to 0.5")
        if not 0.3 <= self.spacing_share <= 2.0:
            raise ValueError(f"spacing_share {self.spacing_share}: expected 0.3 to 2")

    @property
    def picture_count(self) -> int:
        """Of both motions and of the flower at rest."""
        return self.rest_views + 2 * self.cameras * self.frames

"""Video beside rendering for a page: single frames as small pictures."""

from __future__ import annotations

import base64
from dataclasses import dataclass, field

import cv2
import numpy as np

from mphygs.compare.image_errors import ComparedFrame

# Bytes of all pictures of a page, those of one sequence at most, and the quality they begin with.
BUDGET, QUALITY, LOWEST = 1_000_000, 70, 30
# Larger pictures are shown this wide [px].
WIDEST = 480


@dataclass(eq=False)
class Filmed:
    """What the first camera saw of a sequence and what is predicted for it, frame by frame."""

    fit: tuple[int, int]
    frames: list[int] = field(default_factory=list)
    photographs: list[np.ndarray] = field(default_factory=list)
    drawn: list[np.ndarray] = field(default_factory=list)

    def add(self, shown: ComparedFrame) -> None:
        """One frame more."""
        photograph = shown.photographs[0]
        self.frames.append(shown.frame)
        self.photographs.append(_pixels(photograph.colour * photograph.mask[..., None]))
        self.drawn.append(_pixels(shown.pictures[0].colour.detach().numpy()))

    def document(self, identifier: str, budget: int) -> dict[str, object]:
        """For the page, within a budget [bytes]: by poorer pictures first, then by fewer frames."""
        chosen, quality = list(range(len(self.frames))), QUALITY
        while True:
            pairs = [(_packed(self.photographs[k], quality), _packed(self.drawn[k], quality)) for k in chosen]
            if sum(len(a) + len(b) for a, b in pairs) <= budget or len(chosen) < 3:
                break
            if quality > LOWEST:
                quality -= 20
            else:
                chosen = chosen[::2]
        return {
            "id": identifier,
            "frames": [self.frames[k] for k in chosen],
            "fitted": [self.fit[0] <= self.frames[k] < self.fit[1] for k in chosen],
            "seen": [a for a, _ in pairs],
            "drawn": [b for _, b in pairs],
        }


def _pixels(colour: np.ndarray) -> np.ndarray:
    """(h, w, 3) of 0 to 1 as BGR bytes, no wider than WIDEST."""
    pixels = np.round(255 * np.clip(np.asarray(colour, float), 0, 1)).astype(np.uint8)[..., ::-1]
    share = WIDEST / pixels.shape[1]
    if share < 1.0:
        pixels = cv2.resize(pixels, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(pixels)


def _packed(pixels: np.ndarray, quality: int) -> str:
    """A picture as a data address."""
    content = cv2.imencode(".webp", pixels, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()
    return "data:image/webp;base64," + base64.b64encode(content).decode("ascii")


def wipe(identifier: str, name: str) -> str:
    """The place of a video beside its rendering. name: of the sequence, escaped."""
    return f"""<div class="film" id="{identifier}"><h3>{name}</h3>
<div class="wipe"><img alt="video"><img alt="rendering"><div class="edge"></div></div>
<div class="controls">
<label>video | rendering <input data-role="edge" type="range" min="0" max="100" value="50"></label>
<label>frame <input data-role="time" type="range" min="0" value="0"></label>
<span data-role="label"></span></div></div>"""

"""What blades and centres of most species have alike."""

from __future__ import annotations

from mphygs.synth.flower.blade import Outline
from mphygs.synth.flower.paint import RoundPaint
from mphygs.synth.flower.species import GREEN


def leaf(length: float = 0.032, half_width: float = 0.008, **changes: object) -> Outline:
    usual: dict[str, object] = {
        "widths": (0.3, 0.75, 1.0, 0.85, 0.5, 0.12), "rise": (40.0, 25.0, 0.0, -25.0), "thickness": 0.0022,
        "cup": 0.002, "rounding": 0.1,
    }  # fmt: skip
    return Outline(length, half_width, **(usual | changes))


def petal(length: float, half_width: float, rise: tuple[float, ...], **changes: object) -> Outline:
    usual: dict[str, object] = {
        "widths": (0.35, 0.7, 0.95, 1.0, 0.8), "thickness": 0.0020, "cup": 0.002, "rounding": 0.22,
    }  # fmt: skip
    return Outline(length, half_width, rise=rise, **(usual | changes))


def centre(colour: tuple[float, float, float], *, florets: bool = True) -> RoundPaint:
    return RoundPaint(GREEN, colour, border=0.45, florets=florets)

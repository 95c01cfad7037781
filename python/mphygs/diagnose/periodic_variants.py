"""What swings or acts in pulses: the swings and the sudden beginnings that a misfit shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mphygs.compare.masked_means import mean_seen
from mphygs.diagnose.effect_variants import EffectVariant, absent_effects, strength_variant, swing_variant
from mphygs.diagnose.leading_frequencies import swing_frequencies
from mphygs.model.belief import Belief
from mphygs.model.descriptor import EffectSpec

FREQUENCIES = 2
# Periods in the frames that are too few for the misfit's spectrum to show.
SLOW = (0.7, 1.4)
# Moments at which the misfit may begin, and by how much its variance rises there; nearer to an end, in
# frames, none is told from noise.
RISES, RISE, NEAR_AN_END = 2, 3.0, 3
# Widths of a pulse, in periods of the swing that it leaves: a shorter one acts as the shortest does. Its
# misfit is seen when about so much of it is over.
PULSE_WIDTHS, SEEN_AT = (0.15, 0.4, 1.0), 0.33


def sudden_beginnings(residual: np.ndarray, count: int) -> list[int]:
    """Frames at which the misfit's variance rises most, by binary segmentation (Scott & Knott 1974) with the
    likelihood of normal numbers. residual: (T, M, 3)."""
    power = mean_seen(residual**2, (1, 2))
    seen = np.flatnonzero(np.isfinite(power))
    power = power[seen]
    found: list[int] = []
    stretches = [(0, len(power))]
    while len(found) < count:
        splits = [split for stretch in stretches if (split := _split(power, *stretch))]
        if not splits:
            break
        _gain, k, stretch = max(splits)
        found.append(int(seen[k]))
        stretches.remove(stretch)
        stretches += [(stretch[0], k), (k, stretch[1])]
    return found


def _split(power: np.ndarray, first: int, last: int) -> tuple[float, int, tuple[int, int]] | None:
    """Where a stretch of frames falls best into a quieter one and a louder one: gain of log likelihood, first
    frame of the louder, stretch."""
    sums = np.r_[0.0, np.cumsum(power[first:last])]
    count = last - first
    k = np.arange(NEAR_AN_END, count - NEAR_AN_END + 1)
    if not len(k):
        return None
    before, after = sums[k] / k, (sums[-1] - sums[k]) / (count - k)
    rising = (before > 0.0) & (after > RISE * before)
    if not rising.any():
        return None
    k, before, after = k[rising], before[rising], after[rising]
    gain = count * np.log(sums[-1] / count) - k * np.log(before) - (count - k) * np.log(after)
    best = int(gain.argmax())
    return float(gain[best]), first + int(k[best]), (first, last)


def pulse_variants(
    belief: Belief, spec: EffectSpec, shown_from: Sequence[float], period: float
) -> list[EffectVariant]:
    """Pulses, each half a sine, of a few widths.

    shown_from: when their misfits begin to show [s]; period: of the swing that they leave [s].
    """
    (frequency,), (phase,), (pulse,) = (spec.of_role(r) for r in ("frequency", "phase", "switch"))
    variants: dict[str, EffectVariant] = {}  # two that would begin before the recording are one
    for time in shown_from:
        for share in PULSE_WIDTHS:
            width = share * period
            begin = max(time - SEEN_AT * width, 0.0)
            values = {frequency.name: 0.5 / width, phase.name: -np.pi * begin / width, pulse.name: 1.0}
            label = f"{spec.name}, a pulse of {width:.3g} s from {begin:.3f} s on"
            variants[label] = strength_variant(belief, spec, label, values)
    return list(variants.values())


def swing_variants(belief: Belief, spec: EffectSpec, frequencies: Sequence[float]) -> list[EffectVariant]:
    """Harmonic motions, sine and cosine, at given frequencies [Hz]."""
    (frequency,) = spec.of_role("frequency")
    return [
        swing_variant(belief, spec, f"{spec.name} at {f:.3g} Hz", {frequency.name: float(f)})
        for f in frequencies
    ]


def periodic_variants(
    belief: Belief,
    transfer: str,
    residual: np.ndarray,
    fps: float,
    begin: float,
    *,
    names: Sequence[str] | None = None,
) -> list[EffectVariant]:
    """What swings with a frequency, or acts in pulses, as a misfit suggests it.

    residual: (T, M, 3) [m], NaN where not seen; begin: time of its first frame [s]; names: effects to
    consider (None: all).
    """
    common = mean_seen(residual, 1)
    common = np.nan_to_num(common - mean_seen(common, 0))
    swings = swing_frequencies(common, fps, FREQUENCIES)
    slow = [share * fps / len(residual) for share in SLOW]
    moments = [begin + k / fps for k in sudden_beginnings(residual, RISES)] if swings else []
    variants: list[EffectVariant] = []
    for spec in absent_effects(belief, transfer, names):
        if spec.of_role("frequency"):
            variants += swing_variants(belief, spec, [*swings, *slow])
            if spec.of_role("switch") and swings:
                variants += pulse_variants(belief, spec, moments, 1.0 / swings[0])
    return variants

"""Noise that is not as stated: values on a grid of their own, markers that scatter more than others, or all
of them more than stated.

The noise that tracks show by themselves is what no other marker shares and no motion has (see `scatter`); it
is no misfit, and hides nothing that a model may lack.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from mphygs.capture.track_faults.scatter import Scatter, own_noise, scatter
from mphygs.capture.track_faults.tracks import ExaminedTracks, Finding, listed

FAULT = "noise_level"
# Rounding counts whose standard deviation is this share of the stated one.
ROUNDING = 0.2
# Values on a grid: so many of its points are seen at least; values are so near to them, of its step; steps
# below this share of sigma are those of the file's numbers; of long steps, in steps, the rest says nothing.
FEWEST, NEAR, FINEST, LONG = 8, 0.02, 0.05, 20.0
# Markers differ where equal ones would by chance in one capture of a million, the noisiest tenth scatters so
# many times as much as the quietest, or one so many times as much as the typical one; and where the first
# half of the recording says the same of them as the second.
LEVEL, UNEVEN, AGAIN = 1e-6, 1.6, 0.75
# What the noisy ones have beyond noise that is new in every frame is at most this share: a track that is lost
# wanders.
WANDERS = 0.35
# All scatter more than stated where the typical one does so many times as much, and they do so alike: all but
# this share at either end, within the ratio from which on markers differ.
LOUDER, SOME = 1.15, 0.1


def repair_noise_level(tracks: ExaminedTracks) -> ExaminedTracks:
    """The tracks with the noise that they show."""
    stated = tracks.sigma
    step = quantum(tracks.position if tracks.raw is None else tracks.raw, stated)
    rounding = step / np.sqrt(12.0)
    said, numbers = [], {}
    least, most = stated, np.inf
    if rounding > ROUNDING * stated:
        said.append(f"positions are rounded to {1e3 * step:.3g} mm")
        numbers["step"] = step
        # Whether the stated one has the rounding in it is not known.
        least, most = max(stated, rounding), float(np.hypot(stated, rounding))
    shown = scatter(tracks.position)
    typical, louder = None, False
    if shown is not None and shown.white.mean() > 0.5:
        typical = shown.typical
        low, high = np.quantile(shown.least[shown.white], [SOME, 1.0 - SOME])
        louder = typical > LOUDER * stated and stated < low and high < UNEVEN * low
        louder = louder and own_noise(tracks.position) > LOUDER * stated
    sigma, spread = stated, None
    if typical is None:
        sigma = most if numbers else stated
    elif numbers or louder:
        sigma = max(typical, least)
        if sigma > LOUDER * most:
            said.append(f"they scatter by {1e3 * typical:.3g} mm a coordinate")
    if shown is not None and typical is not None and uneven(shown) and _lasts(tracks.position):
        known = np.isfinite(shown.least)
        spread = np.where(known, np.fmax(shown.least, rounding), sigma)
        order = np.argsort(-np.where(known, spread, 0.0))
        worst = [f"{k} ({1e3 * spread[k]:.3g} mm)" for k in order[: max(1, int(0.1 * len(order)))]]
        said.append(
            f"markers scatter by {1e3 * spread.min():.3g} to {1e3 * spread.max():.3g} mm a coordinate, most "
            f"of all {listed(worst)}: each has its own sigma"
        )
        numbers |= {"lowest": float(spread.min()), "highest": float(spread.max())}
        sigma = float(np.sqrt(np.mean(spread**2)))
    elif sigma > LOUDER * stated and not numbers:
        said.append(f"markers scatter by {1e3 * sigma:.3g} mm a coordinate")
    if not said:
        return tracks
    text = f"{'; '.join(said)}; sigma is {1e3 * sigma:.3g} mm, stated was {1e3 * stated:.3g} mm"
    finding = Finding(FAULT, text, numbers | {"sigma": sigma, "stated": stated})
    return replace(tracks.found(finding), sigma=sigma, scatter=spread)


def quantum(position: np.ndarray, sigma: float) -> float:
    """Step of the grid that all values stand on [m]; 0 where there is none, or one far below sigma [m]."""
    values = np.unique(position[np.isfinite(position)])
    steps = np.diff(values)
    coarse = steps[steps > FINEST * sigma]
    if len(coarse) < FEWEST:
        return 0.0
    # The smallest step has the numbers' own rounding in it: many of them together tell it better.
    step = float(np.median(coarse[coarse < (1.0 + NEAR) * coarse.min()]))
    steps = steps[steps < LONG * step]
    counts = np.round(steps / step)
    if (np.abs(steps / step - counts) > NEAR).any():
        return 0.0
    return float(steps.sum() / counts.sum())


def uneven(shown: Scatter) -> bool:
    """Whether markers scatter differently, by more than chance."""
    white = shown.white
    if white.sum() < 2:
        return False
    sigma, degrees = shown.least[white], shown.degrees[white]
    low, high = np.quantile(sigma, [0.1, 0.9])
    if max(high / low, sigma.max() / np.median(sigma)) < UNEVEN:
        return False
    noisy = sigma > UNEVEN * np.median(sigma)
    rough, whole = shown.sigma[white][noisy], shown.whole[white][noisy]
    if (whole**2).sum() > (1.0 + WANDERS) * (rough**2).sum():
        return False
    variance = sigma**2
    mean = np.average(variance, weights=degrees)
    # Variances of numbers with heavy tails differ more.
    square = (degrees * (variance / mean - 1.0) ** 2).sum() / (2.0 + shown.kurtosis)
    return bool(chi2.sf(square, white.sum() - 1) < LEVEL)


def _lasts(position: np.ndarray) -> bool:
    """Whether markers that scatter more in the first half do so in the second: single bad values do not."""
    half = len(position) // 2
    both = [scatter(position[:half]), scatter(position[half:])]
    if any(one is None for one in both):
        return False
    with np.errstate(invalid="ignore", divide="ignore"):
        first, second = (np.log(one.sigma) for one in both)
    known = np.isfinite(first) & np.isfinite(second)
    if known.sum() < 3 or np.ptp(first[known]) == 0.0 or np.ptp(second[known]) == 0.0:
        return False
    return bool(np.corrcoef(first[known], second[known])[0, 1] > AGAIN)

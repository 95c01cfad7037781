"""Does an added effect pay on frames and motions that were not fitted.

The gain of each block of unseen observations is taken as one draw; blocks are resampled, so that neighbouring
frames, which err together, do not count as independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

Array = NDArray[np.float64]

# With fewer blocks an interval says nothing.
MINIMUM_BLOCKS = 4


@dataclass(frozen=True)
class GainInterval:
    """Log-likelihood gain on unseen observations.

    gain: its sum; low, high: the bootstrap interval; error: its standard error; plain: by how much the plain
    mean square falls, averaged over recordings [sigma^2], None where it is not known.
    """

    gain: float
    low: float
    high: float
    block_count: int
    error: float = 0.0
    plain: float | None = None

    @property
    def accepted(self) -> bool:
        """Whether the whole interval lies above 0, and the error in metres falls with it: where noise hangs
        together, slow errors hardly count in a likelihood, and a gain there may be paid with a motion that is
        further off. Only then is the effect kept."""
        return self.low > 0.0 and (self.plain is None or self.plain > 0.0)


def gain_interval(
    before: Array,
    after: Array,
    blocks: NDArray[np.int_],
    *,
    generator: np.random.Generator,
    confidence: float = 0.95,
    draws: int = 4000,
) -> GainInterval:
    """Block-bootstrap interval of sum (before² - after²) / 2.

    before, after: (N,) whitened residuals without and with the effect. blocks: (N,) block of each; a block
    should span the time over which errors hang together, such as one swing. The percentile interval is
    widened for few blocks (Hesterberg, What teachers should know about the bootstrap, 2015, section 5.3).
    Raises ValueError below MINIMUM_BLOCKS blocks or on arrays that do not fit.
    """
    if before.shape != after.shape or before.shape != blocks.shape:
        raise ValueError(f"gain: shapes {before.shape}, {after.shape}, {blocks.shape}, expected three alike")
    if not (np.all(np.isfinite(before)) and np.all(np.isfinite(after))):
        raise ValueError("gain: expected finite residuals")
    _, index = np.unique(blocks, return_inverse=True)
    gains = np.bincount(index, 0.5 * (before**2 - after**2))
    count = len(gains)
    if count < MINIMUM_BLOCKS:
        raise ValueError(f"gain: {count} blocks of unseen frames, expected at least {MINIMUM_BLOCKS}")
    totals = generator.multinomial(count, np.full(count, 1.0 / count), size=draws) @ gains
    tail = norm.cdf(np.sqrt(count / (count - 1.0)) * t.ppf(0.5 * (1.0 - confidence), count - 1))
    low, high = np.quantile(totals, [tail, 1.0 - tail])
    error = float(totals.std() * np.sqrt(count / (count - 1.0)))
    return GainInterval(float(gains.sum()), float(low), float(high), count, error)

"""Is the misfit more than noise, where, when, and whose fault: noise, discretisation or physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from scipy.stats import chi2

from mphygs.compare.allowance import Allowance
from mphygs.compare.blocks import part_time_blocks
from mphygs.compare.compared import Compared, Whitened, whiten_all
from mphygs.compare.grid_share import discretisation_allowance, error_budget, grid_share
from mphygs.compare.verdict_floor import Floor, above, floor_test

# Two bodies discretised differently agree to a few tenths of a standard deviation at best: a misfit of
# this many sigma, everywhere, is no reason to doubt the physics (spec: 1.1, of which noise is 1).
PRACTICAL_FLOOR = 1.1
# What the floor test may excuse beyond it, and no more.
LARGEST_EXCUSED = 1.5 * PRACTICAL_FLOOR
# Where a refinement has shown the discretisation's share: what it does not cover is, in every range, no more
# than this many sigma, noise included, and the misfit no more than the second number.
BUDGET_FLOOR, LARGEST_GRID_ERROR = 1.15, 5.0
# Of the test of the floor.
LEVEL = 0.01
# Order in the spacing of the least that a grid's error falls by, near enough.
FIRST_ORDER = 1
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Assessment:
    """adequate: no more misfit than the floor; p_value: of a misfit this large with the discretisation's
    share allowed for, as an error that drifts, or where the verdict rests on that share as a refinement has
    shown it, of what that leaves, range by range; grid: that share,
    root mean square over all rows [sigma]; by: what the misfit is no more than, "noise" (and the grid, by the
    test of the floor), "grid" (as measured, range by range) or "tolerance", None where it is more; ratio:
    sequence -> range -> root mean square over sigma of the whitened residual; rows: how many of these;
    noise_degrees: of freedom behind the noise's scale, infinite where it is known; budget: shares of the mean
    square [m^2] as root mean squares [m]; where, when: as the command prints."""

    adequate: bool
    p_value: float
    ratio: dict[str, dict[str, float]]
    floor: Floor
    where: list[dict]
    when: list[dict]
    budget: dict[str, float]
    grid: float = 0.0
    by: str | None = None
    rows: dict[str, dict[str, int]] = field(default_factory=dict)
    noise_degrees: float = np.inf

    @property
    def worst(self) -> float:
        """Largest ratio of any sequence and range."""
        return max(value for ranges in self.ratio.values() for value in ranges.values())

    @property
    def fitted(self) -> tuple[float, int]:
        """Mean square of the whitened residual in all fitted frames, and its rows."""
        count = sum(rows.get("fit", 0) for rows in self.rows.values())
        total = sum(n["fit"] * self.ratio[k]["fit"] ** 2 for k, n in self.rows.items() if "fit" in n)
        return (total / count if count else 1.0), count


def stays(coarse: Assessment, fine: Assessment, ratio: float) -> bool:
    """Whether what a model leaves is not the grid's: fitted anew on a finer grid it left as much.

    coarse, fine: of the same model, fitted on either grid; ratio: of their spacings, above 1. An error of the
    grid falls with the spacing, at first order at the least, and its square at second; physics that is
    missing stays. Nearer to the one than to the other, in the fitted frames, where it has to be more than
    noise, and in the worst range: frames that were not fitted show what the numbers' errors make of them as
    well, which stays too.
    """
    falls_to = 0.5 * (1.0 + ratio ** (-2 * FIRST_ORDER))
    (before, _), (after, count) = coarse.fitted, fine.fitted
    if not count or above(after, count, fine.noise_degrees) > LEVEL or fine.worst <= PRACTICAL_FLOOR:
        return False
    return all(
        new - 1.0 > falls_to * (old - 1.0)
        for old, new in ((before, after), (coarse.worst**2, fine.worst**2))
    )


def ratios_at_zero_spacing(
    coarse: Mapping[str, Compared], fine: Mapping[str, Compared], ratio: float
) -> dict[str, dict[str, float]]:
    """Root mean square over sigma, by sequence and range, of what a model would leave on an ever finer grid.

    coarse, fine: of the same model and measurements, fitted on either grid; ratio: of their spacings, above
    1. Richardson's extrapolation of the residual, whose error falls with the square of the spacing: the noise
    in it is the same on both grids and stays as it is. A wrong model that makes up for a coarse grid leaves
    more in that limit, the right one its noise.
    """
    before, after = whiten_all(coarse), whiten_all(fine)
    beyond = (after.residual - before.residual) / (ratio**2 - 1.0)
    return ratios(replace(after, residual=after.residual + beyond))


def in_words(adequate: bool, p_value: float) -> str:
    """What a misfit is, for people."""
    if not adequate:
        return "more than noise"
    if p_value >= LEVEL:
        return "no more than noise"
    return "more than noise alone, and no more than what a grid has of its own"


def ratios(whitened: Whitened) -> dict[str, dict[str, float]]:
    """Root mean square of the whitened residual per sequence and range ("fit", "predict")."""
    return _of_ranges(whitened, lambda rows: float(np.sqrt(np.mean(rows**2))))


def _of_ranges(whitened: Whitened, of: Callable[[np.ndarray], T]) -> dict[str, dict[str, T]]:
    """What a function makes of the residual of every sequence and range that has any."""
    out: dict[str, dict[str, T]] = {}
    for number, name in enumerate(whitened.names):
        mine = whitened.sequence == number
        out[name] = {
            label: of(whitened.residual[mine & rows])
            for label, rows in (("fit", whitened.fitted), ("predict", ~whitened.fitted))
            if (mine & rows).any()
        }
    return out


def assess(
    compared: Mapping[str, Compared],
    part_names: tuple[str, ...],
    *,
    part_centers: np.ndarray,
    block_frames: int = 10,
    level: float = LEVEL,
) -> Assessment:
    """Compare predictions with measurements.

    part_centers: (P, 3) [m], where a part is said to be. block_frames: length of the stretches of time that
    are tested one by one. Raises ValueError when nothing was measured in any range.
    """
    whitened = whiten_all(compared)
    if not len(whitened.residual):
        raise ValueError("nothing was measured in the frames to compare")
    # What a finer grid leaves as it is no grid excuses.
    excusable = not any(item.stays for item in compared.values())
    allowance = discretisation_allowance(whitened) if excusable else Allowance()
    # Parts of every sequence, and its instruments, are blocks of their own.
    sensors = max(len(item.sensors) for item in compared.values())
    own = np.where(whitened.part < 0, len(part_names) - 1 - whitened.part, whitened.part)
    label = whitened.sequence * (len(part_names) + sensors) + own
    names = [
        text
        for item in compared.values()
        for text in (*part_names, *_labels(item), *[""] * (sensors - len(item.sensors)))
    ]
    blocks = part_time_blocks(label, whitened.frame, names=names, length=block_frames)
    degrees = min((c.observation.noise.scale_degrees for c in compared.values()), default=np.inf)
    floor = floor_test(
        whitened.residual, whitened.jacobian, blocks, allowance=allowance, noise_degrees=degrees, level=level
    )
    found = ratios(whitened)
    worst = max(v for ranges in found.values() for v in ranges.values())
    share = grid_share(whitened) if excusable else np.zeros_like(whitened.residual)
    budget = error_budget(whitened, share)
    # Whatever the discretisation's error hides cannot be told from it; what exceeds it is physics. In every
    # range: fitted frames may not pay for what unseen ones show.
    beyond = [(whitened.residual[rows] ** 2 - share[rows] ** 2) for rows in _ranges(whitened)]
    own = np.any(share) and worst < LARGEST_GRID_ERROR
    own = own and max(map(np.mean, beyond)) <= BUDGET_FLOOR**2
    by = None
    if floor.reached and worst <= LARGEST_EXCUSED:
        by = "noise"
    elif own:
        by = "grid"
    elif worst <= PRACTICAL_FLOOR:
        by = "tolerance"
    return Assessment(
        adequate=by is not None,
        p_value=_beyond_the_grid(beyond) if by == "grid" else _p_value(floor),
        ratio=found,
        floor=floor,
        where=_where(whitened, part_names, part_centers),
        when=_when(whitened, block_frames),
        budget=budget,
        grid=float(np.sqrt(np.mean(share**2))),
        by=by,
        rows=_of_ranges(whitened, len),
        noise_degrees=degrees,
    )


def _labels(item: Compared) -> list[str]:
    return [one.sensed.label for one in item.sensors]


def _p_value(floor: Floor) -> float:
    """Of all rows, or of the block that is above the floor where one is."""
    return min(floor.p_value, *(float(floor.block_p_values[k]) for k in floor.significant_blocks), 1.0)


def _beyond_the_grid(beyond: list[np.ndarray]) -> float:
    """p-value of the squares that the grid's share does not cover, by range, in the range in which it is
    least: where noise is as large as `BUDGET_FLOOR` says at most (Bonferroni over the ranges)."""
    found = [chi2.sf(max(float(b.sum()), 0.0) / BUDGET_FLOOR**2, len(b)) for b in beyond]
    return float(min(1.0, len(found) * min(found)))


def _excess(whitened: Whitened, rows: np.ndarray) -> float:
    """Root mean square over markers beyond noise [m], of some rows."""
    beyond = whitened.sigma[rows] ** 2 * (whitened.residual[rows] ** 2 - 1.0)
    return float(np.sqrt(3.0 * max(np.mean(beyond), 0.0)))


def _where(whitened: Whitened, parts: tuple[str, ...], centers: np.ndarray) -> list[dict]:
    """Parts whose misfit is more than noise, the worst first."""
    found = []
    for p, name in enumerate(parts):
        rows = whitened.part == p
        if _is_more_than_noise(whitened.residual[rows], 1e-3 / len(parts)):
            found.append(
                {
                    "part": name,
                    "center": [float(x) for x in centers[p]],
                    "rms": _excess(whitened, rows),
                }
            )
    return sorted(found, key=lambda item: -item["rms"])


def _is_more_than_noise(residual: np.ndarray, level: float) -> bool:
    """Whether the chi-square test of whitened residuals says so at that level."""
    count = len(residual)
    return count > 0 and float(residual @ residual) > chi2.isf(level, count)


def _when(whitened: Whitened, length: int) -> list[dict]:
    """Stretches of frames whose misfit is more than noise, the worst first."""
    found = []
    for number, name in enumerate(whitened.names):
        mine = (whitened.sequence == number) & (whitened.part >= 0)
        frames = whitened.frame[mine]
        edges = np.arange(frames.min(), frames.max() + 1, length)
        for first in edges:
            rows = mine & (whitened.frame >= first) & (whitened.frame < first + length)
            if _is_more_than_noise(whitened.residual[rows], 1e-3 / len(edges)):
                last = int(min(first + length, frames.max() + 1))
                found.append(
                    {
                        "sequence": name,
                        "frames": [int(first), last],
                        "rms": _excess(whitened, rows),
                    }
                )
    return sorted(found, key=lambda item: -item["rms"])


def _ranges(whitened: Whitened) -> list[np.ndarray]:
    """Rows of every sequence's fitted and unseen frames, (N,) bool each."""
    found = []
    for number in range(len(whitened.names)):
        mine = whitened.sequence == number
        found += [rows for rows in (mine & whitened.fitted, mine & ~whitened.fitted) if rows.any()]
    return found

"""Is the misfit more than noise, where, when, and whose fault: noise, discretisation or physics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from mphygs.compare.allowance import Allowance, modulated_directions
from mphygs.compare.blocks import part_time_blocks
from mphygs.compare.noise import Observation
from mphygs.compare.verdict_floor import Floor, floor_test

# Two bodies discretised differently agree to a few tenths of a standard deviation at best: a misfit of
# this many sigma, everywhere, is no reason to doubt the physics (spec: 1.1, of which noise is 1).
PRACTICAL_FLOOR = 1.1
# What the floor test may excuse beyond it, and no more.
LARGEST_EXCUSED = 1.5 * PRACTICAL_FLOOR
# Where a refinement has shown the discretisation's share: what it does not cover is, in every range, no more
# than this many sigma, noise included, and the misfit no more than the second number.
BUDGET_FLOOR, LARGEST_GRID_ERROR = 1.15, 5.0
# How far a coordinate that the fitted frames leave open gives way to the discretisation's error: a factor e.
GIVES_WAY = 1.0
# Of the test of the floor.
LEVEL = 0.01
# Cosines over time by which the discretisation's error may differ from the change under refinement.
MODULATIONS = 6


@dataclass(frozen=True, eq=False)
class Compared:
    """Prediction and measurement of one sequence.

    predicted: (T, M, 3) [m]; jacobian: (T, M, 3, P) by the free coordinates; part: (M,) of every marker;
    refinement: (T, M, 3) change of the prediction under refinement, extrapolated, or None;
    fit, predict: frame ranges; tangents_of: spacing of the grid that the Jacobian is of [m], None for the
    prediction's.
    """

    observation: Observation
    predicted: np.ndarray
    jacobian: np.ndarray
    part: np.ndarray
    fit: tuple[int, int]
    predict: tuple[int, int]
    refinement: np.ndarray | None = None
    tangents_of: float | None = None

    @property
    def frames(self) -> tuple[int, int]:
        """First and last frame of either range."""
        used = [r for r in (self.fit, self.predict) if r[1] > r[0]]
        return min(a for a, _ in used), max(b for _, b in used)


@dataclass(frozen=True, eq=False)
class Whitened:
    """All compared rows, sequences one after the other. seen: rows of frames that were fitted; sigma: (N,) of
    the noise of each row's sequence and frame [m]."""

    residual: np.ndarray
    jacobian: np.ndarray
    refinement: np.ndarray
    part: np.ndarray
    frame: np.ndarray
    sequence: np.ndarray
    seen: np.ndarray
    sigma: np.ndarray
    names: tuple[str, ...]


def whiten_all(compared: Mapping[str, Compared]) -> Whitened:
    """Whitened residual (measured - predicted), Jacobian of the prediction and refinement of all sequences.

    Each sequence is whitened over the frames of its two ranges together.
    """
    parts: list[tuple] = []
    for number, item in enumerate(compared.values()):
        first, last = item.frames
        window = slice(first, last)
        whitener = item.observation.whitener(first, last)
        rows = whitener.whiten(np.nan_to_num(item.observation.position[window] - item.predicted[window]))
        jacobian = whitener.whiten(item.jacobian[window])
        refinement = np.zeros_like(item.predicted) if item.refinement is None else item.refinement
        frame = whitener.frame + first
        seen = (frame >= item.fit[0]) & (frame < item.fit[1])
        used = seen | ((frame >= item.predict[0]) & (frame < item.predict[1]))
        parts.append(
            (
                rows[used],
                jacobian[used],
                whitener.whiten(refinement[window])[used],
                item.part[whitener.marker][used],
                frame[used],
                np.full(int(used.sum()), number),
                seen[used],
                item.observation.sigma * item.observation.frames_of_noise[frame[used]],
            )
        )
    joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    return Whitened(*joined, tuple(compared))


@dataclass(frozen=True, eq=False)
class Assessment:
    """adequate: no more misfit than the floor; p_value: of a misfit this large with the discretisation's
    share allowed for, as an error that drifts, or where the verdict rests on that share as a refinement has
    shown it, of what that leaves, range by range; grid: that share,
    root mean square over all rows [sigma]; by: what the misfit is no more than, "noise" (and the grid, by the
    test of the floor), "grid" (as measured, range by range) or "tolerance", None where it is more; ratio:
    sequence -> range -> root mean square over sigma of the whitened residual; budget: shares of the mean
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

    @property
    def worst(self) -> float:
        """Largest ratio of any sequence and range."""
        return max(value for ranges in self.ratio.values() for value in ranges.values())


def in_words(adequate: bool, p_value: float) -> str:
    """What a misfit is, for people."""
    if not adequate:
        return "more than noise"
    if p_value >= LEVEL:
        return "no more than noise"
    return "more than noise alone, and no more than what a grid has of its own"


def ratios(whitened: Whitened) -> dict[str, dict[str, float]]:
    """Root mean square of the whitened residual per sequence and range ("fit", "predict")."""
    out: dict[str, dict[str, float]] = {}
    for number, name in enumerate(whitened.names):
        mine = whitened.sequence == number
        out[name] = {
            label: float(np.sqrt(np.mean(whitened.residual[mine & rows] ** 2)))
            for label, rows in (("fit", whitened.seen), ("predict", ~whitened.seen))
            if (mine & rows).any()
        }
    return out


def discretisation_allowance(whitened: Whitened) -> Allowance:
    """Nuisance directions with the size of the change under refinement, per sequence and part."""
    if not np.any(whitened.refinement):
        return Allowance()
    columns = []
    for number in range(len(whitened.names)):
        mine = whitened.sequence == number
        block = modulated_directions(
            whitened.refinement[mine], whitened.part[mine], whitened.frame[mine], count=MODULATIONS
        )
        full = np.zeros((len(mine), block.shape[1]))
        full[mine] = block
        columns.append(full)
    directions = np.concatenate(columns, axis=1)
    return Allowance(directions=directions[:, np.linalg.norm(directions, axis=0) > 1e-9])


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
    allowance = discretisation_allowance(whitened)
    # Parts of every sequence are blocks of their own.
    label = whitened.sequence * len(part_names) + whitened.part
    names = [part for _ in whitened.names for part in part_names]
    blocks = part_time_blocks(label, whitened.frame, names=names, length=block_frames)
    degrees = min((c.observation.noise.scale_degrees for c in compared.values()), default=np.inf)
    floor = floor_test(
        whitened.residual, whitened.jacobian, blocks, allowance=allowance, noise_degrees=degrees, level=level
    )
    found = ratios(whitened)
    worst = max(v for ranges in found.values() for v in ranges.values())
    share = _grid_share(whitened)
    budget = _budget(whitened, share)
    # Whatever the discretisation's error hides cannot be told from it; what exceeds it is physics. In every
    # range: fitted frames may not pay for what unseen ones show.
    beyond = [(whitened.residual[rows] ** 2 - share[rows] ** 2) for rows in _ranges(whitened)]
    own = np.any(whitened.refinement) and worst < LARGEST_GRID_ERROR
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
    )


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
        mine = whitened.sequence == number
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
        found += [rows for rows in (mine & whitened.seen, mine & ~whitened.seen) if rows.any()]
    return found


def _grid_share(whitened: Whitened) -> np.ndarray:
    """(N,) the change under refinement less what refitting absorbs: a fit to the fitted frames, which carries
    what it made of them on to the unseen ones."""
    share, count = whitened.refinement, whitened.jacobian.shape[1]
    if not np.any(share) or not count or not whitened.seen.any():
        return share
    return share - whitened.jacobian @ _shift(whitened, np.eye(count) / GIVES_WAY**2)


def _shift(whitened: Whitened, prior: np.ndarray) -> np.ndarray:
    """(P,) how far a fit to the fitted frames moves its coordinates for what a refinement changes there.

    prior: (P, P) inverse covariance of the coordinates before anything was measured.
    """
    jacobian = whitened.jacobian[whitened.seen]
    inverse = np.linalg.pinv(jacobian.T @ jacobian + prior, rcond=1e-14, hermitian=True)
    return inverse @ (jacobian.T @ whitened.refinement[whitened.seen])


def grid_shift(compared: Mapping[str, Compared], prior: np.ndarray) -> np.ndarray | None:
    """(P,) how far the grid's error moves the fitted coordinates; None where no refinement is known.

    prior: (P, P) inverse covariance of the coordinates before anything was measured. The error of the fitted
    frames is taken for what a refinement changes, extrapolated; what would fit it is found by the tangents of
    the comparison alone, which may be of another grid than those of the fit.
    """
    whitened = whiten_all(compared)
    if not np.any(whitened.refinement) or whitened.jacobian.shape[1] != len(prior):
        return None
    return _shift(whitened, prior)


def _budget(whitened: Whitened, share: np.ndarray) -> dict[str, float]:
    """Root mean squares over markers of the three shares [m]: they add in squares to the misfit.

    What neither the discretisation's share, (N,), nor noise covers is physics.
    """
    variance = whitened.sigma**2
    noise = float(np.mean(variance))
    beyond = max(float(np.mean(variance * whitened.residual**2)) - noise, 0.0)
    discretisation = min(float(np.mean(variance * share**2)), beyond)
    shares = {"noise": noise, "discretisation": discretisation, "physics": beyond - discretisation}
    return {name: float(np.sqrt(3.0 * value)) for name, value in shares.items()}

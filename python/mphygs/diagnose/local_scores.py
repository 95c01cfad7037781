"""Where and when a candidate is called for, and which fitted parameter would have to drift: the scores of
`block_scores` on the parts and stretches of time of an experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.stats import norm

from mphygs.compare.allowance import Allowance
from mphygs.compare.blocks import Blocks, part_time_blocks
from mphygs.compare.residual_projection import Projection, project_out
from mphygs.diagnose.block_scores import block_scores
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Problem

# Frames of a stretch, about; so many spots are told, significant at this level together.
STRETCH, TOLD, LEVEL = 10, 3, 0.01


@dataclass(frozen=True)
class Spot:
    """One part of the object in frames first to last - 1 of a sequence.

    z: standard normal where the parameter is not wanted there more than elsewhere; its sign is the
    parameter's.
    """

    sequence: str
    part: str
    frames: tuple[int, int]
    parameter: str
    z: float

    def document(self) -> dict[str, object]:
        """The JSON."""
        return asdict(self) | {"frames": list(self.frames)}


@dataclass(frozen=True, eq=False)
class Spots:
    """What is left of a fit, by block. residual: (N,) whitened, the rows of measurements first; places:
    sequence, part and frames of every block; allowance: the discretisation's share."""

    residual: np.ndarray
    projection: Projection
    blocks: Blocks
    places: tuple[tuple[str, str, tuple[int, int]], ...]
    allowance: Allowance

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        problem: Problem,
        residual: np.ndarray,
        jacobian: np.ndarray,
        allowance: Allowance | None = None,
    ) -> Spots:
        """residual: (N,), jacobian: (N, P), the rows of measurements first, as the problem has them."""
        allowance = allowance or Allowance()
        parts = [part.name for part in experiment.capture.parts]
        index, places, found = [], [], ()
        for name, (first, last) in problem.ranges.items():
            whitener = experiment.observations[name].whitener(first, last)
            if not whitener.row_count:
                continue
            part = problem.predictors[name].attachment.part[whitener.marker]
            own = part_time_blocks(part, first + whitener.frame, names=parts, length=STRETCH)
            index.append(len(found) + own.index)
            found += own.blocks
            places += [(name, block.part, (block.first, block.last + 1)) for block in own.blocks]
        residual, jacobian = allowance.apply(residual), allowance.apply_jacobian(jacobian)
        # What a prior says is of no place and no time: in no block.
        rows = np.concatenate(index)
        rows = np.r_[rows, np.full(len(residual) - len(rows), len(found))]
        return cls(residual, project_out(jacobian), Blocks(found, rows), tuple(places), allowance)

    def of_columns(self, tangent: np.ndarray, labels: Sequence[str]) -> tuple[Spot, ...]:
        """The places and times at which the columns (N, q) are wanted most, the first the most.

        None that chance may show: two-sided, among all blocks and columns.
        """
        z = block_scores(self.residual, self.projection, self.allowance.apply(tangent), self.blocks).z
        bound = norm.isf(0.5 * LEVEL / max(z.size, 1))
        order = np.argsort(-np.abs(z), axis=None)[:TOLD]
        return tuple(
            Spot(*self.places[block], labels[column], float(z[block, column]))
            for block, column in zip(*np.unravel_index(order, z.shape), strict=True)
            if abs(z[block, column]) > bound
        )

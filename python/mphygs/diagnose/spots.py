"""Where and when a candidate is called for, and which fitted parameter would have to drift: the scores of
`block_scores` on the parts and stretches of time of an experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.stats import norm

from mphygs.compare.blocks import Blocks, part_time_blocks
from mphygs.compare.projection import Projection, project_out
from mphygs.diagnose.block_scores import block_scores
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Problem

# Frames of a stretch, as `compare` has them; so many spots are told, significant at this level together.
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
    """What is left of a fit, by block. residual: (N,) whitened, priors' rows last; blocks: of the rows before
    them, named by the number of sequence and part."""

    residual: np.ndarray
    projection: Projection
    blocks: Blocks
    sequences: tuple[str, ...]
    parts: tuple[str, ...]

    @classmethod
    def of(
        cls, experiment: Experiment, problem: Problem, residual: np.ndarray, jacobian: np.ndarray
    ) -> Spots:
        """residual: (N,), jacobian: (N, P), the rows of measurements first, as the problem has them."""
        names = tuple(part.name for part in experiment.capture.parts)
        part, frame = [], []
        for number, (name, (first, last)) in enumerate(problem.ranges.items()):
            whitener = experiment.observations[name].whitener(first, last)
            of_marker = problem.predictors[name].attachment.part
            part.append(number * len(names) + of_marker[whitener.marker])
            frame.append(first + whitener.frame)
        label, when = np.concatenate(part), np.concatenate(frame)
        count = len(names) * len(problem.ranges)
        blocks = part_time_blocks(label, when, names=[str(k) for k in range(count)], length=STRETCH)
        # What a prior says is of no place and no time: a block of its own, whose score is left out.
        priors = np.full(len(residual) - len(label), len(blocks))
        blocks = Blocks(blocks.blocks, np.r_[blocks.index, priors])
        return cls(residual, project_out(jacobian), blocks, tuple(problem.ranges), names)

    def of_columns(self, tangent: np.ndarray, labels: Sequence[str]) -> tuple[Spot, ...]:
        """The places and times at which the columns (N, q) are wanted most, the first the most.

        None that chance may show: two-sided, among all blocks and columns.
        """
        z = block_scores(self.residual, self.projection, tangent, self.blocks).z
        bound = norm.isf(0.5 * LEVEL / max(z.size, 1))
        order = np.argsort(-np.abs(z), axis=None)[:TOLD]
        found = []
        for block, column in zip(*np.unravel_index(order, z.shape), strict=True):
            if abs(z[block, column]) > bound:
                at = self.blocks.blocks[block]
                sequence, part = divmod(int(at.part), len(self.parts))
                found.append(
                    Spot(
                        self.sequences[sequence],
                        self.parts[part],
                        (at.first, at.last + 1),
                        labels[column],
                        float(z[block, column]),
                    )
                )
        return tuple(found)

"""What one sequence shows, and how far from it a baseline's motion is: tracks of points, or pictures."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from mphygs.compare.noise import Observation
from mphygs.fit.gradient_optimisers import Misfit
from mphygs.fit.image_fit import watch
from mphygs.fit.pictured import Pictured
from mphygs.render.image_losses import image_loss
from mphygs.render.splatting import splat
from mphygs.render.video_loss import FrameObservation

# Of the loss of pictures, the share of structure beside colours: PhysDreamer's.
STRUCTURE = 0.9


class Target(ABC):
    """What one sequence shows. Costs of frames first..last-1 add up, and count by `weight`."""

    @abstractmethod
    def cost(self, position: np.ndarray, span: tuple[int, int]) -> tuple[float, np.ndarray]:
        """Cost of positions (T, M, 3) [m] in the frames of a span, and its derivative by them."""

    @abstractmethod
    def weight(self, span: tuple[int, int]) -> float:
        """What the cost is divided by to be a mean."""


@dataclass(frozen=True, eq=False)
class TrackTarget(Target):
    """Markers, or tracks, over their noise; positions are theirs."""

    observation: Observation

    def cost(self, position: np.ndarray, span: tuple[int, int]) -> tuple[float, np.ndarray]:
        misfit = Misfit(self.observation, *span)
        bar = misfit.slope(position)
        return misfit.cost, bar

    def weight(self, span: tuple[int, int]) -> float:
        return self.observation.whitener(*span).row_count


@dataclass(frozen=True, eq=False)
class Pictures(Target):
    """The videos of a sequence, and nothing else; positions are those of what carries the Gaussians.

    seen: what the cameras saw, by frame.
    """

    pictured: Pictured
    name: str
    seen: Mapping[int, Sequence[FrameObservation]]

    @classmethod
    def of(cls, pictured: Pictured, name: str, span: tuple[int, int]) -> Pictures:
        """As many frames of a span as the method's own stage on pictures looks at."""
        return cls(pictured, name, watch(pictured, name, span, looks=False).pictures)

    def cost(self, position: np.ndarray, span: tuple[int, int]) -> tuple[float, np.ndarray]:
        """Colours over black and their structure, mean over views, after Kerbl et al. 2023, equation 7."""
        placement, total, bar = self.pictured.placement(self.name), 0.0, np.zeros_like(position)
        turn, shift = torch.from_numpy(placement.rotation), torch.from_numpy(placement.position)
        for frame in self._within(span):
            points = torch.from_numpy(position[frame].copy()).requires_grad_()
            gaussians = self.pictured.coloured(points @ turn.T + shift)
            loss = torch.stack(
                [
                    image_loss(splat(gaussians, view.camera).colour, view.colour, dssim=STRUCTURE)
                    for view in self.seen[frame]
                ]
            ).mean()
            loss.backward()
            total += float(loss.detach())
            bar[frame] = points.grad.numpy()
        return total, bar

    def weight(self, span: tuple[int, int]) -> float:
        return len(self._within(span))

    def _within(self, span: tuple[int, int]) -> list[int]:
        return [frame for frame in self.seen if span[0] <= frame < span[1]]

"""Predictions of an image capture as pictures: every sequence simulated, drawn and held against its video."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from mphygs.capture.errors import CaptureError, fault
from mphygs.capture.extractors import Extractor, extractor_of
from mphygs.capture.features import Reduction
from mphygs.capture.format import Capture
from mphygs.capture.markers import Markers
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.stages import StageFolder
from mphygs.capture.view_folders import rest_views_of, sequence_views_of
from mphygs.capture.views import Photograph, SequenceViews
from mphygs.compare.carried_gaussians import CarriedGaussians
from mphygs.compare.image_errors import ComparedFrame, Film, frame_metrics, frames_of, range_errors
from mphygs.fit.experiment import Experiment
from mphygs.fit.image_capture import Placement, placement_of
from mphygs.fit.stage_particles import particles_of
from mphygs.model.belief import Belief
from mphygs.render.image_metrics import ImageMetrics
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.object_files import read_features
from mphygs.scene.ply import read_gaussians
from mphygs.simulate.prediction import Prediction, Predictor


@dataclass(frozen=True, eq=False)
class Looks:
    """What gives the features of the Gaussians' looks to another picture. made_by: see `extractor_of`."""

    made_by: str
    reduction: Reduction

    @cached_property
    def extractor(self) -> Extractor:
        """Loaded when it is first asked for. Raises CaptureError where it cannot be."""
        try:
            return extractor_of(self.made_by)
        except CaptureError:
            raise
        except ValueError as error:
            raise fault("features.npz: made_by", str(error), "what segment --features takes") from error

    def of(self, photograph: Photograph) -> Tensor:
        """(h, w, F) of a photograph."""
        return torch.from_numpy(self.reduction.map_of(photograph, self.extractor))


@dataclass(eq=False)
class Pictured:
    """An experiment on an image capture, with what it takes to draw it.

    source: the capture as it was recorded; drawn: Gaussians and their carriers, with the features of their
    looks where those are known; stages: folder of its stages; looks: how pictures show those features.
    """

    experiment: Experiment
    source: Capture
    stages: Path
    drawn: CarriedGaussians
    looks: Looks | None = None
    _predictors: dict[str, Predictor] = field(default_factory=dict)
    _views: dict[str, SequenceViews] = field(default_factory=dict)

    @classmethod
    def of(cls, experiment: Experiment, source: Capture, stages: Path) -> Pictured:
        """Raises CaptureError where Gaussians, features or particles of the stages cannot be used."""
        files = StageFolder(stages)
        if files.gaussians.is_file() or source.gaussians is None:
            gaussians = read_gaussians(files.gaussians)
        else:
            gaussians = read_gaussians(source.gaussians, source.gaussians_scale)
        segments = len(list(files.parts.glob("*.ply")))
        particles = particles_of(stages, segments)
        looks = None
        if files.features.is_file():
            known = read_features(files.features, gaussians.count)
            if known.reduction is not None:
                looks = Looks(known.made_by, known.reduction)
                gaussians = replace(gaussians, features=torch.from_numpy(known.appearance))
        drawn = CarriedGaussians.of(gaussians, particles.position[particles.inside])
        return cls(experiment, source, stages, drawn, looks)

    def names(self, wanted: Sequence[str] = ()) -> list[str]:
        """Sequences with a video and with what holds them known, all or those wanted among them."""
        found = [r.name for r in self.source.sequences if r.views is not None]
        held = [name for name in found if self.experiment.capture.sequence(name).held]
        return [name for name in held if not wanted or name in wanted]

    def views(self, name: str) -> SequenceViews:
        """The videos of a sequence."""
        if name not in self._views:
            rest = rest_views_of(self.source) if self.source.views is not None else None
            self._views[name] = sequence_views_of(self.source.sequence(name), rest)
        return self._views[name]

    def placement(self, name: str) -> Placement:
        """Where a sequence's frame 0 has the object."""
        return placement_of(self.source.sequence(name), self.stages)

    def predictor(self, name: str) -> Predictor:
        """The simulator of a sequence with the carriers as its markers."""
        if name not in self._predictors:
            recording = self.experiment.capture.sequence(name)
            at = self.drawn.carriers
            unmeasured = Markers(np.full((recording.frames, len(at), 3), np.nan), at, 1.0)
            settings = self.experiment.settings
            bodies = [p.body for p in self._alike(recording)]
            self._predictors[name] = self.experiment.make(
                self.experiment.capture, replace(recording, markers=unmeasured), settings,
                body=bodies[0] if bodies else None,
            )  # fmt: skip
        return self._predictors[name]

    def _alike(self, recording: Recording) -> list[Predictor]:
        """Simulators there are already with the same holds."""
        boxes = b"".join(np.asarray(hold.box, float).tobytes() for hold in recording.held)
        problem = self.experiment.problems.get(self.experiment.settings.spacing)
        known = {} if problem is None else problem.predictors
        both = [*known.values(), *self._predictors.values()]
        return [
            p
            for p in both
            if b"".join(np.asarray(hold.box, float).tobytes() for hold in p.recording.held) == boxes
        ]

    def moved(self, name: str, belief: Belief, *, last: int, keys: Sequence[str] = ()) -> Prediction:
        """Positions of the carriers in frames 0..last-1, in the object's frame, and their derivatives."""
        return self.predictor(name).predict(belief, last=last, keys=keys)

    def coloured(self, positions: Tensor) -> Gaussians:
        """The Gaussians where the carriers (P, 3) [m] are in the world, without features."""
        gaussians = self.drawn.at(positions)
        return replace(gaussians, features=gaussians.features[:, :0])

    def shown(self, name: str, prediction: Prediction, frames: Sequence[int]) -> Iterator[ComparedFrame]:
        """Predicted pictures of frames, and what the cameras saw."""
        views, placement = self.views(name), self.placement(name)
        for frame in frames:
            positions = torch.from_numpy(placement.to_world(prediction.position[frame]))
            photographs = views.read(frame)
            with torch.no_grad():
                gaussians = self.coloured(positions)
                pictures = [splat(gaussians, photograph.camera) for photograph in photographs]
            yield ComparedFrame(frame, pictures, photographs)

    def ranges(self, name: str) -> tuple[tuple[int, int], tuple[int, int]]:
        """Frames of a sequence that were fitted, and those kept for prediction."""
        experiment = self.experiment
        recording = experiment.capture.sequence(name)
        fit = experiment.fitted.get(name, (0, 0))
        if fit[1] > fit[0] or recording.fit[1] <= recording.fit[0]:
            return fit, recording.predict
        used = [r for r in (recording.fit, recording.predict) if r[1] > r[0]]
        return fit, (min(a for a, _ in used), max(b for _, b in used))

    def errors(
        self,
        belief: Belief,
        *,
        names: Sequence[str] = (),
        films: Path | None = None,
        see: Callable[[str, ComparedFrame], None] | None = None,
        report: Callable[[str], None] | None = None,
    ) -> dict[str, dict[str, dict[str, float] | None]]:
        """Errors of the predicted pictures by sequence and range; films: folder for a video of each; see: is
        shown every frame of a sequence."""
        out = {}
        for name in self.names(names):
            fit, predict = self.ranges(name)
            frames = frames_of((fit, predict))
            if not frames:
                continue
            if report:
                report(f"drawing {name}")
            known = self.experiment.with_release(belief, name, self.experiment.settings.spacing)
            prediction = self.moved(name, known, last=frames[-1] + 1)
            found: dict[int, ImageMetrics] = {}
            with ExitStack() as stack:
                film = None
                if films is not None:
                    film = stack.enter_context(Film(films / f"{name}.mp4", self.source.sequence(name).fps))
                for shown in self.shown(name, prediction, frames):
                    found[shown.frame] = frame_metrics(shown)
                    if film is not None:
                        film.add(shown)
                    if see is not None:
                        see(name, shown)
            out[name] = range_errors(found, fit, predict)
        return out

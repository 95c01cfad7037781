"""One capture with all that fitting, comparing and diagnosing it share: problems, observations, ranges."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from threading import Event

import numpy as np

from mphygs.capture.format import Capture
from mphygs.compare.assess import Assessment, Compared, assess
from mphygs.compare.noise import Observation, observe
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.fit.problem import Problem
from mphygs.fit.sensor_noise import compared_sensors, full, with_grid_error
from mphygs.model.belief import Belief
from mphygs.simulate.measured_start import of_sequence
from mphygs.simulate.prediction import Maker, Predictor
from mphygs.simulate.settings import Settings

# Refinement that shows the discretisation's share; the error falls with the square of the spacing.
REFINEMENT = 1.5
# Frames from which release or start of a sequence that was not fitted are found.
OWN_FRAMES = 40


@dataclass(eq=False)
class Experiment:
    """fitted: sequence -> frames to fit; compared ranges come from the capture; whole: sequences that
    windows do not shorten; reference: the belief at which the grid's share in what instruments read was
    looked at, None where it was not; make: what makes a predictor, another model's than the simulator's for a
    baseline.

    Bodies, models and noise are built once per spacing and shared by every fit and comparison.
    """

    capture: Capture
    settings: Settings
    fitted: dict[str, tuple[int, int]]
    observations: dict[str, Observation] = field(default_factory=dict)
    problems: dict[float, Problem] = field(default_factory=dict)
    whole: tuple[str, ...] = ()
    reference: Belief | None = None
    make: Maker = Predictor

    @classmethod
    def of(
        cls,
        capture: Capture,
        settings: Settings,
        *,
        sequences: Sequence[str] | None = None,
        frames: tuple[int, int] | None = None,
    ) -> Experiment:
        """sequences: names to fit (None: all with a fit range); frames: range that replaces the capture's.

        Raises KeyError for an unknown sequence, ValueError when nothing is left to fit.
        """
        names = (
            [s.name for s in capture.sequences if s.fit[1] > s.fit[0]]
            if sequences is None
            else list(sequences)
        )
        fitted = {}
        for name in names:
            recording = capture.sequence(name)
            if recording.markers is None:
                continue
            span = frames if frames is not None else recording.fit
            span = (max(span[0], 0), min(span[1], recording.frames))
            if span[1] > span[0]:
                fitted[name] = span
        if not fitted:
            raise ValueError(f"capture '{capture.name}': no sequence has markers and frames to fit")
        return cls(capture, settings, fitted)

    def starting(self, belief: Belief) -> Belief:
        """A belief whose free parameters are those that the fitted sequences can tell: of releases and starts
        their own."""
        parameters = tuple(
            p if of_sequence(p) is None else replace(p, free=p.free and of_sequence(p) in self.fitted)
            for p in belief.parameters
        )
        return replace(belief, parameters=parameters)

    def problem(self, spacing: float) -> Problem:
        """The fit at one spacing."""
        if spacing not in self.problems:
            own = replace(self.settings, spacing=spacing)
            self.problems[spacing] = Problem(
                self.capture, own, self.fitted, self.observations, make=self.make
            )
        for name in self.fitted:
            self._observe(name, self.problems[spacing].predictors[name])
        return self.problems[spacing]

    def window(self, spacing: float, share: float) -> Problem:
        """The fit to the first share of every range's frames, those of `whole` left as they are."""
        problem = self.problem(spacing)
        if share >= 1.0:
            return problem
        narrow = problem.narrowed(share)
        return narrow.with_ranges(narrow.ranges | {name: problem.ranges[name] for name in self.whole})

    def only(self, names: Sequence[str]) -> Experiment:
        """The experiment on some of its fitted sequences, as if the others had not been recorded."""
        kept = tuple(s for s in self.capture.sequences if s.name in names)
        fitted = {name: self.fitted[name] for name in names}
        capture = replace(self.capture, sequences=kept)
        own = {"reference": self.reference, "make": self.make}
        return Experiment(capture, self.settings, fitted, self.observations, **own)

    def twin(self, workers: int, halt: Event | None = None) -> Experiment:
        """The same experiment, for another thread: simulators of its own, bodies and measurements shared.

        workers, halt: see `Predictor.twin`; grids that it has to build itself know of no halt.
        """
        settings = replace(self.settings, workers=workers)
        problems = {spacing: problem.twin(workers, halt) for spacing, problem in self.problems.items()}
        return replace(self, settings=settings, problems=problems)

    def share(self, workers: int) -> None:
        """Let the runs to come have so many cores; of grids that are built already."""
        for problem in list(self.problems.values()):
            for predictor in list(problem.predictors.values()):
                predictor.workers = workers

    def adopt(self, twin: Experiment) -> None:
        """Keep what a twin had to build for grids that were new to it."""
        for spacing, problem in twin.problems.items():
            if spacing not in self.problems:
                self.problems[spacing] = problem.twin(self.settings.workers)

    def _observe(self, name: str, predictor: Predictor) -> None:
        if name not in self.observations:
            self.observations[name] = observe(self.capture.sequence(name), predictor.attachment)
            self._count_grid(name)

    def refer(self, belief: Belief) -> None:
        """Look at a belief for what the grid gets wrong of what instruments read, which counts as noise."""
        self.reference = belief
        for name in list(self.observations):
            self._count_grid(name)

    def _count_grid(self, name: str) -> None:
        """The change from a coarser grid, extrapolated, at the reference; nothing where that cannot be
        simulated."""
        sensors = self.observations[name].sensors
        if not sensors or self.reference is None:
            return
        spacing, belief = self.settings.spacing, self.reference
        used = [r for r in (self.fitted.get(name, (0, 0)), self.unseen(name)) if r[1] > r[0]]
        last = max((b for _, b in used), default=self.capture.sequence(name).frames)
        fine, coarse = self.predictor(name, spacing), self.predictor(name, spacing * REFINEMENT)
        counted = with_grid_error(sensors, fine, coarse, REFINEMENT, belief, last)
        self.observations[name] = replace(self.observations[name], sensors=counted)

    def predictor(self, name: str, spacing: float) -> Predictor:
        """The simulator of one sequence, fitted or not."""
        problem = self.problem(spacing)
        if name not in problem.predictors:
            widened = problem.with_ranges({**self.fitted, name: (0, 1)})
            problem.predictors[name] = widened.predictors[name]
        self._observe(name, problem.predictors[name])
        return problem.predictors[name]

    def compared_names(self, names: Sequence[str] | None = None) -> list[str]:
        """Sequences with markers and with frames to fit or to predict."""
        wanted = [s.name for s in self.capture.sequences] if names is None else list(names)
        return [
            n
            for n in wanted
            if self.capture.sequence(n).markers is not None
            and (n in self.fitted or self.unseen(n)[1] > self.unseen(n)[0])
        ]

    def unseen(self, name: str) -> tuple[int, int]:
        """Unfitted frames of a sequence: its predict range, or all its ranges when it was left out."""
        recording = self.capture.sequence(name)
        if name in self.fitted or recording.fit[1] <= recording.fit[0]:
            return recording.predict
        used = [r for r in (recording.fit, recording.predict) if r[1] > r[0]]
        return (min(a for a, _ in used), max(b for _, b in used))

    def with_release(self, belief: Belief, name: str, spacing: float) -> Belief:
        """The belief with the release, or the measured start, of a sequence that was not fitted found from
        its own first frames."""
        own = [p.key for p in belief.parameters if of_sequence(p) == name]
        if name in self.fitted or not own:
            return belief
        first, last = self.unseen(name)
        if last <= first:
            first, last = 0, self.capture.sequence(name).frames
        problem = self.problem(spacing)
        self.predictor(name, spacing)
        window = Problem(
            self.capture,
            problem.settings,
            {name: (first, min(last, first + OWN_FRAMES))},
            self.observations,
            problem.predictors,
        )
        alone = replace(
            belief,
            known_mass=None,
            parameters=tuple(replace(p, free=p.key in own) for p in belief.parameters),
        )
        found = minimise(window, alone, iterations=8).belief
        for key in own:
            belief = belief.with_parameter(key, value=found[key].value)
        return belief

    def compare(
        self,
        belief: Belief,
        spacing: float,
        *,
        names: Sequence[str] | None = None,
        jacobian: bool = True,
        refine: bool = False,
        refinement_spacing: float | None = None,
        gain: float = 0.0,
        report: Callable[[str], None] | None = None,
    ) -> dict[str, Compared]:
        """Prediction beside measurement of every sequence at a fitted belief.

        refine: whether the discretisation's share is asked for; refinement_spacing: spacing of the grid that
        shows it [m], None for a finer one (see `with_refinement`); gain: of the feedback under which it is
        predicted.
        """
        out = {}
        for name in self.compared_names(names):
            if report:
                report(f"predicting {name}")
            predictor = self.predictor(name, spacing)
            fit = self.fitted.get(name, (0, 0))
            predict = self.unseen(name)
            last = max(b for a, b in (fit, predict) if b > a)
            known = self.with_release(belief, name, spacing)
            keys = [p.key for p in known.free] if jacobian else []
            pull = predictor.pulled_by(self.observations[name].position, gain) if gain else None
            prediction = predictor.predict(known, last=last, keys=keys, feedback=pull)
            total = predictor.recording.frames
            item = Compared(
                self.observations[name],
                full(prediction.position, total),
                full(prediction.jacobian, total),
                predictor.attachment.part,
                fit,
                predict,
                sensors=compared_sensors(self.observations[name].sensors, prediction, total),
            )
            out[name] = self._refined(name, item, known, spacing, refinement_spacing) if refine else item
        return out

    def with_refinement(
        self,
        compared: Mapping[str, Compared],
        belief: Belief,
        spacing: float,
        *,
        refinement_spacing: float | None = None,
    ) -> dict[str, Compared]:
        """What a belief was compared as on a grid, and the discretisation's share of it.

        refinement_spacing: spacing of the grid that shows it [m], None for a finer one.
        """
        return {
            name: self._refined(
                name, item, self.with_release(belief, name, spacing), spacing, refinement_spacing
            )
            for name, item in compared.items()
        }

    def _refined(
        self, name: str, item: Compared, belief: Belief, spacing: float, refinement_spacing: float | None
    ) -> Compared:
        other = spacing / REFINEMENT if refinement_spacing is None else refinement_spacing
        last = item.frames[1]
        prediction = self.predictor(name, other).predict(belief, last=last)
        # Richardson: the whole error is the change over 1 - r^2, r the ratio of the spacings.
        whole, total = 1.0 - (other / spacing) ** 2, len(item.predicted)
        sensors = tuple(
            replace(one, refinement=full((reading.value - one.predicted[:last]) / whole, total))
            for one, reading in zip(item.sensors, prediction.readings, strict=True)
        )
        moved = prediction.position - item.predicted[:last]
        return replace(item, refinement=full(moved / whole, total), sensors=sensors)

    def assess(self, compared: Mapping[str, Compared]) -> Assessment:
        """The statistics of a comparison."""
        names = tuple(part.name for part in self.capture.parts)
        centers = np.array([part.vertices.mean(0) for part in self.capture.parts])
        return assess(compared, names, part_centers=centers)


__all__ = ["Experiment", "Solution"]

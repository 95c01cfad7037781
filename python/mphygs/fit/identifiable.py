"""Which numbers a motion can tell: expected standard errors from tangents, before anything is fitted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from mphygs.capture.record import Sequence as Recording
from mphygs.fit.determined import SMALL, determinations, information_of, reference_std
from mphygs.fit.experiment import Experiment
from mphygs.fit.stiffness_scale import simulable
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor


@dataclass(frozen=True)
class Expected:
    """A number at the value where it was looked at. std: expected standard error, in its unit; determined:
    whether the motion tells it, note: what it tells instead."""

    value: float
    std: float
    unit: str
    determined: bool
    note: str

    def document(self) -> dict[str, object]:
        """The same as JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Identifiable:
    """belief: at which it was looked; information: (P, P) of the free coordinates, by the measurements."""

    belief: Belief
    information: np.ndarray

    @classmethod
    def of(cls, experiment: Experiment, belief: Belief) -> Identifiable:
        """What the fitted frames of an experiment tell at a belief, made stiffer where it cannot be
        simulated. Raises SimulationError where no such one can."""
        problem = experiment.problem(experiment.settings.spacing)
        moved = simulable(problem, belief)
        experiment.refer(moved)
        evaluation = problem.evaluate(moved)
        return cls(moved, information_of(evaluation, len(moved.free)))

    def expected(self, added_information: np.ndarray | None = None) -> dict[str, Expected]:
        """Every free number by key. added_information: (P, P) information of a further recording."""
        information = self.information if added_information is None else self.information + added_information
        free = self.belief.free
        reference = np.array([reference_std(p) for p in free])
        # in units of the priors, which keep it regular
        scaled = information * np.outer(reference, reference) + np.eye(len(free))
        covariance = np.linalg.inv(scaled) * np.outer(reference, reference)
        known = determinations(free, information, covariance)
        return {
            p.key: Expected(p.value, known[p.key].std, p.unit, known[p.key].determined, known[p.key].note)
            for p in free
        }

    def of_motion(self, experiment: Experiment, recording: Recording, sigma: float) -> np.ndarray | None:
        """Information (P, P) that another recording would bring, with white noise of sigma [m].

        None where it would be so violent that derivatives tell nothing of it: where markers go, or move by a
        change of a few percent, farther than the object is large. Raises SimulationError.
        """
        markers = recording.markers
        assert markers is not None
        unmeasured = replace(markers, position=np.full((recording.frames, len(markers.at), 3), np.nan))
        own = replace(recording, markers=unmeasured)
        predictor = Predictor(experiment.capture, own, experiment.settings)
        keys = [p.key for p in self.belief.free]
        found = predictor.predict(self.belief, keys=keys)
        size = experiment.capture.diagonal or 0.0
        farthest = float(np.abs(found.position - markers.at).max())
        if not max(farthest, SMALL * float(np.abs(found.jacobian).max())) < size:
            return None
        slopes = found.jacobian.reshape(-1, len(keys)) / sigma
        return slopes.T @ slopes

    def gain(self, added_information: np.ndarray) -> float:
        """How much further information shrinks the volume of what is possible [nat], priors included."""
        reference = np.array([reference_std(p) for p in self.belief.free])
        scale = np.outer(reference, reference)
        before, after = (
            np.linalg.slogdet(i * scale + np.eye(len(reference)))[1]
            for i in (self.information, self.information + added_information)
        )
        return 0.5 * float(after - before)


def expected_document(expected: Mapping[str, Expected]) -> dict[str, dict[str, object]]:
    """Expected numbers as JSON."""
    return {key: entry.document() for key, entry in expected.items()}

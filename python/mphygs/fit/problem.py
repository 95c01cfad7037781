"""The residuals of a fit: whitened markers and sensors of several sequences, priors, known mass."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import Event

import numpy as np

from mphygs.capture.format import Capture
from mphygs.compare.noise import Observation
from mphygs.compare.sensor_residuals import whitened_readings
from mphygs.compare.whitening import Whitener
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.feedback import Feedback
from mphygs.simulate.instruments import Reading
from mphygs.simulate.prediction import Maker, Predictor
from mphygs.simulate.section import mass_power, part_mass
from mphygs.simulate.settings import Settings

# Relative accuracy to which a stated mass of the whole object is held.
MASS_TOLERANCE = 2e-3


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Whitened residual (N,), Jacobian (N, P) by the free coordinates, and where the rows come from.

    slopes: the Jacobian, or what computes it once it is asked for; data_rows: rows of measurements, the
    first, markers before instruments; prior_rows: rows of priors, right behind them; rows: of the markers of
    every sequence; sensor_rows: of its instruments.
    """

    residual: np.ndarray
    slopes: np.ndarray | Callable[[], np.ndarray]
    data_rows: int
    prior_rows: int
    rows: dict[str, slice]
    positions: dict[str, np.ndarray]
    substeps: int
    sensor_rows: dict[str, slice] = field(default_factory=dict)

    @cached_property
    def jacobian(self) -> np.ndarray:
        """(N, P). Raises SimulationError where it is computed only now and the run is unstable."""
        return self.slopes() if callable(self.slopes) else self.slopes

    @property
    def cost(self) -> float:
        """Half the sum of squares, priors included."""
        return 0.5 * float(self.residual @ self.residual)

    @property
    def chi_square(self) -> float:
        """Sum of squares of the measured rows."""
        r = self.residual[: self.data_rows]
        return float(r @ r)

    @property
    def worst(self) -> str:
        """Name of the sequence that is off most, by its mean square."""
        squares = {name: self.residual[rows] ** 2 for name, rows in self.rows.items()}
        return max(squares, key=lambda name: np.mean(squares[name]) if len(squares[name]) else -1.0)

    @property
    def misfit(self) -> float:
        """Root mean square of the measured rows [sigma]."""
        return (self.chi_square / max(self.data_rows, 1)) ** 0.5


@dataclass(eq=False)
class Problem:
    """Residuals of one capture at one spacing.

    ranges: sequence name -> (first, last) frames to use; predictors are built once and shared; gain: of the
    feedback from the measurement under which everything is simulated, 0 for free runs (see `Feedback`); make:
    what makes a predictor.
    """

    capture: Capture
    settings: Settings
    ranges: Mapping[str, tuple[int, int]]
    observations: Mapping[str, Observation]
    predictors: dict[str, Predictor] = field(default_factory=dict)
    substep: float | None = None
    gain: float = 0.0
    make: Maker = Predictor

    def __post_init__(self) -> None:
        bodies: dict[bytes, object] = {}
        for name in self.ranges:
            if name in self.predictors:
                continue
            recording = self.capture.sequence(name)
            boxes = b"".join(np.asarray(hold.box, float).tobytes() for hold in recording.held)
            predictor = self.make(self.capture, recording, self.settings, body=bodies.get(boxes))
            bodies[boxes] = predictor.body
            self.predictors[name] = predictor

    def twin(self, workers: int, halt: Event | None = None) -> Problem:
        """The same problem, for another thread. workers, halt: see `Predictor.twin`."""
        settings = replace(self.settings, workers=workers)
        predictors = {name: predictor.twin(workers, halt) for name, predictor in self.predictors.items()}
        return replace(self, settings=settings, predictors=predictors)

    def narrowed(self, share: float) -> Problem:
        """The same problem on the first share of every range's frames, at least eight of them."""
        ranges = {
            n: (a, min(b, a + max(8, int(round(share * (b - a)))))) for n, (a, b) in self.ranges.items()
        }
        return replace(self, ranges=ranges)

    def with_ranges(self, ranges: Mapping[str, tuple[int, int]]) -> Problem:
        """The same problem on other frames; sequences that are new get their predictors."""
        return replace(self, ranges=ranges, predictors=dict(self.predictors))

    def under(self, gain: float) -> Problem:
        """The same problem under feedback of another gain, 0 for free runs."""
        return self if gain == self.gain else replace(self, gain=gain)

    def feedback(self, name: str) -> Feedback | None:
        """What pulls a sequence's simulation, None for a free run."""
        if self.gain == 0.0:
            return None
        return self.predictors[name].pulled_by(self.observations[name].position, self.gain)

    def whitener(self, name: str) -> Whitener:
        """That of the rows of a sequence's fitted frames."""
        return self.observations[name].whitener(*self.ranges[name])

    def stable_substep(self, belief: Belief) -> float:
        """Shortest substep that any sequence needs [s]."""
        return min(self.predictors[name].stable_substep(belief) for name in self.ranges)

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
        """Residuals (measured - predicted, whitened) and their Jacobian.

        jacobian: whether it is computed now, with the motion, and not once it is asked for. Raises
        SimulationError where a run is unstable or the rest shape cannot be solved for.
        """
        keys = tuple(p.key for p in belief.free) if jacobian else ()
        predictions = {
            name: self.predictors[name].predict(
                belief, last=last, keys=keys, substep=self.substep, feedback=self.feedback(name)
            )
            for name, (_, last) in self.ranges.items()
        }
        evaluation = self.evaluated(
            belief,
            {name: prediction.position for name, prediction in predictions.items()},
            {name: prediction.jacobian for name, prediction in predictions.items()} if jacobian else None,
            readings={name: prediction.readings for name, prediction in predictions.items()},
            substeps=sum(prediction.substeps for prediction in predictions.values()),
        )
        if jacobian:
            return evaluation
        # Of what is observed now: measurements may be left out before the Jacobian is asked for.
        now = replace(self, observations=dict(self.observations))
        return replace(evaluation, slopes=lambda: now.evaluate(belief).jacobian)

    def evaluated(
        self,
        belief: Belief,
        positions: Mapping[str, np.ndarray],
        jacobians: Mapping[str, np.ndarray] | None,
        *,
        readings: Mapping[str, Sequence[Reading]] | None = None,
        substeps: int = 0,
    ) -> Evaluation:
        """Residuals and Jacobian at a belief whose prediction is known.

        positions: sequence -> (T, M, 3) [m], from the first frame to the last of its range or beyond;
        jacobians: (T, M, 3, P) by the free coordinates, None for zeros; readings: what the sequences'
        instruments read, with or without derivatives as the markers are. Raises SimulationError where a
        prediction is not finite, ValueError where sensors have no readings.
        """
        residuals, slopes, rows, count = [], [], {}, 0
        for name, (first, last) in self.ranges.items():
            observation = self.observations[name]
            window = slice(first, last)
            whitener = self.whitener(name)
            difference = np.nan_to_num(observation.position[window] - positions[name][window])
            residuals.append(whitener.whiten(difference))
            if jacobians is not None:
                slopes.append(-whitener.whiten(jacobians[name][window]))
            rows[name] = slice(count, count + len(residuals[-1]))
            count += len(residuals[-1])
        sensor_rows = {}
        for name, (first, last) in self.ranges.items():
            sensors = self.observations[name].sensors
            if not sensors:
                continue
            own = (readings or {}).get(name, ())
            residual, slope = whitened_readings(sensors, own, first, last)
            residuals.append(residual)
            if jacobians is not None:
                slopes.append(-slope)
            sensor_rows[name] = slice(count, count + len(residual))
            count += len(residual)
        prior, prior_slope = self.prior_rows(belief)
        residual = np.concatenate([*residuals, prior])
        full = np.zeros((len(residual), len(belief.free)))
        if slopes:
            full[:count] = np.concatenate(slopes)
        full[count:] = prior_slope
        if not np.isfinite(residual).all():
            raise SimulationError("the prediction is not finite")
        priors = len(belief.free) + len(belief.likenesses)
        return Evaluation(residual, full, count, priors, rows, dict(positions), substeps, sensor_rows)

    def prior_rows(self, belief: Belief) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (R,) of the priors and of the stated mass, and their Jacobian (R, P)."""
        prior = np.array([p.prior_residual for p in belief.free]).reshape(-1, 2)
        residual, slope = belief.likeness_rows()
        return self._with_mass(
            belief, np.r_[prior[:, 0], residual], np.concatenate([np.diag(prior[:, 1]), slope])
        )

    def _with_mass(
        self, belief: Belief, residual: np.ndarray, jacobian: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The stated mass of the whole object as one more measurement."""
        if belief.known_mass is None:
            return residual, jacobian
        parts = {part.name: part for part in self.capture.parts if part.name in belief.parts}
        masses = {name: part_mass(belief, part) for name, part in parts.items()}
        scale = 1.0 / (MASS_TOLERANCE * belief.known_mass)
        row = np.array(
            [
                sum(masses[name] * mass_power(p, part) * scale for name, part in parts.items())
                for p in belief.free
            ]
        )
        return np.append(residual, (sum(masses.values()) - belief.known_mass) * scale), np.vstack(
            [jacobian, row]
        )

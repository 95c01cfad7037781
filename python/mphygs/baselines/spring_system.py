"""Points joined by springs: their motion, and the gradient of a loss on it by an adjoint run.

Springs, damping and the weights of far ones after Zhong et al., "Reconstruction and simulation of elastic
objects with spring-mass 3D Gaussians" (2024): along a spring of rest length L the force is
(l - L) K sqrt(1 + |l / L - 1|), K = 10^k / L with k of the point that it belongs to; every point has springs
to its nearest, the first few whole, the others by a weight that one number for all softens. Masses are 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from mphygs.simulate.errors import SimulationError

# Springs of a point, and those of them that always count whole.
SPRINGS, WHOLE = 24, 12
# Of the longest stable step.
SAFETY = 0.8
# A spring shorter than this share of its length at rest has no direction.
SHORTEST = 1e-3
# Beyond so many sizes of the object a point has left it.
FARTHEST = 20.0


@dataclass(frozen=True, eq=False)
class Springs:
    """first: (S,) the point that a spring belongs to; apart: (S, 3) from it to the other one at rest [m];
    length: (S,) [m]; rank: (S,) of those that are not whole, their place among the point's, up to 1, 0 for
    whole ones; across: (S, n) sparse, the other point less the first."""

    first: np.ndarray
    apart: np.ndarray
    length: np.ndarray
    rank: np.ndarray
    across: csr_matrix

    @classmethod
    def of(cls, rest: np.ndarray) -> Springs:
        """Between points (n, 3) at rest [m], two at least."""
        count = min(SPRINGS, len(rest) - 1)
        _, index = cKDTree(rest).query(rest, count + 1)
        first, second = np.repeat(np.arange(len(rest)), count), index[:, 1:].ravel()
        beyond = np.maximum(np.tile(np.arange(count), len(rest)) - WHOLE + 1, 0)
        rows = np.tile(np.arange(len(first)), 2)
        sign = np.r_[-np.ones(len(first)), np.ones(len(first))]
        across = csr_matrix((sign, (rows, np.r_[first, second])), shape=(len(first), len(rest)))
        apart = rest[second] - rest[first]
        length = np.linalg.norm(apart, axis=1)
        return cls(first, apart, length, beyond / max(count - WHOLE, 1), across)

    def stiffness(self, k: np.ndarray, softness: float) -> np.ndarray:
        """(S,) K of every spring, its weight included [1/s^2]. k: (n,)."""
        return 10.0 ** k[self.first] / self.length * np.clip(2.0 - self._power(softness), 0.0, 1.0)

    def _power(self, softness: float) -> np.ndarray:
        return np.exp(np.logaddexp(0.0, softness) * self.rank)

    def stiffness_slopes(
        self, k: np.ndarray, softness: float, bar: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Gradient by k (n,) and by the softness, for that by the stiffness, (S,)."""
        own = bar * self.stiffness(k, softness) * np.log(10.0)
        power = self._power(softness)
        moved = np.where(power < 2.0, -power * self.rank / (1.0 + np.exp(-softness)), 0.0)
        by_softness = np.sum(bar * 10.0 ** k[self.first] / self.length * moved)
        return np.bincount(self.first, own, minlength=len(k)), float(by_softness)

    def longest_step(self, stiffness: np.ndarray, damping: float) -> float:
        """Longest step that is stable about rest [s]: squared frequencies, and damping rates, are below twice
        the largest of the sums of a point's springs."""
        direction = self.apart / self.length[:, None]
        block = stiffness[:, None] * (direction[:, :, None] * direction[:, None]).reshape(-1, 9)
        ends = abs(self.across).T
        rate = 2.0 * float(np.linalg.eigvalsh((ends @ block).reshape(-1, 3, 3)).max())
        friction = 2.0 * float((ends @ (damping / self.length)).max())
        return SAFETY * (-friction + np.sqrt(friction**2 + 4.0 * rate)) / rate


@dataclass(frozen=True, eq=False)
class Course:
    """What a run is given. steps: (F,) to each interval, dt: (F,) [s]; held: (n,) bool points whose places
    are given, carried: (S + 1, H, 3) [m] at all steps; pull: (F, n, 3) acceleration from outside [m/s^2]."""

    steps: np.ndarray
    dt: np.ndarray
    held: np.ndarray
    carried: np.ndarray
    pull: np.ndarray


@dataclass(eq=False)
class SpringRun:
    """Places [m] and velocities [m/s] at all steps, (S + 1, n, 3), by semi-implicit Euler steps."""

    springs: Springs
    stiffness: np.ndarray
    damping: float
    course: Course
    place: np.ndarray
    velocity: np.ndarray

    @classmethod
    def of(
        cls, springs: Springs, stiffness: np.ndarray, damping: float, course: Course,
        place: np.ndarray, velocity: np.ndarray,
    ) -> SpringRun:  # fmt: skip
        """The run from places [m] and velocities [m/s], (n, 3). Raises SimulationError where it diverges."""
        count = int(course.steps.sum())
        run = cls(springs, stiffness, damping, course, *np.empty((2, count + 1, *place.shape)))
        run.place[0], run.velocity[0] = place, velocity
        limit = FARTHEST * float(np.linalg.norm(np.ptp(place, axis=0)))
        limit += float(np.abs(course.carried).max(initial=0.0))
        with np.errstate(over="ignore", invalid="ignore"):  # what diverges is noticed
            run._go_through(limit)
        return run

    def _go_through(self, limit: float) -> None:
        course, start = self.course, self.place[0]
        free, back = ~course.held, self.springs.across.T.tocsr()
        carried, step = course.carried, 0
        for interval, (steps, dt) in enumerate(zip(course.steps, course.dt, strict=True)):
            for _ in range(steps):
                x, v = self.place[step], self.velocity[step]
                push = course.pull[interval] - back @ self._forces(x, v)
                self.velocity[step + 1, free] = v[free] + dt * push[free]
                self.place[step + 1, free] = x[free] + dt * self.velocity[step + 1, free]
                self.place[step + 1, course.held] = carried[step + 1]
                self.velocity[step + 1, course.held] = (carried[step + 1] - carried[step]) / dt
                step += 1
            if not np.abs(self.place[step] - start).max() < limit:
                raise SimulationError("springs: the motion diverges")

    @property
    def frames(self) -> np.ndarray:
        """(F + 1,) steps at the start and at the ends of the intervals."""
        return np.r_[0, np.cumsum(self.course.steps)]

    def _stretched(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """Direction (S, 3), length [m], stretch and its root (S,) of all springs."""
        d = self.springs.across @ x
        rest = self.springs.length
        length = np.maximum(np.sqrt(np.einsum("sc,sc->s", d, d)), SHORTEST * rest)
        stretch = length / rest - 1.0
        return d / length[:, None], length, stretch, np.sqrt(1.0 + np.abs(stretch))

    def _forces(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(S, 3) force of each spring on its second point, with the other sign [m/s^2]."""
        direction, length, stretch, root = self._stretched(x)
        along = -self.stiffness * stretch * self.springs.length * root
        slowed = (self.damping / self.springs.length)[:, None] * (self.springs.across @ v)
        return -(along[:, None] * direction) + slowed

    def gradient(self, bar: np.ndarray) -> tuple[np.ndarray, float]:
        """Gradient by the stiffness (S,) and by the damping, of a loss whose derivative by the places at
        `frames` is bar, (F + 1, n, 3)."""
        springs, rest, course = self.springs, self.springs.length, self.course
        back = springs.across.T.tocsr()
        by_stiffness, by_damping = np.zeros_like(self.stiffness), 0.0
        x_bar, v_bar = np.zeros((2, *self.place.shape[1:]))
        step = len(self.place) - 1
        for interval in range(len(course.steps) - 1, -1, -1):
            x_bar = x_bar + bar[interval + 1]
            dt = course.dt[interval]
            for _ in range(course.steps[interval]):
                step -= 1
                x_bar[course.held] = v_bar[course.held] = 0.0
                v_bar = v_bar + dt * x_bar
                f_bar = -(springs.across @ (dt * v_bar))
                x, v = self.place[step], self.velocity[step]
                direction, length, stretch, root = self._stretched(x)
                away = stretch * rest
                along = np.einsum("sc,sc->s", f_bar, direction)
                by_stiffness += along * away * root
                slope = self.stiffness * (root + 0.5 * np.abs(stretch) / root)
                across = self.stiffness * away * root / length
                d_bar = across[:, None] * f_bar + ((slope - across) * along)[:, None] * direction
                slowed = (self.damping / rest)[:, None]
                by_damping += float(np.sum(f_bar * (springs.across @ v) / rest[:, None]))
                x_bar = x_bar + back @ d_bar
                v_bar = v_bar + back @ (slowed * f_bar)
        return by_stiffness, by_damping

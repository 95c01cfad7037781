"""Points joined by springs: their motion, and the gradient of a loss on it by an adjoint run.

Springs, damping and the weights of far ones after Zhong et al., "Reconstruction and simulation of elastic
objects with spring-mass 3D Gaussians" (2024): along a spring of rest length L the force is
(l - L) K sqrt(1 + |l / L - 1|), K = 10^k / L with k of the point that it belongs to; every point has springs
to its nearest, the first few whole, the others by a weight that one number for all softens. Masses are 1.
Forces are linear in K and in the damping, so two springs between the same two points are computed as one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from mphygs.simulate.errors import SimulationError

# Springs of a point, and those of them that always count whole.
SPRINGS, WHOLE = 24, 12
# Of the longest stable step about rest: springs that are stretched by two thirds are stable as well.
SAFETY = 0.8
# A spring shorter than this share of its length at rest has no direction.
SHORTEST = 1e-3
# Beyond so many sizes of the object a point has left it.
FARTHEST = 20.0


@dataclass(frozen=True, eq=False)
class Springs:
    """Of S springs: first: (S,) the point that each belongs to; rank: (S,) of those that are not whole, their
    place among the point's, up to 1, 0 for whole ones; pair: (S,) the pair of points that it joins.
    Of P pairs: ends: (P, 2) points; apart: (P, 3) from one to the other at rest [m]; length: (P,) [m]; count:
    (P,) springs of each; across: (P, n) sparse, one point less the other."""

    first: np.ndarray
    rank: np.ndarray
    pair: np.ndarray
    ends: np.ndarray
    apart: np.ndarray
    length: np.ndarray
    count: np.ndarray
    across: csr_matrix

    @classmethod
    def of(cls, rest: np.ndarray) -> Springs:
        """Between points (n, 3) at rest [m], two at least."""
        count = min(SPRINGS, len(rest) - 1)
        _, index = cKDTree(rest).query(rest, count + 1)
        first, second = np.repeat(np.arange(len(rest)), count), index[:, 1:].ravel()
        beyond = np.maximum(np.tile(np.arange(count), len(rest)) - WHOLE + 1, 0)
        both = np.sort(np.stack([first, second], axis=1), axis=1)
        ends, pair, shared = np.unique(both, axis=0, return_inverse=True, return_counts=True)
        rows = np.tile(np.arange(len(ends)), 2)
        sign = np.r_[-np.ones(len(ends)), np.ones(len(ends))]
        across = csr_matrix((sign, (rows, ends.T.ravel())), shape=(len(ends), len(rest)))
        apart = rest[ends[:, 1]] - rest[ends[:, 0]]
        rank, length = beyond / max(count - WHOLE, 1), np.linalg.norm(apart, axis=1)
        return cls(first, rank, pair.ravel(), ends, apart, length, shared, across)

    def stiffness(self, k: np.ndarray, softness: float) -> np.ndarray:
        """(P,) K of the springs of every pair, their weights included [1/s^2]. k: (n,)."""
        return np.bincount(self.pair, self._own(k) * np.clip(2.0 - self._power(softness), 0.0, 1.0))

    def _own(self, k: np.ndarray) -> np.ndarray:
        """(S,) K of every spring that is whole."""
        return 10.0 ** k[self.first] / self.length[self.pair]

    def _power(self, softness: float) -> np.ndarray:
        return np.exp(np.logaddexp(0.0, softness) * self.rank)

    def stiffness_slopes(self, k: np.ndarray, softness: float, bar: np.ndarray) -> tuple[np.ndarray, float]:
        """Gradient by k (n,) and by the softness, for that by the stiffness, (P,)."""
        own, power = bar[self.pair] * self._own(k), self._power(softness)
        by_k = own * np.clip(2.0 - power, 0.0, 1.0) * np.log(10.0)
        moved = np.where(power < 2.0, -power * self.rank / (1.0 + np.exp(-softness)), 0.0)
        return np.bincount(self.first, by_k, minlength=len(k)), float(np.sum(own * moved))

    def friction(self, damping: float) -> np.ndarray:
        """(P,) damping of the springs of every pair [1/s]."""
        return damping * self.count / self.length

    def longest_step(self, stiffness: np.ndarray, damping: float) -> float:
        """Longest step that is stable about rest [s], by the largest squared frequency and damping rate. They
        are those of free points, which holding some of them does not raise."""
        direction = self.apart / self.length[:, None]
        rate = self._largest(stiffness[:, None, None] * direction[:, :, None] * direction[:, None])
        friction = self._largest(self.friction(damping)[:, None, None])
        return SAFETY * (-friction + np.sqrt(friction**2 + 4.0 * rate)) / rate

    def _largest(self, block: np.ndarray) -> float:
        """Largest eigenvalue of the matrix that has block (P, c, c) between the ends of every pair."""
        points, size = self.across.shape[1], block.shape[1]
        matrix = np.zeros((points, points, size, size))
        one, other = self.ends.T
        for row, column, sign in ((one, one, 1), (other, other, 1), (one, other, -1), (other, one, -1)):
            np.add.at(matrix, (row, column), sign * block)
        whole = matrix.swapaxes(1, 2).reshape(points * size, points * size)
        return float(eigh(whole, eigvals_only=True, subset_by_index=[len(whole) - 1] * 2)[0])


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

    @cached_property
    def _friction(self) -> np.ndarray:
        return self.springs.friction(self.damping)[:, None]

    @property
    def frames(self) -> np.ndarray:
        """(F + 1,) steps at the start and at the ends of the intervals."""
        return np.r_[0, np.cumsum(self.course.steps)]

    def _stretched(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """Direction (P, 3), length [m], stretch and its root (P,) of all pairs."""
        d = self.springs.across @ x
        rest = self.springs.length
        length = np.maximum(np.sqrt(np.einsum("sc,sc->s", d, d)), SHORTEST * rest)
        stretch = length / rest - 1.0
        return d / length[:, None], length, stretch, np.sqrt(1.0 + np.abs(stretch))

    def _forces(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(P, 3) force of each pair's springs on its second point, with the other sign [m/s^2]."""
        direction, length, stretch, root = self._stretched(x)
        along = -self.stiffness * stretch * self.springs.length * root
        slowed = self._friction * (self.springs.across @ v)
        return -(along[:, None] * direction) + slowed

    def gradient(self, bar: np.ndarray) -> tuple[np.ndarray, float]:
        """Gradient by the stiffness (P,) and by the damping, of a loss whose derivative by the places at
        `frames` is bar, (F + 1, n, 3)."""
        springs, rest, course = self.springs, self.springs.length, self.course
        back = springs.across.T.tocsr()
        slowed, alone = self._friction, springs.friction(1.0)[:, None]
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
                by_damping += float(np.sum(f_bar * (springs.across @ v) * alone))
                x_bar = x_bar + back @ d_bar
                v_bar = v_bar + back @ (slowed * f_bar)
        return by_stiffness, by_damping

"""What the markers of one sequence say of a force field: residual, exact gradient, approximate Hessian."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mphygs.compare.noise import Observation
from mphygs.compare.whitening import Whitener
from mphygs.diagnose.missing_force_basis import ForceBasis, force_basis
from mphygs.model.belief import Belief
from mphygs.simulate.fields import core_inputs
from mphygs.simulate.forced_motion import ForcedMotion, ForcedSequence
from mphygs.simulate.modes import Modes, natural_modes
from mphygs.simulate.prediction import Predictor

MODES = 48


@dataclass(frozen=True, eq=False)
class SeenForce:
    """One sequence over frames first to last - 1."""

    name: str
    forced: ForcedSequence
    basis: ForceBasis
    observation: Observation
    first: int

    @classmethod
    def of(
        cls, name: str, predictor: Predictor, belief: Belief, observation: Observation, span: tuple[int, int]
    ) -> SeenForce:
        """span: first and last frame + 1."""
        forced = ForcedSequence(predictor, span[1])
        q, model = predictor.body.quadrature, forced.model(belief)
        node, weight, _ = model.weights(q.points.reshape(-1, 3), predictor.body.point_cell)
        mass = core_inputs(belief, predictor.body)["mass"]
        moving = forced.timeline(belief).moving
        basis = force_basis(predictor.body, mass, node, weight, model.node_count, moving)
        return cls(name, forced, basis, observation, span[0])

    @property
    def last(self) -> int:
        """The last frame + 1."""
        return self.forced.last

    @property
    def whitener(self) -> Whitener:
        """Whitening of the frames in use."""
        return self.observation.whitener(self.first, self.last)

    def until(self, last: int) -> SeenForce:
        """The same with fewer frames."""
        return replace(self, forced=ForcedSequence(self.forced.predictor, last))

    def run(self, belief: Belief, values: np.ndarray) -> tuple[ForcedMotion, np.ndarray]:
        """The motion with a force, and the whitened residual (measured - predicted), (N,)."""
        motion = self.forced.run(belief, self.basis.forces(values)[: self.last])
        return motion, self.whitened(motion.position, measured=True)

    def whitened(self, array: np.ndarray, *, measured: bool = False) -> np.ndarray:
        """L^-1 of (T, M, 3, ...) [m] over the frames in use; of measured - array where asked."""
        window = slice(self.first, self.last)
        array = array[window]
        if measured:
            array = np.nan_to_num(self.observation.position[window] - array)
        return self.whitener.whiten(array)

    def gradient(
        self, motion: ForcedMotion, residual: np.ndarray, keys: list[str]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Exact gradient of half the residual's square by the values (H, C, 3) and coordinates (K,)."""
        bar = np.zeros_like(motion.position)
        bar[self.first :] = -self.whitener.whiten_transposed(residual)
        force_bar, slopes = self.forced.gradient(motion, bar, keys)
        return self.basis.pulled(force_bar), slopes


@dataclass(frozen=True, eq=False)
class Channels:
    """The markers' view of a body's modes: as many numbers a frame as modes, whitened like the markers.

    shown: (M,) weight of every free marker; basis: (3 M, k) orthonormal; mix: (k, m) of amplitudes,
    k the less of 3 M and m.
    """

    seen_force: SeenForce
    modes: Modes
    shown: np.ndarray
    basis: np.ndarray
    mix: np.ndarray

    @classmethod
    def of(cls, seen_force: SeenForce, belief: Belief) -> Channels:
        """Of the natural modes at a belief."""
        predictor = seen_force.forced.predictor
        modes = natural_modes(predictor, belief, MODES)
        carriers = predictor.carriers
        free, node, value = carriers.free, carriers.index, carriers.value
        observed = seen_force.observation.observed[seen_force.first : seen_force.last, free]
        shown = np.sqrt(observed.mean(0))
        markers = np.einsum("mk,mkcj->mcj", value, modes.shape[node]) * shown[:, None, None]
        return cls(seen_force, modes, shown, *np.linalg.qr(markers.reshape(-1, len(modes.squared))))

    def of_forces(self, motion: ForcedMotion) -> np.ndarray:
        """(N', H C 3) whitened channels by the values of the force."""
        basis = self.seen_force.basis
        moving = motion.timeline.moving
        cells = np.einsum("ncj,nk->jkc", self.modes.shape, basis.spread)
        forces = np.einsum("fh,jkc->fjhkc", basis.hats[moving], cells)
        return self._shown(motion, forces.reshape(len(moving), len(self.modes.squared), -1))

    def of_node_forces(self, motion: ForcedMotion, forces: np.ndarray) -> np.ndarray:
        """(N', K) whitened channels by forces (T, N, 3, K) [N]."""
        moving = motion.timeline.moving
        return self._shown(motion, np.einsum("ncj,tnck->tjk", self.modes.shape, forces[moving]))

    def _shown(self, motion: ForcedMotion, modal: np.ndarray) -> np.ndarray:
        amplitude = self.modes.response(modal, motion.spans)
        full = np.zeros((len(motion.timeline.frames), *amplitude.shape[1:]))
        full[motion.timeline.moving] = amplitude[1:]
        return self._whitened(np.einsum("ij,tjk->tik", self.mix, full))

    def of_markers(self, change: np.ndarray) -> np.ndarray:
        """(N', K) whitened channels of a change of the marker positions, (T, M, 3, K)."""
        free = self.seen_force.forced.predictor.attachment.hold < 0
        moved = change[:, free] * self.shown[:, None, None]
        flat = moved.reshape(len(moved), -1, change.shape[-1])
        return self._whitened(np.einsum("am,tak->tmk", self.basis, flat))

    def _whitened(self, channels: np.ndarray) -> np.ndarray:
        window = channels[self.seen_force.first : self.seen_force.last]
        noise = self.seen_force.observation.noise
        typical = replace(
            noise, sigma=np.median(noise.sigma), correlated_share=np.median(noise.correlated_share),
            common_sigma=np.asarray(0.0),
        )  # fmt: skip
        course = self.seen_force.observation.frames_of_noise[self.seen_force.first : self.seen_force.last]
        whitener = Whitener(typical, np.ones(window.shape[:2], bool), 1, course)
        return whitener.whiten(window[:, :, None])


def curvature(
    channels: Channels, motion: ForcedMotion, keys: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Approximate J^T J by the values and the coordinates of `keys`, (U + K, U + K), and the exact whitened
    change of the markers by the coordinates, (N, K)."""
    seen_force = channels.seen_force
    by_force = channels.of_forces(motion)
    change = seen_force.forced.tangents(motion, keys=keys)
    exact = seen_force.whitened(change)
    through = channels.of_markers(change)
    columns = np.hstack([by_force, through])
    matrix = columns.T @ columns
    # What the modes do not show of the parameters is theirs alone.
    size, vectors = np.linalg.eigh(exact.T @ exact - through.T @ through)
    matrix[by_force.shape[1] :, by_force.shape[1] :] += (vectors * np.maximum(size, 0.0)) @ vectors.T
    return matrix, exact

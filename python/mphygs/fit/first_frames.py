"""Whether a motion begins at rest, as its first frames show, and from which state where it does not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as fisher

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.body import hold_boxes
from mphygs.simulate.measured_start import start_keys, start_numbers
from mphygs.simulate.start_shapes import HeldAt, StartOnGrid, StartShapes, start_shapes

# Frames that the state is read off: the fewest that a cubic leaves something over.
FRAMES = 5
# Chance of taking a motion that begins at rest for one that does not, by its places and by its speeds.
LEVEL = 1e-4
# So many standard errors of a marker, root mean square: what is less is not worth numbers of its own.
SIZE = 2.0
# Steps of Gauss and Newton from the linear shapes to the bent ones; the least share of one that is gone, and
# of the amplitudes that is worth another.
STEPS, SHORTEST, ACCURACY = 20, 1e-2, 1e-4


@dataclass(frozen=True, eq=False)
class FirstState:
    """amplitude: (m,) [m] and speed: (m,) [m/s] of the m slowest shapes in frame 0; away: how far the markers
    are from rest there, moving: how far they go in a frame, root mean squares [sigma]; at_rest: whether that
    is no more than noise; largest [m], fastest [m/s]: that any marker is ever seen to go."""

    amplitude: np.ndarray
    speed: np.ndarray
    away: float
    moving: float
    at_rest: bool
    largest: float
    fastest: float


def start_parameters(capture: Capture, recording: Recording) -> list[Parameter]:
    """Amplitudes and speeds of the slowest shapes in frame 0, as the first frames show them; none for a
    motion that begins at rest.

    Raises ValueError where a start is stated as measured and the first frames show too little of it.
    """
    if recording.release is not None or recording.start == "rest":
        return []
    if recording.start is None and _still(recording):
        return []
    state = first_state(capture, recording)
    if state is None:
        if recording.start is None:
            return []
        raise ValueError(
            f"sequence '{recording.name}': its start is measured, but no marker on free material is seen in "
            f'all of its first {FRAMES} frames; expected some, or "start": "rest"'
        )
    if recording.start is None and state.at_rest:
        return []
    count = len(state.amplitude)
    # No shape carries the body further, or faster, than it was ever seen to go, to speak of.
    sizes = [(state.largest, "m")] * count + [(state.fastest, "m/s")] * count
    return [
        Parameter(key, float(value), unit, prior_mean=0.0, prior_std=2.0 * size, scale=size)
        for key, value, (size, unit) in zip(
            start_keys(recording.name, count), np.r_[state.amplitude, state.speed], sizes, strict=True
        )
    ]


def starts_document(capture: Capture, belief: Belief) -> dict[str, dict[str, object]]:
    """By sequence that does not begin at rest: how its start came to be measured, and what its first frames
    show, in standard deviations of the noise."""
    found = {}
    for recording in capture.sequences:
        if start_numbers(belief, recording.name) is not None:
            state = first_state(capture, recording)
            found[recording.name] = {
                "start": "measured",
                "stated": recording.start is not None,
                "away": state.away,
                "moving": state.moving,
            }
    return found


def starts_text(capture: Capture, belief: Belief) -> list[str]:
    """A line for every sequence whose start was found to be measured, and not stated."""
    return [
        f"{name}: frame 0 is {told['away']:.0f} sigma away from rest and moves by {told['moving']:.0f} sigma "
        'a frame: its start is measured, and fitted ("start": "rest" in capture.json denies it)'
        for name, told in starts_document(capture, belief).items()
        if not told["stated"]
    ]


def _still(recording: Recording) -> bool:
    """Whether all markers are within noise of their places at rest in the first frames."""
    markers = recording.markers
    if markers is None:
        return True
    position = np.asarray(markers.position[:FRAMES], float)
    times = np.arange(len(position)) / recording.fps
    if recording.held:
        rotation, shift = recording.held[0].poses(times, recording.fps)
        position = (position - shift[:, None]) @ rotation
    spread = markers.each
    squares = ((position - markers.at) / spread[:, None]) ** 2
    seen = np.isfinite(squares)
    return bool(np.sum(squares[seen]) < chi2.isf(LEVEL, max(int(seen.sum()), 1)))


@lru_cache(maxsize=64)
def first_state(capture: Capture, recording: Recording) -> FirstState | None:
    """What the first frames of a recording show, None where they show too little to tell.

    Away from rest: by shapes of the body, beyond the scatter of markers that stand elsewhere than stated; or
    by anything that is hardly there in a later frame, as what a marker's place is wrong by would be. A wrong
    scale of the lengths is neither. Moving: a motion from rest is even in time as long as nothing brakes it,
    an odd part is a speed that it began with; frames too far apart for a quartic show none.
    """
    if recording.markers is None or recording.frames <= FRAMES:
        return None
    first = _Markers(capture, recording)
    if not len(first.rest):
        return None
    frame = np.arange(float(FRAMES))[:, None]
    even = frame ** [0, 1, 2, 4, 6]
    sigma = np.repeat(first.sigma, 3)
    columns, scale = first.columns / sigma[:, None], first.rest.ravel() / sigma
    # What one marker alone says, the farthest, may be that it does not follow the body.
    kept = np.ones(len(sigma), bool)
    if len(first.rest) > 2:
        farthest = int(np.argmax(np.linalg.norm(first.displaced[0], axis=1)))
        kept[3 * farthest : 3 * farthest + 3] = False
    tests = []
    for k, functions in enumerate((even[:, :4], even)):
        value, size = _read_off(functions, first.displaced[:FRAMES])
        vector = value[k].ravel() / (size[k] * sigma)
        tests.append(_Nested.of(vector[kept], columns[kept], scale[kept]))
    count = max(1, int(np.argmin(sum(test.price for test in tests))))
    cubic, _ = _read_off(frame ** np.arange(4), first.displaced[:FRAMES])
    amplitude, speed = first.bent(count, cubic[0], cubic[1] * recording.fps)
    beyond = np.linalg.qr(even[:, :4], mode="complete")[0][:, 4]
    left = np.einsum("f,fmc->mc", beyond, first.displaced[:FRAMES]).ravel() / sigma
    shaped = np.linalg.qr(columns[:, :count])[0].T @ left
    resolved = shaped @ shaped < chi2.isf(LEVEL, count)
    off = tests[0].significant(count) or first.returns()
    at_rest = not off and not (resolved and tests[1].significant(count))
    moved = [first.columns[:, :count] @ a / sigma for a in (amplitude, speed / recording.fps)]
    away, moving = (float(np.sqrt(np.mean(m**2))) for m in moved)
    gone = np.linalg.norm(np.diff(first.displaced, axis=0), axis=2) * recording.fps
    return FirstState(
        amplitude,
        speed,
        away,
        moving,
        at_rest,
        float(np.nanmax(np.linalg.norm(first.displaced, axis=2))),
        float(np.nanmax(gone)),
    )


def _read_off(powers: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (K, M, 3) of functions of time (F, K) in tracks (F, M, 3), and the standard deviation (K,)
    of each for noise of one."""
    inverse = np.linalg.pinv(powers)
    return np.einsum("kf,fmc->kmc", inverse, first), np.linalg.norm(inverse, axis=1)


@dataclass(frozen=True, eq=False)
class _Nested:
    """Regressions of one vector on the 0 to K slowest shapes: left, (K + 1,) sums of squares; price: (K + 1,)
    twice the negative logarithm of the likelihood, and two for each shape: one left out bends materials, one
    too many costs time."""

    left: np.ndarray
    price: np.ndarray
    size: int

    @classmethod
    def of(cls, vector: np.ndarray, columns: np.ndarray, scale: np.ndarray) -> _Nested:
        """vector: (N,), with noise of one and what scatter there is; scale: (N,) column that is no shape."""
        size = len(vector)
        most = min(columns.shape[1], (size - 1) // 2)
        basis = np.linalg.qr(np.concatenate([scale[:, None], columns[:, :most]], axis=1))[0]
        left = vector @ vector - np.cumsum((basis.T @ vector) ** 2)
        variance = np.maximum(left / size, 1.0)
        price = size * np.log(variance) + left / variance + 2.0 * np.arange(most + 1)
        return cls(left, price, size)

    def significant(self, count: int) -> bool:
        """Whether `count` shapes take away more than noise and scatter let them, and more than SIZE."""
        rest = self.size - count - 1
        ratio = (self.left[0] - self.left[count]) / count / max(self.left[count] / rest, 1.0)
        large = self.left[0] - self.left[count] > SIZE**2 * self.size
        return bool(large and fisher.sf(ratio, count, rest) < LEVEL)


class _Markers:
    """Markers on free material that the first frames show, in the frame of the first hold.

    rest: (M, 3) [m]; displaced: (T, M, 3) from there [m]; sigma: (M,) [m]; columns: (3 M, K) of the shapes.
    """

    def __init__(self, capture: Capture, recording: Recording) -> None:
        boxes = hold_boxes(recording)
        self.shapes: StartShapes = start_shapes(capture, boxes)
        markers, body = recording.markers, self.shapes.body
        attachment = body.attach(markers.at)
        position = np.asarray(markers.position, float)
        used = np.isfinite(position[:FRAMES]).all((0, 2)) & (attachment.hold < 0)
        self._offset = attachment.offset[used]
        weights = self.shapes.model.weights(attachment.anchor[used], attachment.cell[used])
        self._node, self._value, self._gradient = weights
        self.rest = markers.at[used]
        if recording.held:
            times = np.arange(recording.frames) / recording.fps
            rotation, shift = recording.held[0].poses(times, recording.fps)
            position = (position - shift[:, None]) @ rotation
        self.displaced = position[:, used] - self.rest
        self.sigma = markers.each[used]
        self.columns = np.stack([self._of(s).ravel() for s in np.moveaxis(self.shapes.shape, 2, 0)], axis=1)

    def returns(self) -> bool:
        """Whether the markers are away from rest in frame 0 and later come twice as near to it or nearer."""
        whitened = (self.displaced / self.sigma[:, None]).reshape(len(self.displaced), -1)
        scale = (self.rest / self.sigma[:, None]).ravel()
        seen = np.isfinite(whitened).all(1)
        left = whitened[seen] - np.outer(whitened[seen] @ scale, scale) / (scale @ scale)
        square = (left**2).sum(1)
        return bool(square[0] > max(4.0 * square.min(), chi2.isf(LEVEL, len(scale))))

    def _of(self, field: np.ndarray) -> np.ndarray:
        """(M, 3) of the markers, for a displacement (N, 3) of the nodes: what stands off turns with it."""
        near = field[self._node]
        slope = np.einsum("mnj,mnc->mcj", self._gradient, near)
        return np.einsum("mn,mnc->mc", self._value, near) + np.einsum("mcj,mj->mc", slope, self._offset)

    def bent(self, count: int, place: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Amplitudes and speeds of the `count` slowest shapes, bent, nearest to displacements [m] and
        velocities [m/s] (M, 3) of the markers."""
        grid, sigma = StartOnGrid(self.shapes, self.shapes.body), np.repeat(self.sigma, 3)
        still, none = HeldAt.of((), 0.0, 1.0), np.zeros(count)

        def missed(amplitude: np.ndarray) -> np.ndarray:
            return (place - self._of(grid.state(amplitude, none, still)[0])).ravel() / sigma

        amplitude, left = none, missed(none)
        for _ in range(STEPS):
            slopes = grid.slopes(amplitude, none, still)[:count]
            matrix = np.stack([self._of(s).ravel() for s, _ in slopes], axis=1) / sigma[:, None]
            step, share = np.linalg.lstsq(matrix, left, rcond=None)[0], 1.0
            # What turns far is not reached in one step.
            while share > SHORTEST and not np.sum(missed(amplitude + share * step) ** 2) < left @ left:
                share *= 0.5
            if share <= SHORTEST or share * np.abs(step).max() < ACCURACY * np.abs(amplitude).max():
                break
            amplitude = amplitude + share * step
            left = missed(amplitude)
        return amplitude, np.linalg.lstsq(matrix, velocity.ravel() / sigma, rcond=None)[0]

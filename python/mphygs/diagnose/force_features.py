"""Forces that a formula may be made of, evaluated along a motion: right in units, one number each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from mphygs.diagnose.leading_frequencies import swing_frequencies
from mphygs.diagnose.missing_force import SequenceForce
from mphygs.simulate.fields import core_inputs

AXES = "xyz"
# Times of forgetting of the memory features [s].
MEMORY = (0.1, 0.5)
FREQUENCIES = 2


@dataclass(frozen=True)
class Feature:
    """One term. kind: a key of KINDS; part: name, None for the whole object; numbers: constants of the kind
    (axis, frequency, time, point)."""

    kind: str
    part: str | None = None
    numbers: tuple[float, ...] = ()

    @property
    def unit(self) -> str:
        """Of the coefficient."""
        return KINDS[self.kind].unit

    @property
    def expression(self) -> str:
        """What the coefficient multiplies, where it acts included."""
        where = "" if self.part is None else f" on part {self.part}"
        return KINDS[self.kind].text(self.numbers) + where

    def forces(self, motion: PointMotion) -> np.ndarray:
        """(T, N, 3) [N] for a coefficient of 1."""
        inside = np.ones(len(motion.part), bool)
        if self.part is not None:
            inside = motion.part == motion.part_names.index(self.part)
        return KINDS[self.kind].forces(motion, inside, self.numbers)


@dataclass(frozen=True, eq=False)
class PointMotion:
    """A motion at Q quadrature points and S points of the surface, in the middle of the interval before each
    of T frames, at rest before anything moves.

    mass (Q,) [kg], volume (Q,) [m^3], part (Q,), rest (Q, 3) [m]; node (Q, 27), weight (Q, 27), slope
    (Q, 27, 3) [1/m]; position, velocity (T, Q, 3); rate (T, Q, 3, 3) gradient of the velocity [1/s],
    deformation (T, Q, 3, 3); time (T,) [s]; surface_*: the same of S points of area (S,) [m^2].
    """

    nodes: int
    part_names: tuple[str, ...]
    mass: np.ndarray
    volume: np.ndarray
    part: np.ndarray
    rest: np.ndarray
    node: np.ndarray
    weight: np.ndarray
    slope: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    rate: np.ndarray
    deformation: np.ndarray
    time: np.ndarray
    area: np.ndarray
    surface_node: np.ndarray
    surface_weight: np.ndarray
    surface_part: np.ndarray
    surface_velocity: np.ndarray

    @classmethod
    def of(cls, found: SequenceForce) -> PointMotion:
        """The motion that a missing force has led to."""
        predictor, motion = found.seen_force.forced.predictor, found.motion
        body, model = predictor.body, found.seen_force.forced.model(motion.belief)
        q = body.quadrature
        node, weight, slope = model.weights(q.points.reshape(-1, 3), body.point_cell)
        frames = len(motion.timeline.frames)
        u, v = (_midway(a, frames) for a in (motion.displacement, motion.velocity))
        mass = core_inputs(motion.belief, body)["mass"].ravel()
        points, part = q.points.reshape(-1, 3), body.point_part.ravel()
        area, at = np.zeros(0), np.zeros((0, 3))
        cell = np.zeros((0, 3), np.int32)
        if "surface_area" in body.geometry:
            kept = body.geometry["surface_area"].ravel() > 0.0
            area = body.geometry["surface_area"].ravel()[kept]
            at = body.geometry["surface_points"].reshape(-1, 3)[kept]
            cell = np.repeat(body.geometry["surface_cell"], 8, axis=0)[kept]
        surface_node, surface_weight, _ = model.weights(at, cell)
        nearest = [int(((points - x) ** 2).sum(1).argmin()) for x in at]
        gradient = np.einsum("tqkc,qkj->tqcj", u[:, node], slope)
        return cls(
            model.node_count, body.part_names, mass, q.volumes.ravel(), part, points, node, weight, slope,
            points + np.einsum("qk,tqkc->tqc", weight, u[:, node]),
            np.einsum("qk,tqkc->tqc", weight, v[:, node]),
            np.einsum("tqkc,qkj->tqcj", v[:, node], slope),
            gradient + np.eye(3), motion.timeline.clock - 0.5 / predictor.recording.fps,
            area, surface_node, surface_weight, part[nearest],
            np.einsum("sk,tskc->tsc", surface_weight, v[:, surface_node]),
        )  # fmt: skip

    def body_force(self, acceleration: np.ndarray) -> np.ndarray:
        """(T, Q, 3) [N/kg] -> (T, N, 3) [N]."""
        return self._gathered(self.node, self.weight, acceleration * self.mass[:, None])

    def surface_force(self, traction: np.ndarray) -> np.ndarray:
        """(T, S, 3) [Pa] -> (T, N, 3) [N]."""
        return self._gathered(self.surface_node, self.surface_weight, traction * self.area[:, None])

    def stress_force(self, stress: np.ndarray) -> np.ndarray:
        """Cauchy stress (T, Q, 3, 3) [Pa] -> the internal force on the nodes, (T, N, 3) [N]."""
        volume = np.linalg.det(self.deformation)[..., None, None] * self.volume[:, None, None]
        first = volume * stress @ np.swapaxes(np.linalg.inv(self.deformation), -1, -2)
        return -sum(self._gathered(self.node, self.slope[..., j], first[..., j]) for j in range(3))

    def _gathered(self, node: np.ndarray, weight: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Sums at the nodes, (T, N, 3), of what points (T, Q, 3) hand to theirs, (Q, 27), by weight."""
        point = np.repeat(np.arange(len(node)), node.shape[1])
        matrix = csr_matrix((weight.ravel(), (node.ravel(), point)), shape=(self.nodes, len(node)))
        return np.stack([matrix @ one for one in force])


def _midway(values: np.ndarray, frames: int) -> np.ndarray:
    """(F + 1, N, 3) at the start and the moving frames -> (T, N, 3) before each of the frames."""
    out = np.zeros((frames, *values.shape[1:]))
    moving = len(values) - 1
    out[frames - moving :] = 0.5 * (values[1:] + values[:-1])
    return out


@dataclass(frozen=True)
class Kind:
    """unit: of the coefficient; text: of the numbers; forces: of motion, (Q,) inside and numbers; code: the
    force [N] in torch, None where an effect in Python cannot have it."""

    unit: str
    text: Callable[[Sequence[float]], str]
    forces: Callable[[PointMotion, np.ndarray, Sequence[float]], np.ndarray]
    code: Callable[[Sequence[float]], str] | None = None


def _drag(power: int) -> Callable[[PointMotion, np.ndarray, Sequence[float]], np.ndarray]:
    def forces(motion: PointMotion, inside: np.ndarray, _numbers: Sequence[float]) -> np.ndarray:
        speed = np.linalg.norm(motion.velocity, axis=-1, keepdims=True)
        return motion.body_force(speed**power * motion.velocity * inside[:, None])

    return forces


def _surface_drag(power: int) -> Callable[[PointMotion, np.ndarray, Sequence[float]], np.ndarray]:
    def forces(motion: PointMotion, inside: np.ndarray, _numbers: Sequence[float]) -> np.ndarray:
        chosen = np.isin(motion.surface_part, np.unique(motion.part[inside]))
        v = motion.surface_velocity * chosen[:, None]
        return motion.surface_force(np.linalg.norm(v, axis=-1, keepdims=True) ** power * v)

    return forces


def _spring(motion: PointMotion, inside: np.ndarray, _numbers: Sequence[float]) -> np.ndarray:
    return motion.body_force((motion.position - motion.rest) * inside[:, None])


def _uniform(motion: PointMotion, inside: np.ndarray, numbers: Sequence[float]) -> np.ndarray:
    return motion.body_force(_along(motion, numbers[0]) * inside[:, None])


def _harmonic(motion: PointMotion, inside: np.ndarray, numbers: Sequence[float]) -> np.ndarray:
    axis, frequency, late = numbers
    phase = 2.0 * np.pi * frequency * motion.time[:, None, None]
    course = np.cos(phase) if late else np.sin(phase)
    return motion.body_force(course * _along(motion, axis) * inside[:, None])


def _along(motion: PointMotion, axis: float) -> np.ndarray:
    return np.broadcast_to(np.eye(3)[int(axis)], motion.velocity.shape)


def _point(motion: PointMotion, inside: np.ndarray, numbers: Sequence[float]) -> np.ndarray:
    away = motion.position - np.array(numbers[:3])
    distance = np.sqrt((away**2).sum(-1, keepdims=True) + numbers[3] ** 2)
    return motion.body_force(away / distance**3 * inside[:, None])


def _deviator_rate(motion: PointMotion, inside: np.ndarray) -> np.ndarray:
    gradient = motion.rate @ np.linalg.inv(motion.deformation)
    rate = 0.5 * (gradient + np.swapaxes(gradient, -1, -2)) * inside[:, None, None]
    return rate - np.trace(rate, axis1=-2, axis2=-1)[..., None, None] / 3.0 * np.eye(3)


def _strain_rate(motion: PointMotion, inside: np.ndarray, _numbers: Sequence[float]) -> np.ndarray:
    return motion.stress_force(2.0 * _deviator_rate(motion, inside))


def _strain_memory(motion: PointMotion, inside: np.ndarray, numbers: Sequence[float]) -> np.ndarray:
    rate = _deviator_rate(motion, inside)
    span = np.diff(motion.time, prepend=motion.time[0])
    stress, kept = np.zeros_like(rate), np.zeros_like(rate[0])
    for t, one in enumerate(rate):
        kept = np.exp(-span[t] / numbers[0]) * kept + span[t] * one
        stress[t] = 2.0 * kept
    return motion.stress_force(stress)


def _speed_code(power: int) -> Callable[[Sequence[float]], str]:
    factor = {0: "", 1: "speed * ", 2: "speed.square() * "}[power]
    return lambda _numbers: f"mass * {factor}state.velocity"


KINDS: dict[str, Kind] = {
    "drag": Kind("1/s", lambda _: "v", _drag(0), _speed_code(0)),
    "quadratic_drag": Kind("1/m", lambda _: "|v| v", _drag(1), _speed_code(1)),
    "cubic_drag": Kind("s/m^2", lambda _: "|v|^2 v", _drag(2), _speed_code(2)),
    "surface_drag": Kind("kg/(m^2 s)", lambda _: "v per exposed area", _surface_drag(0)),
    "surface_quadratic_drag": Kind(
        "kg/m^3", lambda _: "|v| v per exposed area", _surface_drag(1)
    ),
    "surface_cubic_drag": Kind("kg s/m^4", lambda _: "|v|^2 v per exposed area", _surface_drag(2)),
    "spring": Kind("1/s^2", lambda _: "(x - X)", _spring),
    "uniform": Kind(
        "m/s^2", lambda n: f"e_{AXES[int(n[0])]}", _uniform,
        lambda n: f"mass * state.position.new_tensor({np.eye(3)[int(n[0])].tolist()})",
    ),
    "harmonic": Kind(
        "m/s^2",
        lambda n: f"{'cos' if n[2] else 'sin'}(2 pi {n[1]:.3g} Hz t) e_{AXES[int(n[0])]}",
        _harmonic,
        lambda n: f"mass * math.{'cos' if n[2] else 'sin'}({2 * np.pi * n[1]!r} * state.time)"
        f" * state.position.new_tensor({np.eye(3)[int(n[0])].tolist()})",
    ),
    "point": Kind(
        "m^3/s^2",
        lambda n: f"(x - p) / |x - p|^3 from p = ({', '.join(f'{c:.3g}' for c in n[:3])}) m",
        _point,
        lambda n: f"mass * away(state.position, {list(n[:3])}, {n[3]!r})",
    ),
    "strain_rate": Kind("Pa s", lambda _: "div 2 dev(D)", _strain_rate),
    "strain_memory": Kind(
        "Pa", lambda n: f"div 2 int dev(D) exp(-(t - s)/{n[0]:g} s) ds", _strain_memory
    ),
}  # fmt: skip


def candidate_features(motion: PointMotion, course: np.ndarray) -> list[Feature]:
    """All terms that are tried. course: (T, 3) mean missing force [N/kg], whose strongest frequencies give
    the harmonics; points of attraction are put around the object."""
    parts: list[str | None] = [None]
    if len(motion.part_names) > 1:
        parts += motion.part_names
    features = []
    for part in parts:
        for kind in ("drag", "quadratic_drag", "cubic_drag", "spring", "strain_rate"):
            features.append(Feature(kind, part))
        if len(motion.area):
            for kind in ("surface_drag", "surface_quadratic_drag", "surface_cubic_drag"):
                features.append(Feature(kind, part))
        features += [Feature("strain_memory", part, (tau,)) for tau in MEMORY]
    features += [Feature("uniform", None, (axis,)) for axis in range(3)]
    fps = 1.0 / float(np.median(np.diff(motion.time)))
    for frequency in swing_frequencies(course, fps, FREQUENCIES):
        for axis in range(3):
            features += [Feature("harmonic", None, (axis, frequency, late)) for late in (0, 1)]
    low, high = motion.rest.min(0), motion.rest.max(0)
    size = float((high - low).max())
    for direction in np.indices((3, 3, 3)).reshape(3, -1).T - 1:
        if direction.any():
            place = 0.5 * (low + high) + direction * (0.5 * (high - low) + 0.35 * size)
            features.append(Feature("point", None, (*(float(x) for x in place), 0.1 * size)))
    return features

"""What a missing force looks like: how large, which way, where and when, and of what nature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# A mean this small beside the root mean square is no direction; the axis of the force is given then.
SMALLEST_MEAN = 0.3
# Net force and moment below this share of what unaligned forces would give: the object pulls on itself.
INTERNAL = 0.2
# Power over the largest possible with this force and motion; share of it that goes one way.
POWERFUL, ONE_WAY = 0.3, 0.8
# Share of the square that a function of time alone, or of place alone, must explain.
ALONE = 0.8
# Share of the square that the stretch of time in `force_time` holds.
STRETCH = 0.5
WORDS = {
    "internal": "its sums and moments are near zero: internal",
    "dissipative": "it takes energy out of the motion: dissipative",
    "driving": "it puts energy into the motion: driving",
    "frame": "it is a function of time alone: the frame accelerates",
    "field": "it is a function of place alone: a steady field",
}


@dataclass(frozen=True, eq=False)
class ForceSample:
    """A force on C cells over T times of one sequence.

    force: (T, C, 3) [N/kg]; position (T, C, 3) [m], velocity (T, C, 3) [m/s] of the cells; mass: (C,) [kg];
    part: (C,) index into part_names; frames: (T,).
    """

    sequence: str
    force: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    mass: np.ndarray
    part: np.ndarray
    part_names: tuple[str, ...]
    frames: np.ndarray

    @property
    def square(self) -> np.ndarray:
        """(T, C) force squared times the share of the mass [N^2/kg^2]."""
        return (self.force**2).sum(2) * self.mass / self.mass.sum()


def rms(samples: Sequence[ForceSample]) -> float:
    """Root mean square over mass and time [N/kg]."""
    return float(np.sqrt(sum(s.square.sum() for s in samples) / sum(len(s.force) for s in samples)))


def mean_direction(samples: Sequence[ForceSample]) -> np.ndarray:
    """(3,) unit vector of the mean force; of the axis along which it goes to and fro where it has none."""
    weighted = [(s.force * (s.mass / s.mass.sum())[:, None]).sum(1) for s in samples]
    mean = np.concatenate(weighted).mean(0)
    if np.linalg.norm(mean) >= SMALLEST_MEAN * rms(samples) > 0.0:
        return mean / np.linalg.norm(mean)
    outer = sum(np.einsum("tci,tcj,c->ij", s.force, s.force, s.mass / s.mass.sum()) for s in samples)
    axis = np.linalg.eigh(outer)[1][:, -1]
    return axis * np.sign(axis[np.abs(axis).argmax()])


def force_place(samples: Sequence[ForceSample]) -> list[dict[str, object]]:
    """Parts by their share of the squared force, the largest first: part, its strongest place at rest or when
    first seen [m], rms [N/kg] over the part, share."""
    total = sum(float(s.square.sum()) for s in samples)
    found = []
    for p, name in enumerate(samples[0].part_names):
        square, weight, places = 0.0, 0.0, []
        for s in samples:
            mine = np.flatnonzero(s.part == p)
            if not len(mine):
                continue
            own = s.square[:, mine].sum(0)
            square += float(own.sum())
            weight += float(s.mass[mine].sum() / s.mass.sum()) * len(s.force)
            strongest = mine[(own / s.mass[mine]).argmax()]
            places.append((float(own.max()), s.position[0, strongest]))
        if places:
            center = max(places, key=lambda place: place[0])[1]
            found.append(
                {
                    "part": name,
                    "center": [float(x) for x in center],
                    "rms": float(np.sqrt(square / weight)),
                    "share": square / total if total > 0.0 else 0.0,
                }
            )
    return sorted(found, key=lambda entry: -entry["share"])


def force_time(samples: Sequence[ForceSample]) -> list[dict[str, object]]:
    """Of each sequence the shortest stretch of frames that holds half of the squared force, and the rms
    [N/kg] over it; the strongest first."""
    found = []
    for s in samples:
        course = np.r_[0.0, np.cumsum(s.square.sum(1))]
        wanted = STRETCH * course[-1]
        stretches = [
            (int(np.searchsorted(course, course[a] + wanted - 1e-12 * course[-1])) - a, a)
            for a in range(len(s.force))
            if course[-1] - course[a] >= wanted * (1 - 1e-9)
        ]
        length, a = min(stretches)
        b = min(a + max(length, 1), len(s.force))
        size = float(np.sqrt((course[b] - course[a]) / (b - a)))
        frames = [int(s.frames[a]), int(s.frames[b - 1]) + 1]
        found.append({"sequence": s.sequence, "frames": frames, "rms": size})
    return sorted(found, key=lambda entry: -entry["rms"])


def is_internal(samples: Sequence[ForceSample]) -> bool:
    """Whether the forces and moments of every time sum to nearly zero."""
    net, whole = 0.0, 0.0
    for s in samples:
        force = s.force * s.mass[:, None]
        center = np.einsum("c,tcd->td", s.mass / s.mass.sum(), s.position)
        arm = s.position - center[:, None]
        reach = np.sqrt((s.mass * (arm**2).sum(2)).sum(1) / s.mass.sum())
        moment = np.cross(arm, force).sum(1) / np.maximum(reach, 1e-12)[:, None]
        net += float((force.sum(1) ** 2).sum() + (moment**2).sum())
        sizes = np.linalg.norm(force, axis=2)
        whole += float((sizes.sum(1) ** 2).sum())
    return whole > 0.0 and np.sqrt(net / whole) < INTERNAL


def power_share(samples: Sequence[ForceSample]) -> tuple[float, float]:
    """Power over the largest that force and velocity of these sizes could have, -1 to 1; and the share of its
    absolute value that has the sign of the sum."""
    power = np.concatenate([np.einsum("tci,tci,c->t", s.force, s.velocity, s.mass) for s in samples])
    force = sum(float(np.einsum("tci,c->", s.force**2, s.mass)) for s in samples)
    speed = sum(float(np.einsum("tci,c->", s.velocity**2, s.mass)) for s in samples)
    largest = np.sqrt(force * speed)
    if largest == 0.0:
        return 0.0, 0.0
    same = np.abs(power[power * power.sum() > 0.0]).sum() / max(np.abs(power).sum(), 1e-300)
    return float(power.sum() / largest), float(same)


def share_of_time_alone(samples: Sequence[ForceSample]) -> float:
    """Share of the squared force that is the same at every place."""
    common = 0.0
    for s in samples:
        mean = np.einsum("tci,c->ti", s.force, s.mass / s.mass.sum())
        common += float((mean**2).sum())
    return common / max(sum(float(s.square.sum()) for s in samples), 1e-300)


def share_of_place_alone(samples: Sequence[ForceSample]) -> float:
    """Share of the squared force that is the same at every time, sequence by sequence."""
    steady = 0.0
    for s in samples:
        mean = (s.force.mean(0) ** 2).sum(1) * s.mass / s.mass.sum()
        steady += float(mean.sum()) * len(s.force)
    return steady / max(sum(float(s.square.sum()) for s in samples), 1e-300)


def nature(samples: Sequence[ForceSample]) -> list[str]:
    """What can be said of it, keys of WORDS."""
    found = []
    if is_internal(samples):
        found.append("internal")
    power, one_way = power_share(samples)
    if abs(power) >= POWERFUL and one_way >= ONE_WAY:
        found.append("dissipative" if power < 0.0 else "driving")
    if share_of_time_alone(samples) >= ALONE:
        found.append("frame")
    if share_of_place_alone(samples) >= ALONE:
        found.append("field")
    return found

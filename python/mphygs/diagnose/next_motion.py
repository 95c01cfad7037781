"""Which motion to record next, so that two effects which the recorded one confuses can be told apart.

Candidate motions of the hold are simulated with the fitted model; each says how much of chi^2 the rival would
leave of the effect, S_e (1 - C^2), were it recorded with the same markers and the same noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mphygs.capture.motions import HoldMovement, hold_poses
from mphygs.capture.record import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.compare.masked_means import mean_seen
from mphygs.compare.noise import Observation
from mphygs.diagnose.effect_variants import EffectVariant
from mphygs.diagnose.score import score_candidates
from mphygs.diagnose.score_table import Candidate, ScoreTable
from mphygs.diagnose.ties import separating_motions
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Predictor

# Of the object's diagonal; degrees; times the frequency at which the object was seen to move.
AMPLITUDE, ANGLE, FREQUENCIES = 0.04, 12.0, (0.5, 1.0, 2.0)
PERIODS, LONGEST = 5.0, 160  # [frames]
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Proposed:
    """A motion and how well it would tell an effect from its rival [chi^2]."""

    motion: str
    separation: float


def motion_frequency(observation: Observation, fps: float, frames: tuple[int, int]) -> float:
    """Frequency [Hz] at which the markers move most; that of one period where they hardly move."""
    moved = observation.position[slice(*frames)]
    moved = np.nan_to_num(moved - mean_seen(moved, 0))
    power = (np.abs(np.fft.rfft(moved * np.hanning(len(moved))[:, None, None], axis=0)) ** 2).sum((1, 2))
    frequency = np.fft.rfftfreq(len(moved), 1.0 / fps)
    return float(frequency[1:][power[1:].argmax()])


def candidate_motions(
    capture: Capture, recording: Recording, frequency: float
) -> dict[str, Recording]:
    """Recordings that could be made with the same markers, by name; none where nothing is held.

    The hold is shaken along and rocked about each axis, at half, once and twice a frequency [Hz].
    """
    if not recording.held:
        return {}
    diagonal = capture.diagonal
    pivot = np.mean([hold.box.mean(0) for hold in recording.held], axis=0)
    found = {}
    for factor in FREQUENCIES:
        f = min(factor * frequency, 0.2 * recording.fps)
        frames = int(min(max(PERIODS / f, 0.5) * recording.fps, LONGEST))
        times = np.arange(frames) / recording.fps
        stop = float(times[-1])
        size = AMPLITUDE * diagonal * min(1.0, 1.0 / factor)
        for name, axis in AXES.items():
            by = tuple(size * a for a in axis)
            timing = {"frequency": f, "ramp": min(1.0 / f, 0.4 * stop)}
            shake = HoldMovement("shake", 0.0, stop, by=by, **timing)
            rock = HoldMovement(
                "rock", 0.0, stop, axis=axis, degrees=ANGLE * min(1.0, 1.0 / factor), **timing
            )
            for motion, text in (
                (shake, f"shake the hold along {name} at {f:.2g} Hz by {1e3 * size:.2g} mm"),
                (rock, f"rock the hold about {name} at {f:.2g} Hz by {rock.degrees:.2g} degrees"),
            ):
                position, quaternion = hold_poses([motion], times, pivot)
                held = tuple(replace(h, position=position, quaternion=quaternion) for h in recording.held)
                own = replace(recording, frames=frames, fit=(0, frames), predict=(0, 0), held=held)
                found[text] = replace(own, loads=(), actuators=(), release=None, sensors=())
    return found


def propose(
    predictor: Predictor,
    observation: Observation,
    belief: Belief,
    leader: EffectVariant,
    rival: EffectVariant,
    increment: np.ndarray,
    *,
    report: Callable[[str], None] | None = None,
) -> tuple[Proposed, ...]:
    """Motions that would tell the leader from the rival, the best first.

    predictor, observation: of a recorded sequence; belief: the model without either; increment: (q,) strength
    of the leader, in units of its parameters.
    """
    recording = predictor.recording
    frequency = motion_frequency(observation, recording.fps, recording.fit)
    motions = candidate_motions(predictor.capture, recording, frequency)
    tables = {}
    for number, (text, motion) in enumerate(motions.items()):
        if report:
            report(f"motion {number + 1} of {len(motions)}: {text}")
        own = Predictor(predictor.capture, motion, predictor.settings, body=predictor.body)
        try:
            tables[text] = _table(own, belief, (leader, rival), observation.sigma)
        except SimulationError:
            continue
    found = separating_motions(tables, leader.label, rival.label, increment=increment)
    return tuple(Proposed(*item) for item in found)


def _table(
    predictor: Predictor, belief: Belief, variants: tuple[EffectVariant, EffectVariant], sigma: float
) -> ScoreTable:
    """Information of a motion not yet recorded: the residual is zero."""
    columns = [pair for variant in variants for pair in variant.columns]
    keys = [p.key for p in belief.free if not p.key.endswith(".release_shift")]
    prediction = predictor.predict(belief, keys=keys, candidates=columns)
    slopes = np.r_[np.ones(len(keys)), [p.slope for _, p in columns]]
    tangents = prediction.jacobian.reshape(-1, len(slopes)) / slopes / sigma
    prior = np.diag([belief[key].prior_residual[1] for key in keys])
    jacobian = np.vstack([tangents[:, : len(keys)], prior])
    tangents = np.vstack([tangents[:, len(keys) :], np.zeros((len(keys), len(columns)))])
    first = len(variants[0].columns)
    candidates = [
        Candidate(
            name=variant.label,
            tangent=columns,
            lower_bounded=variant.bounded,
            null=np.zeros(len(variant.columns)),
        )
        for variant, columns in zip(variants, (tangents[:, :first], tangents[:, first:]), strict=True)
    ]
    return score_candidates(
        np.zeros(len(jacobian)), jacobian, candidates, generator=np.random.default_rng(0)
    )


__all__ = ["Proposed", "candidate_motions", "motion_frequency", "propose"]

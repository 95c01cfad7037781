"""A soft finger on a tendon: its stiffness, and how much of the stated tension arrives, and when.

The truth: 120 kPa, and friction that leaves 70 % of the tension, 20 ms late.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

import mphygs

SIGMA, FPS, FRAMES = 1e-4, 60.0, 60
LENGTH, SIDE = 0.08, 0.014


def finger(gain: float, delay: float) -> mphygs.Capture:
    """A finger whose tendon runs from its clamp to its tip above the axis, without markers yet."""
    box = trimesh.creation.box(bounds=np.array([[-0.006, 0, 0], [LENGTH, SIDE, SIDE]]))
    part = mphygs.Part("finger", np.array(box.vertices), np.array(box.faces))
    clamp = mphygs.Hold(np.array([[-1.0, -1, -1], [0, 1, 1]]))
    times = np.arange(FRAMES) / FPS - delay
    tension = gain * np.where(times > 0, 0.12 * (1 - np.cos(2 * np.pi * 1.5 * times)), 0.0)
    path = np.array([[x, SIDE / 2, 0.011] for x in (-0.003, 0.02, 0.04, 0.06, 0.075)])
    tendon = mphygs.Tendon(tension, "tendon", unknown=("gain", "delay"), path=path)
    pull = mphygs.Sequence("pull", FPS, FRAMES, (0, 40), (40, FRAMES), held=(clamp,), actuators=(tendon,))
    known = mphygs.Known(density={"finger": 1050.0}, poissons_ratio=0.4)
    return mphygs.Capture("finger", Path("finger"), np.zeros(3), (part,), "stress-free", known, (pull,))


def main() -> mphygs.Fit:
    """What a fit finds."""
    at = np.array([[x, y, SIDE] for x in (0.02, 0.04, 0.06, LENGTH) for y in (0.0, SIDE)])
    truth = mphygs.Model.of(finger(0.7, 0.02), spacing=0.006)
    truth = truth.with_parameters({"finger.youngs_modulus": 1.2e5})
    position = mphygs.simulate(truth, points=at).position
    noise = SIGMA * np.random.default_rng(1).standard_normal(position.shape)
    stated = finger(1.0, 0.0)
    (pull,) = stated.sequences
    seen = replace(pull, markers=mphygs.Markers(position + noise, at, SIGMA))
    found = mphygs.fit(replace(stated, sequences=(seen,)), spacing=0.008)
    for key, number in found.parameters.items():
        print(f"{key:24} {number.value:10.4g} +- {number.std:.2g}")
    return found


if __name__ == "__main__":
    main()

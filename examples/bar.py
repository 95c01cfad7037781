"""A bar that is clamped, let go and swings, measured with noise: what the other examples look at.

The truth is simulated on a grid of its own: 250 kPa, 1000 kg/m^3, and a viscosity of 60 Pa s.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

import mphygs

SIGMA = 1e-4  # [m]


def make(youngs_modulus: float = 2.5e5, eta: float = 60.0, seed: int = 1) -> mphygs.Capture:
    """Twelve markers over 40 frames of a bar of 54 x 12 x 12 mm; nothing is written."""
    box = trimesh.creation.box(bounds=np.array([[0, 0, 0], [0.054, 0.012, 0.012]]))
    bar = mphygs.Part("bar", np.array(box.vertices), np.array(box.faces))
    at = np.array([[x, y, z] for x in (0.0, 0.03, 0.054) for y in (0.0, 0.012) for z in (0.0, 0.012)])
    clamp = mphygs.Hold(np.array([[-1.0, -1, -1], [1e-4, 1, 1]]))
    swing = mphygs.Sequence("swing", 100.0, 40, (0, 26), (26, 40), held=(clamp,))
    known = mphygs.Known(density={"bar": 1000.0}, poissons_ratio=0.4)
    gravity = np.array([0.0, 0.0, -9.81])
    capture = mphygs.Capture("bar", Path("bar"), gravity, (bar,), "stress-free", known, (swing,))
    truth = mphygs.Model.of(capture, spacing=0.005)
    truth = truth.with_parameters({"bar.youngs_modulus": youngs_modulus})
    if eta:
        truth = truth.with_effect("viscosity", {"eta": eta})
    position = mphygs.simulate(truth, points=at).position
    noise = SIGMA * np.random.default_rng(seed).standard_normal(position.shape)
    return replace(capture, sequences=(replace(swing, markers=mphygs.Markers(position + noise, at, SIGMA)),))


if __name__ == "__main__":
    mphygs.save_capture(make(), "bar")
    print("wrote bar: mphygs discover bar")

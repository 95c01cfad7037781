"""Which motion to record next: candidates simulated, each judged by what it would tell of the viscosity."""

from dataclasses import replace

import bar
import numpy as np

import mphygs


def main() -> dict[str, float]:
    """Expected standard error of the viscosity [Pa s] by frequency at which the clamp is shaken [Hz]."""
    model = mphygs.Model.of(bar.make(), spacing=0.006)
    model = model.with_parameters({"bar.youngs_modulus": 2.5e5}).with_effect("viscosity", {"eta": 60.0})
    swing = model.capture.sequences[0]
    times = np.arange(60) / swing.fps
    expected = {}
    for frequency in (2.0, 5.0, 8.0):
        shift = np.zeros((60, 3))
        shift[:, 2] = 0.002 * np.sin(2 * np.pi * frequency * times) * np.minimum(1.0, times * frequency)
        clamp = replace(swing.held[0], position=shift, quaternion=np.tile([1.0, 0, 0, 0], (60, 1)))
        motion = mphygs.Sequence("shaken", swing.fps, 60, held=(clamp,))
        points = swing.markers.at
        # How the motion changes with the two numbers, by differences of one percent.
        changes = []
        for key in ("bar.youngs_modulus", "viscosity.eta"):
            at = model.parameters[key]
            ends = [
                mphygs.simulate(model.with_parameters({key: f * at}), motion, points=points).position
                for f in (1.01, 0.99)
            ]
            changes.append((ends[0] - ends[1]).ravel() / (0.02 * at) / bar.SIGMA)
        covariance = np.linalg.inv(np.array(changes) @ np.array(changes).T)
        expected[f"{frequency:g} Hz"] = float(np.sqrt(covariance[1, 1]))
    print(expected)
    return expected


if __name__ == "__main__":
    main()

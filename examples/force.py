"""Stiffness and density apart, by the force that the clamp bears."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import bar
import numpy as np

import mphygs

SIGMA = 1e-3  # [N], of a force whose mean is the bar's weight of 76 mN


def make() -> mphygs.Capture:
    """The bar, of which no mass is known, with the force at its clamp measured."""
    capture = bar.make()
    (swing,) = capture.sequences
    truth = mphygs.Model.of(capture, spacing=0.005).with_parameters({"bar.youngs_modulus": 2.5e5})
    truth = truth.with_effect("viscosity", {"eta": 60.0})
    unmeasured = mphygs.Sensor("force", np.full((swing.frames, 1, 3), np.nan), np.array([SIGMA]), hold=0)
    (force,) = mphygs.simulate(truth, replace(swing, sensors=(unmeasured,))).readings.values()
    force = force + SIGMA * np.random.default_rng(2).standard_normal(force.shape)
    swing = replace(swing, sensors=(replace(unmeasured, value=force),))
    return replace(capture, known=mphygs.Known(poissons_ratio=0.4), sequences=(swing,))


def main() -> dict[str, mphygs.Fit]:
    """Fits with the force and without it."""
    with_force = make()
    bare = tuple(replace(sequence, sensors=()) for sequence in with_force.sequences)
    found = {}
    with TemporaryDirectory() as folder:
        for name, capture in (("markers", replace(with_force, sequences=bare)), ("and force", with_force)):
            out = Path(folder) / name
            found[name] = mphygs.fit(capture, effects=["viscosity"], spacing=0.006, out=out)
            for key in ("bar.youngs_modulus", "bar.density"):
                number = found[name].parameters[key]
                told = f"+- {number.std:.2g}" if number.determined else f"not determined: {number.note}"
                print(f"{name}: {key} {number.value:.4g} {number.unit}, {told}")
    return found


if __name__ == "__main__":
    main()

"""An effect of one's own, in Python: a draught that pushes one way, scored beside the built-in effects."""

from dataclasses import replace

import bar
import numpy as np
import torch

import mphygs


@mphygs.register_effect
class Push:
    """A steady push along y, as large everywhere."""

    name = "push"
    parameters = (mphygs.ParameterSpec("a", "m/s^2", null=0.0, lower=-100.0, upper=100.0, scale=1.0),)

    def force(self, state, parameters):
        """(N, 3) [N]."""
        along = torch.zeros_like(state.velocity)
        along[:, 1] = 1.0
        return parameters["a"] * state.mass[:, None] * along


def main() -> mphygs.Fit:
    """Put the push into a truth, and fit it together with the stiffness."""
    capture = bar.make(eta=0.0)
    swing = capture.sequences[0]
    truth = mphygs.Model.of(capture, spacing=0.006).with_parameters({"bar.youngs_modulus": 2.5e5})
    pushed = mphygs.simulate(truth.with_effect("push", {"a": 3.0})).position
    pushed = pushed + bar.SIGMA * np.random.default_rng(0).standard_normal(pushed.shape)
    swing = replace(swing, markers=replace(swing.markers, position=pushed))
    found = mphygs.fit(replace(capture, sequences=(swing,)), effects="push", spacing=0.006)
    print(found.parameters["push.a"])
    return found


if __name__ == "__main__":
    main()

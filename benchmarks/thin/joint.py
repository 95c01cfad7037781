"""How the slowest motions of a flower depend on the cells where its petals are fastened to the head.

    python benchmarks/thin/joint.py
    python benchmarks/thin/joint.py --even --spacings 0.01 0.0068 0.004 0.003 # of one length
    python benchmarks/thin/joint.py --petals 1 --spacings 0.004 0.002

The petals are 20 mm wide and fastened over 5 mm; where they overlap they are
fastened to each other. Natural frequencies about the shape at rest, without gravity.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.holds import Hold
from mphygs.capture.markers import Markers
from mphygs.capture.record import Known
from mphygs.capture.record import Sequence as Recording
from mphygs.fit.start import starting_belief
from mphygs.simulate import discretisation
from mphygs.simulate.modes import natural_modes
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.settings import Settings
from mphygs.synth.thin_shapes import thin_flower


def main() -> None:
    """Prints a row for each spacing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spacings", type=float, nargs="+", default=[0.01, 0.0078, 0.0061, 0.0045, 0.003])
    parser.add_argument("--petals", type=int, default=6)
    parser.add_argument("--even", action="store_true", help="no shorter cells where sheets are fastened")
    given = parser.parse_args()
    if given.even:
        discretisation.grading = lambda *_: None
    shape = thin_flower(petals=given.petals, grown=0.1)
    place = shape.tip[None]
    markers = Markers(np.tile(place, (2, 1, 1)), place, 1e-4)
    recording = Recording("a", 60.0, 2, held=(Hold(shape.hold, None, None),), markers=markers)
    known = Known(density=shape.density, poissons_ratio=0.3)
    capture = Capture("flower", Path("."), np.zeros(3), shape.parts, "stress-free", known, (recording,))
    belief = starting_belief(capture)
    for name, modulus in shape.youngs_modulus.items():
        belief = belief.with_parameter(f"{name}.youngs_modulus", value=modulus, lower=1e3, upper=1e10)
    print("| spacing [mm] | cells | first four frequencies [Hz] |\n| --- | --- | --- |")
    for spacing in given.spacings:
        predictor = Predictor(capture, recording, Settings(spacing, dtype="float64", workers=1))
        found = np.sqrt(natural_modes(predictor, belief, 4).squared) / (2.0 * np.pi)
        cells = len(np.unique(predictor.body.geometry["cell"], axis=0))
        print(f"| {1e3 * spacing:g} | {cells} | {', '.join(f'{f:.2f}' for f in found)} |", flush=True)


if __name__ == "__main__":
    main()

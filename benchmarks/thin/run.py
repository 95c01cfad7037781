"""A flower at real stiffness and thickness: what a run, its gradient and explicit steps of the same cost.

    python benchmarks/thin/run.py                 # two seconds at 60 frames a second
    python benchmarks/thin/run.py --frames 31     # half a second
    python benchmarks/thin/run.py --frames 31 --grown 0.1 # petals at necks of 5 mm, which fall over

A stem of 3 mm and 300 MPa as a rod, a head as a solid, petals of 0.3 mm and 5 MPa as shells, published in
equilibrium and moved at the stem's foot. Explicit steps are run for a few of them only: their number follows
from the highest frequency of the same body.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "python"))

from bar_capture import bar_belief
from mphygs.simulate.fields import core_inputs
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.settings import Settings
from mphygs.synth.thin_shapes import thin_flower
from thin_meshes import held_capture


def main() -> None:
    """Prints one line for each thing that is timed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=121)
    parser.add_argument("--petals", type=int, default=6)
    parser.add_argument("--grown", type=float, default=0.5, help="reach of petals into the head")
    parser.add_argument("--spacing", type=float, default=0.0075, help="[m]")
    given = parser.parse_args()
    fps, parts = 60.0, thin_flower(petals=given.petals, thickness=3e-4, grown=given.grown).parts
    times = np.arange(given.frames) / fps
    motion = np.zeros((given.frames, 3))
    motion[:, 0] = 0.01 * np.sin(2 * np.pi * 2.0 * times) * np.minimum(times / 0.2, 1.0)
    away = [np.linalg.norm(part.vertices[:, :2], axis=1).argmax() for part in parts[2:]]
    tips = np.array([part.vertices[k] for part, k in zip(parts[2:], away, strict=True)])
    capture = held_capture(
        parts, box=[[-1, -1, -1], [1, 1, 0]], frames=given.frames, fps=fps, gravity=[0, 0, -9.81],
        markers=tips, motion=motion, rest="equilibrium",
    )  # fmt: skip
    moduli = [3e8, 1e7] + [5e6] * given.petals
    keys = tuple(f"{part.name}.youngs_modulus" for part in parts)
    belief = bar_belief(capture, youngs_modulus=moduli, density=800.0, prestress="equilibrium", free=keys)
    begin = time.perf_counter()
    settings = Settings(given.spacing, workers=1, dtype="float64")
    predictor = Predictor(capture, capture.sequence("a"), settings)
    print(f"set-up: {time.perf_counter() - begin:.1f} s, {predictor.body.block_count} blocks")
    begin = time.perf_counter()
    position = predictor.predict(belief).position
    forward = time.perf_counter() - begin
    seconds = (given.frames - 1) / fps
    moved = 1e3 * np.ptp(position, axis=0).max()
    print(f"run of {seconds:.2f} s: {forward:.1f} s; petals move {moved:.0f} mm")
    begin = time.perf_counter()
    predict_with_gradient(predictor, belief, np.ones_like, keys=keys, last=given.frames)
    print(f"gradient: {time.perf_counter() - begin:.1f} s")
    model = predictor.model((), np.zeros((0, 3)), belief.law)
    fields = core_inputs(belief, predictor.body)
    stiffness, _ = predictor.transfer.largest_rates(model, fields, None)
    substep = settings.safety * 2.0 / np.sqrt(stiffness)
    count = 200
    schedule = {"steps": [count], "dt": [substep], "start": 0.0}
    nodes = len(model.node_index)
    still = {"displacement0": np.zeros((nodes, 3)), "velocity0": np.zeros((nodes, 3))}
    pose = np.tile(np.r_[np.eye(3).ravel(), 0, 0, 0], (1, count + 1, 1))
    begin = time.perf_counter()
    model.simulate(fields | still | {"pose": pose}, schedule)
    explicit = (time.perf_counter() - begin) / count * seconds / substep
    ratio = explicit / forward
    print(f"explicit: {substep:.2g} s a substep, {explicit:.0f} s for the run: {ratio:.1f} times as long")


if __name__ == "__main__":
    main()

"""Memory of a long gradient: 100,000 particles, 50 frames of 200 substeps, a loss on the positions at frames.

    pip install .
    python benchmarks/jelly2/memory.py

Prints the substeps that were computed again, the process's largest memory, and that before the gradient.
"""

import argparse
import resource
import time

import numpy as np
import workload
from peer_mphygs import Peer


def largest_memory() -> float:
    """Of this process so far [GiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def main() -> None:
    """Command line."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--particles", type=int, default=100_000)
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--substeps", type=int, default=200, help="of a frame")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--budget", type=float, default=2.0, help="of the gradient [GiB]")
    options = parser.parse_args()
    work = workload.jelly2(options.particles)
    peer = Peer(work, options.threads, budget=int(options.budget * 2**30))
    schedule = {"steps": [options.substeps] * options.frames, "dt": [workload.STEP] * options.frames}
    fields = peer.fields(options.frames * options.substeps, workload.YOUNG)
    before = largest_memory()

    def loss(position: np.ndarray, velocity: np.ndarray, deformation: np.ndarray) -> tuple:
        return position - position[:1], None, None

    start = time.perf_counter()
    bars, recomputed = peer.model.gradient(fields, schedule, loss)
    seconds = time.perf_counter() - start
    steps = options.frames * options.substeps
    assert np.isfinite(bars["mu"]).all() and np.abs(bars["mu"]).max() > 0
    print(
        f"{work.count} particles, {steps} substeps: {recomputed / steps:.2f} recomputations, largest memory "
        f"{largest_memory():.2f} GiB ({before:.2f} before) with a budget of {options.budget:g} GiB; "
        f"{seconds:.0f} s, {seconds * 1e9 / (work.count * steps):.0f} ns per particle and substep"
    )


if __name__ == "__main__":
    main()

"""Time the compiled splatting kernel beside the plain version, one JSON line a case.

python benchmarks/splatting/run.py [--count 10000] [--size 256] [--threads 1] [--oracle]
"""

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
import torch

from mphygs.capture.cameras import Camera, looking_at
from mphygs.render.reference_splatting import splat_by_oracle
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians

REPEATS = 9


def scene(count: int, scale: float, features: int) -> Gaussians:
    """A ball of Gaussians, 0.05 m standard deviation, of log-normal scales about `scale` [m], degree 3."""
    draw = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=draw)

    parts = (
        0.05 * normal(count, 3),
        normal(count, 4),
        scale * torch.exp(0.7 * normal(count, 3)),
        torch.sigmoid(1.0 + 2.0 * normal(count)),
        0.4 * normal(count, 16, 3),
        normal(count, features),
    )
    return Gaussians(*(part.requires_grad_() for part in parts))


def milliseconds(run: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median time of a call after one that is not counted [ms]."""
    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def main() -> None:
    """Print the cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="Gaussians")
    parser.add_argument("--size", type=int, default=256, help="pixels along a side")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--oracle", action="store_true", help="time the plain version too (seconds a case)")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    camera = Camera(
        name="eye",
        width=options.size,
        height=options.size,
        focal=np.full(2, 1.6 * options.size),
        centre=np.full(2, 0.5 * options.size),
        camera_from_world=looking_at(np.array([0.3, -0.4, 0.1]), np.zeros(3)),
    )
    for scale, features in ((0.0015, 0), (0.004, 0), (0.0015, 16), (0.0015, 64)):
        gaussians = scene(options.count, scale, features)

        def forward(draw: Callable = splat, gaussians: Gaussians = gaussians) -> torch.Tensor:
            picture = draw(gaussians, camera)
            return picture.colour.square().sum() + picture.opacity.sum() + picture.features.sum()

        def both(draw: Callable = splat, forward: Callable = forward) -> None:
            forward(draw).backward()

        row = {"gaussians": options.count, "pixels": options.size, "scale_m": scale, "features": features}
        with torch.no_grad():
            row["forward_ms"] = milliseconds(forward)
        row["both_ms"] = milliseconds(both)
        if options.oracle:
            with torch.no_grad():
                row["oracle_forward_ms"] = milliseconds(lambda run=forward: run(splat_by_oracle), 1)
            row["oracle_both_ms"] = milliseconds(lambda run=both: run(splat_by_oracle), 1)
        sys.stdout.write(json.dumps({key: round(value, 4) for key, value in row.items()}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()

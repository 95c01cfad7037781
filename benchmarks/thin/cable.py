"""Both stiffnesses of a cable of two materials, held by two hands that move and twist it, and its twist.

    python benchmarks/thin/cable.py                         # three seeds, 80 frames at 100 a second
    python benchmarks/thin/cable.py --seeds 4 --spacing 0.005

Every capture is made by `mphygs synth cable`, whose truth is that of geometrically exact rods, with markers
of 0.1 mm noise; fitted by `mphygs fit` on five eighths of the first motion, and predicted by `mphygs
predict`. All of that is kept in runs/thin-cable. The section is the mesh's: E I is off as E is.

Markers are crosses of four, square to the cable and three of its widths across. Of each the turn R from rest
is that which fits its four places best; twist between neighbours is what of log(R_k^T R_(k+1)) is along the
cable.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from mphygs.capture.format import load_capture
from mphygs.capture.rotation import rotation_vector_from_matrix

FOLDER = Path("runs/thin-cable")
PARTS = ("cable1", "cable2")


def command(*arguments: str) -> tuple[dict, float]:
    """What a command answers, and the seconds of processor time that it took."""
    before = _spent()
    done = subprocess.run(
        [sys.executable, "-m", "mphygs", *arguments, "--json"], stdout=subprocess.PIPE, text=True
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(arguments)}: exit code {done.returncode}")
    return json.loads(done.stdout), _spent() - before


def _spent() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def turns(rest: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Rotations (T, K, 3, 3) of crosses from rest (K, 4, 3), seen at (T, K, 4, 3); NaN of one not whole."""
    away = rest - rest.mean(axis=1, keepdims=True)
    now = seen - seen.mean(axis=2, keepdims=True)
    whole = np.isfinite(now).all(axis=(2, 3))
    product = np.einsum("tkmi,kmj->tkij", np.where(whole[..., None, None], now, away), away)
    # Flat crosses leave the third direction to the sign of the determinant.
    left, _, right = np.linalg.svd(product)
    sign = np.ones((*whole.shape, 3))
    sign[..., 2] = np.linalg.det(left @ right)
    turn = (left * sign[..., None, :]) @ right
    turn[~whole] = np.nan
    return turn


def twists(rest: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(T, K - 1) [degrees] between neighbouring crosses, as of `turns`."""
    turn = turns(rest, seen)
    arms = rest[:, :2] - rest.mean(axis=1, keepdims=True)
    along = np.cross(arms[:, 0], arms[:, 1])
    along = along[:-1] / np.linalg.norm(along[:-1], axis=1, keepdims=True)
    between = np.swapaxes(turn[:, :-1], 2, 3) @ turn[:, 1:]
    known = np.isfinite(between).all(axis=(2, 3))
    between[~known] = np.eye(3)
    twist = np.einsum("tkc,kc->tk", rotation_vector_from_matrix(between), along)
    return np.degrees(np.where(known, twist, np.nan))


def rms(values: np.ndarray) -> float:
    """Root mean square of what is known."""
    return float(np.sqrt(np.nanmean(values**2)))


def measure(seed: int, frames: int, spacing: float, hidden: str) -> str:
    """One row of the table."""
    folder = FOLDER / str(seed)
    capture, run = folder / "capture", folder / "run"
    effects = ("--hidden", hidden) if hidden else ()
    _, made = command(
        "synth", "cable", "--known", "densities", "--sigma", "1e-4", "--frames", str(frames),
        "--seed", str(seed), "--out", str(capture), *effects,
    )  # fmt: skip
    also = ("--effects", hidden.split(":")[0]) if hidden else ()
    fitted, spent = command(
        "fit", str(capture), "--sequences", "a", "--spacing", str(spacing), "--out", str(run), *also
    )
    command("predict", str(run))
    truth = json.loads((capture / "answer.json").read_text())["parts"]
    cells = []
    for part in PARTS:
        found, true = fitted["parameters"][f"{part}.youngs_modulus"], truth[part]["E"]
        std = found["std"]
        off = 100.0 * (found["value"] / true - 1.0)
        cells.append(f"{off:+.2f}" if std is None else f"{off:+.2f} +- {100.0 * std / true:.2f}")
    read = load_capture(capture)
    for name in ("a", "b"):
        recording = read.sequence(name)
        rest, seen = recording.markers.at, recording.markers.position
        with np.load(run / "predictions" / f"{name}.npz") as arrays:
            predicted = arrays["position"]
        sigma = recording.markers.sigma
        shown = slice(recording.fit[1], None)
        cells.append(f"{rms(predicted[shown] - seen[shown]) / sigma:.2f}")
        ours, theirs = (
            twists(rest.reshape(-1, 4, 3), x.reshape(len(x), -1, 4, 3)) for x in (predicted, seen)
        )
        arm = np.linalg.norm(rest[0] - rest[:4].mean(axis=0))
        noise = np.degrees(sigma / arm / np.sqrt(2.0))
        cells.append(f"{rms(ours - theirs):.2f} / {noise:.2f} / {rms(theirs):.2f}")
    return f"| {seed} | {' | '.join(cells)} | {made:.0f} | {spent:.0f} |"


def main() -> None:
    """Prints a table, row by row."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[11, 12, 13])
    parser.add_argument("--frames", type=int, default=80)
    parser.add_argument("--spacing", type=float, default=0.008, help="[m]")
    parser.add_argument("--hidden", default="", help="an effect that is hidden, and fitted")
    given = parser.parse_args()
    print("| seed | E of the first [%] | E of the second [%] | a, unseen [sigma] "
          "| its twist: off / noise / size [deg] | b [sigma] | its twist [deg] | made [s] | fitted [s] |")
    print("| --- " * 9 + "|")
    begin = time.perf_counter()
    for seed in given.seeds:
        print(measure(seed, given.frames, given.spacing, given.hidden), flush=True)
    print(f"{time.perf_counter() - begin:.0f} s in all")


if __name__ == "__main__":
    main()

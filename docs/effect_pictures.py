"""Pictures of what every effect does: one bar, simulated without it and with it.

The effect has the size that `mphygs synth bar --hidden NAME` gives it; nothing else differs, and nothing is
noisy, but for a fault that is noise.
"""

from __future__ import annotations

import io
import math
import tempfile
from functools import cache

import numpy as np
from matplotlib.figure import Figure

from mphygs.capture.format import load_capture
from mphygs.capture.motions import HoldMovement
from mphygs.synth.hidden import hidden_names
from mphygs.synth.make import make_capture
from mphygs.synth.marker_noise import Noise
from mphygs.synth.recipe import Recipe, Take, recipe

FPS, FRAMES = 60.0, 60
WITHOUT, WITH = "#8a8a8a", "#c2410c"


def pictured() -> tuple[str, ...]:
    """Names of the effects and faults that have a picture."""
    return hidden_names()


def picture(name: str) -> bytes:
    """An .svg: the point that differs most over time, and all points at the time when it does."""
    made_of = _recipe((name,))
    (thing,) = made_of.hidden
    plain, seen = _positions(), _positions(name)
    away = np.linalg.norm(np.nan_to_num(seen - plain), axis=2)
    frame, marker = np.unravel_index(int(away.argmax()), away.shape)
    axis = int(np.abs(np.nan_to_num(seen - plain)[frame, marker]).argmax())
    times = np.arange(len(plain)) / FPS
    figure = Figure(figsize=(7.6, 2.5), layout="constrained")
    over_time, from_the_side = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    for position, colour, label in ((plain, WITHOUT, "without"), (seen, WITH, "with")):
        # Dashed, so that the two are told apart in print too.
        style = "--" if position is plain else "-"
        over_time.plot(times, 1e3 * position[:, marker, axis], style, color=colour, lw=1.4, label=label)
        x, z = 1e3 * position[frame, :, 0], 1e3 * position[frame, :, 2 if axis != 1 else 1]
        mark = "o" if position is plain else "x"
        from_the_side.plot(x, z, mark, color=colour, ms=4, mfc="none", lw=0)
    over_time.axvline(times[frame], color="#cccccc", lw=0.8, zorder=0)
    over_time.set(xlabel="time [s]", ylabel=f"{'xyz'[axis]} of a point [mm]")
    over_time.legend(fontsize=8, frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    from_the_side.set(xlabel="x [mm]", ylabel=f"{'y' if axis == 1 else 'z'} [mm], at {times[frame]:.2f} s")
    from_the_side.set_aspect("equal", adjustable="datalim")
    values = ", ".join(f"{key} = {value:.3g}" for key, value in thing.values.items() if not _is_null(value))
    figure.suptitle(f"{name}{': ' if values else ''}{values}", fontsize=9)
    for axes in (over_time, from_the_side):
        axes.tick_params(labelsize=8)
        axes.xaxis.label.set_size(8)
        axes.yaxis.label.set_size(8)
        axes.spines[["top", "right"]].set_visible(False)
    out = io.BytesIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def _is_null(value: float) -> bool:
    return value == 0.0 or not math.isfinite(value)


def _recipe(hidden: tuple[str, ...]) -> Recipe:
    shaken = HoldMovement("shake", 0.05, 0.9, by=(0.0, 0.004, 0.003), frequency=3.1, ramp=0.2)
    take = Take("a", (shaken,), FPS, FRAMES, (0, FRAMES), (0, 0), 2)
    noise = Noise(sigma=1e-9, dropout=0.0)
    settings = {"marker_count": 40, "spacing_share": 1.4, "seed": 3}
    return recipe("bar", hidden=hidden, takes=(take,), noise=noise, **settings)


@cache
def _positions(*hidden: str) -> np.ndarray:
    """(T, M, 3) [m] of the bar's markers."""
    with tempfile.TemporaryDirectory() as folder:
        make_capture(_recipe(hidden), folder, measure_signal=False)
        markers = load_capture(folder).sequences[0].markers
    assert markers is not None
    return markers.position

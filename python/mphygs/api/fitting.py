"""Materials, and the effects named, fitted to a capture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mphygs.api.calls import CaptureLike, Home, Progress, call, comma, json_of, place, placed_capture
from mphygs.api.results import Error, Estimate, Row, Table, errors_figure, errors_of, estimates_of
from mphygs.baselines.kinds import Baseline
from mphygs.commands.console import Console
from mphygs.commands.fit import fitted
from mphygs.commands.fit_options import FitOptions
from mphygs.fit.run import Run
from mphygs.model.registry import USUAL_LAW

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Fit(Table):
    """A fit. run: its folder, which goes with this object where no `out` was named; document: the command's
    JSON."""

    run: Path
    document: Mapping[str, Any]
    _home: Home | None = field(default=None, repr=False)

    @property
    def parameters(self) -> dict[str, Estimate]:
        """The fitted numbers by key, "<part>.youngs_modulus" [Pa] or "<effect>.<parameter>"."""
        return estimates_of(self.document["parameters"])

    @property
    def sequences(self) -> dict[str, dict[str, Error | None]]:
        """Errors by sequence, on the frames fitted ("fit") and on others ("predict")."""
        return errors_of(self.document["sequences"])

    def title(self) -> str:
        """How far the fit is from the measurement."""
        told = (
            f"{name}, {label}: {error.rms_over_sigma:.3g} sigma"
            for name, ranges in self.sequences.items()
            for label, error in ranges.items()
            if error is not None and error.rms_over_sigma is not None
        )
        return "; ".join(told)

    def rows(self) -> list[Row]:
        """One row a parameter: parameter, value, std, unit, determined, note."""
        return [
            {
                "parameter": key,
                "value": e.value,
                "std": e.std,
                "unit": e.unit,
                "determined": e.determined,
                "note": e.note,
            }
            for key, e in self.parameters.items()
        ]

    def plot(self) -> Figure:
        """Errors over the noise, by sequence, on fitted and other frames."""
        errors = self.sequences
        return errors_figure(list(errors), {
            label: [None if (e := errors[n].get(label)) is None else e.rms_over_sigma for n in errors]
            for label in ("fit", "predict")
        })  # fmt: skip


def fit(
    capture: CaptureLike | None = None,
    *,
    out: str | Path | None = None,
    sequences: Sequence[str] | str = (),
    effects: Sequence[str] | str = (),
    frames: tuple[int, int] | None = None,
    schedule: Literal["fast", "paper"] = "fast",
    transfer: Literal["total-lagrangian", "mls"] = "total-lagrangian",
    integrator: Literal["explicit", "implicit", "auto"] = "explicit",
    spacing: float | None = None,
    prestress: Literal["off", "paper", "equilibrium"] | None = None,
    law: str = USUAL_LAW,
    preset: Mapping[str, str] | str | None = None,
    optimiser: Literal["gauss-newton", "adam", "lbfgs"] = "gauss-newton",
    stages: str | Path | None = None,
    without: Sequence[str] | str = (),
    baseline: Baseline | None = None,
    feedback: float | None = None,
    intervals: bool = False,
    seed: int = 0,
    workers: int | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Fit:
    """Fit materials, and the effects named, as `mphygs fit` does, to the same numbers.

    capture: a capture or its folder, None for a small one made on the spot; out: run folder, by default a
    temporary one that goes with the result; spacing: of the grid [m]; frames: (i, j), fits i to j - 1;
    preset: of all parts, or by part; the others as the command's options; progress: told the share of the
    work done, 0 to 1, and a line.
    Raises InputError or FailedError, with the line that the command would have ended in.
    """
    folder, home = place(out)

    def action(options: FitOptions, console: Console) -> Run:
        own = None if resume and out is not None else placed_capture(capture, folder)
        return fitted(replace(options, capture=own), console)[0]

    options = FitOptions(
        out=folder,
        sequences=comma(sequences),
        effects=comma(effects),
        frames=None if frames is None else f"{frames[0]}:{frames[1]}",
        schedule=schedule,
        transfer=transfer,
        integrator=integrator,
        spacing=spacing,
        prestress=prestress,
        law=law,
        preset=preset if preset is None or isinstance(preset, str) else comma(
            [f"{part}={name}" for part, name in preset.items()]
        ),
        optimiser=optimiser,
        stages=None if stages is None else Path(stages),
        without=comma(without),
        baseline=baseline,
        feedback=feedback,
        intervals=intervals,
        seed=seed,
        workers=workers,
        resume=resume,
    )
    state = call(action, options, progress)
    return Fit(state.folder, json_of(dict(state.answer or {})), home)

"""Effects added one after the other: those that are named, or those that the loop finds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mphygs.api.calls import (
    CaptureLike,
    Home,
    Progress,
    RunLike,
    call,
    comma,
    folder_of,
    home_of,
    json_of,
    place,
    placed_capture,
)
from mphygs.api.results import Estimate, Row, Table, error_rows, errors_figure, errors_of, estimates_of
from mphygs.commands.command import Answer
from mphygs.commands.console import Console
from mphygs.commands.discover import FIRST, DiscoverOptions, discover_command
from mphygs.commands.extend import ExtendOptions
from mphygs.commands.extend import extend_command as extend_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Steps(Table):
    """Models, each with one effect more; the first is the one before anything was added. run: folder of the
    last one; document: the command's JSON."""

    run: Path
    document: Mapping[str, Any]
    _home: Home | None = field(default=None, repr=False)

    @property
    def verdict(self) -> str:
        """ "adequate", "missing", "measurement" or "unknown"."""
        return str(self.document["verdict"])

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects and faults concluded, most certain first."""
        return tuple(self.document["effects"])

    @property
    def parameters(self) -> dict[str, Estimate]:
        """The fitted numbers of the last model by key."""
        return estimates_of(self.document["steps"][-1]["parameters"])

    @property
    def names(self) -> tuple[str, ...]:
        """What each step added."""
        return tuple("+".join(step["added"]) or "first" for step in self.document["steps"])

    def title(self) -> str:
        """Verdict and effects."""
        return f"verdict: {self.verdict}; effects: {', '.join(self.effects) or 'none'}"

    def rows(self) -> list[Row]:
        """One row a step, sequence and range of frames: what was added, rms and max [m], rms over sigma."""
        return [
            {"step": number, "added": name} | row
            for number, (name, step) in enumerate(zip(self.names, self.document["steps"], strict=True))
            for row in error_rows(errors_of(step["sequences"]))
        ]

    def plot(self) -> Figure:
        """Errors over the noise, falling from step to step."""
        series: dict[str, list[float | None]] = {}
        for row in self.rows():
            if row["frames"] != "all":
                line = series.setdefault(f"{row['sequence']}, {row['frames']}", [None] * len(self.names))
                line[row["step"]] = row["rms_over_sigma"]
        return errors_figure(self.names, series)


def extend(
    run: RunLike,
    effects: Sequence[str] | str,
    *,
    out: str | Path | None = None,
    workers: int | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Steps:
    """Add effects to a fitted model and refit, as `mphygs extend` does, to the same numbers.

    run: a result with a run, or its folder; effects: names, one step each; out: run folder, by default
    RUN-EFFECT beside RUN. Raises InputError or FailedError.
    """
    wanted = (effects,) if isinstance(effects, str) else tuple(effects)
    options = ExtendOptions(
        run=folder_of(run),
        effect=wanted,
        out=None if out is None else Path(out),
        workers=workers,
        resume=resume,
    )
    document = json_of(call(extend_run, options, progress).document)
    return Steps(Path(document["run"]), document, home_of(run))


def discover(
    capture: CaptureLike | None = None,
    *,
    out: str | Path | None = None,
    sequences: Sequence[str] | str = (),
    effects: Sequence[str] | str = (),
    frames: tuple[int, int] | None = None,
    transfer: Literal["total-lagrangian", "mls"] = "total-lagrangian",
    integrator: Literal["explicit", "implicit", "auto"] = "explicit",
    spacing: float | None = None,
    stages: str | Path | None = None,
    seed: int = 0,
    workers: int | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Steps:
    """Run the whole loop, as `mphygs discover` does, to the same numbers.

    effects: that may be added, by default every known one; out: run folder, by default a temporary one that
    goes with the result; spacing [m]; the rest as the command's options. Raises InputError or FailedError.
    """
    folder, home = place(out)

    def action(options: DiscoverOptions, console: Console) -> Answer:
        own = placed_capture(capture, folder, resume=resume, inner_runs=(FIRST,))
        return discover_command(replace(options, capture=own), console)

    options = DiscoverOptions(
        out=folder,
        sequences=comma(sequences),
        effects=comma(effects),
        frames=None if frames is None else f"{frames[0]}:{frames[1]}",
        transfer=transfer,
        integrator=integrator,
        spacing=spacing,
        stages=None if stages is None else Path(stages),
        seed=seed,
        workers=workers,
        resume=resume,
    )
    return Steps(folder, json_of(call(action, options, progress).document), home)

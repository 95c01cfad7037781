"""Which physical effect is missing, if any."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mphygs.api.calls import Home, Progress, RunLike, call, comma, folder_of, home_of, json_of
from mphygs.api.results import Row, Table
from mphygs.commands.diagnose import DiagnoseOptions
from mphygs.commands.diagnose import diagnose_command as diagnose_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Candidates that are drawn.
SHOWN = 12


@dataclass(frozen=True, eq=False)
class Diagnosis(Table):
    """What a fitted model lacks. run: of the model; document: the command's JSON."""

    run: Path
    document: Mapping[str, Any]
    _home: Home | None = field(default=None, repr=False)

    @property
    def verdict(self) -> str:
        """ "adequate", "missing", "measurement" or "unknown"."""
        return str(self.document["verdict"])

    @property
    def effects(self) -> tuple[str, ...]:
        """What it would add, most likely first."""
        return tuple(self.document["effects"])

    @property
    def advice(self) -> str:
        """What to do next, in words."""
        return str(self.document["advice"])

    def title(self) -> str:
        """Verdict and effects."""
        return f"verdict: {self.verdict}; effects: {', '.join(self.effects) or 'none'}"

    def rows(self) -> list[Row]:
        """One row a candidate, the best first: effect, kind, statistic, p_value, expected_rms [m], whether it
        was refitted, and what it is confused with."""
        told = ("effect", "kind", "statistic", "p_value", "expected_rms", "refitted")
        return [
            {key: entry[key] for key in told}
            | {"confounded_with": ", ".join(entry["confounded_with"])}
            for entry in self.document["ranking"]
        ]

    def plot(self) -> Figure:
        """What each of the best candidates would explain."""
        from matplotlib.figure import Figure

        best = self.document["ranking"][:SHOWN][::-1]
        figure = Figure(figsize=(7.0, 0.4 * len(best) + 1.2), layout="constrained")
        axes = figure.subplots()
        colours = ["#d1495b" if e["effect"] in self.effects else "#999999" for e in best]
        axes.barh([e["effect"] for e in best], [e["statistic"] or 0.0 for e in best], color=colours)
        axes.set(xlabel="chi^2 would fall by", title=self.title())
        return figure


def diagnose(
    run: RunLike,
    *,
    effects: Sequence[str] | str = (),
    force: bool = False,
    workers: int | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find what a fitted model lacks, as `mphygs diagnose` does, to the same numbers.

    effects: candidates, by default every known one; force: find the missing force in any case. Raises
    InputError or FailedError.
    """
    options = DiagnoseOptions(
        run=folder_of(run), effects=comma(effects), force=force, workers=workers, resume=resume
    )
    answer = call(diagnose_run, options, progress)
    return Diagnosis(folder_of(run), json_of(answer.document), home_of(run))

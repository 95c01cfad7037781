"""What a loop has found so far: one JSON file, written whenever a step is done, to go on from."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mphygs.capture.written import replace_file
from mphygs.diagnose.ranking import RankedEffect, Ranking
from mphygs.extend.document_checks import check_known, check_models, read_steps
from mphygs.extend.step import Step
from mphygs.extend.step_uncertainty import bounded
from mphygs.extend.steps import left_out_of, restored, state_of, step_document
from mphygs.fit.belief_document import belief_from_document, document_of_belief, plain_value
from mphygs.fit.experiment import Experiment

# Of an effect in a ranking, what a diagnosis that is resumed has to know.
_RANKED = ("effect", "label", "kind", "statistic", "p_value", "expected_ratio", "estimate", "std")


@dataclass
class LoopRecord:
    """The steps of a loop. documents: as they are told; states: what else it takes to make them again;
    ranking: of the first diagnosis, as a document, once there is one; drift: what it says would have to;
    where: the file that they are kept in."""

    documents: list[dict] = field(default_factory=list)
    states: list[dict] = field(default_factory=list)
    ranking: list[dict] | None = None
    drift: list[dict] = field(default_factory=list)
    where: str = ""

    @classmethod
    def of(cls, document: Mapping, path: Path) -> LoopRecord:
        """As the `document` in a file told it; nothing of an empty one."""
        return cls(
            list(document.get("steps", [])),
            list(document.get("states", [])),
            document.get("ranking"),
            list(document.get("drift", [])),
            str(path),
        )

    def tell(
        self,
        step: Step,
        experiment: Experiment,
        at: int | None = None,
        *,
        before: Sequence[str] = (),
        extra: Mapping[str, object] | None = None,
    ) -> None:
        """Keep a step, the next one or in the place of another. before: effects before the first step; extra:
        what else is told of it."""
        at = len(self.documents) if at is None else at
        step = bounded(step, experiment)
        inside = self.documents[at - 1]["effects"] if at else before
        self.documents[at : at + 1] = [step_document(step, experiment, inside) | dict(extra or {})]
        self.states[at : at + 1] = [state_of(step)]

    def steps(self, experiment: Experiment) -> list[Step]:
        """The steps as they were. Raises ValueError where they are not of the experiment's object."""
        check_models(self.where, self.states, experiment.capture)
        before = [(), *(document["effects"] for document in self.documents)]
        return [
            restored(experiment, state, document, earlier)
            for state, document, earlier in zip(self.states, self.documents, before, strict=False)
        ]

    def table(self, otherwise: Sequence[Mapping] = ()) -> list[Mapping]:
        """The candidates of the first round that led to a step, as that step tells them; otherwise: those of
        a round that led to none."""
        return list(next((told["table"] for told in self.documents if told["table"]), otherwise))

    def document(self, experiment: Experiment) -> dict[str, object]:
        """The JSON to go on from, with the measurements that are left out."""
        return {
            "steps": self.documents,
            "states": self.states,
            "ranking": self.ranking,
            "drift": self.drift,
            "left_out": left_out_of(experiment),
        }


def write_record(path: Path, document: Mapping[str, object]) -> None:
    """Write JSON in one go: a command that is stopped leaves the old file or the new one."""
    replace_file(path, json.dumps(document, indent=1) + "\n")


def read_record(path: Path) -> dict:
    """What is kept in a file, nothing where there is none. Raises ValueError for one that is damaged, or
    speaks of effects that are not known here."""
    kept = read_steps(path)
    if kept is None:
        return {}
    check_known(path)
    return kept


def recorded_left_out(kept: Mapping) -> dict[str, tuple[tuple[int, int], ...]]:
    """(frame, marker) by sequence of the measurements that a loop had left out."""
    return {
        name: tuple((int(frame), int(marker)) for frame, marker in entries)
        for name, entries in kept.get("left_out", {}).items()
    }


def state_of_ranking(ranking: Ranking) -> dict[str, object]:
    """What a diagnosis that is resumed has to know of a ranking: the ways in which effects were best."""
    return {
        "chi_square": ranking.chi_square,
        "rows": ranking.rows,
        "entries": [
            {key: plain_value(getattr(entry, key)) for key in _RANKED}
            | {"start": document_of_belief(entry.start)}
            for entry in ranking.entries
        ],
    }


def restored_ranking(state: Mapping) -> Ranking:
    """The ranking of a state, as far as that tells it."""
    entries = [
        RankedEffect(
            **{key: given[key] for key in _RANKED if key != "std"},
            std={name: np.inf if std is None else std for name, std in given["std"].items()},
            start=belief_from_document(given["start"]),
        )
        for given in state["entries"]
    ]
    return Ranking(tuple(entries), state["chi_square"], state["rows"], None)

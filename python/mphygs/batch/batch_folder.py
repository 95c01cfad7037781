"""The folder of a batch: what was asked for, what came of every run, and the tables."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from mphygs.batch.order import Order
from mphygs.batch.summary import Row, csv_text, row_of
from mphygs.batch.summary_page import summary_page
from mphygs.batch.work import Outcome, Task
from mphygs.capture.document import read_document
from mphygs.capture.json_values import plain
from mphygs.capture.written import replace_file

FORMAT = "mphygs-batch/1"
DOCUMENT, TABLE, PAGE = "batch.json", "summary.csv", "summary.html"


@dataclass(frozen=True)
class BatchFolder:
    """A batch in its folder. outcomes: of the runs that have ended, by name."""

    order: Order
    out: Path
    tasks: Sequence[Task]
    outcomes: dict[str, Outcome]

    @classmethod
    def of(cls, order: Order, out: Path, tasks: Sequence[Task]) -> BatchFolder:
        """A batch with what came of its runs so far. Raises ValueError for a damaged file."""
        outcomes = {task.name: _outcome(task) for task in tasks if task.outcome.is_file()}
        return cls(order, out, tasks, outcomes)

    def done(self, task: Task) -> bool:
        """Whether a run has ended well."""
        return task.name in self.outcomes and self.outcomes[task.name].done

    def end(self, task: Task, outcome: Outcome) -> None:
        """Keep what came of a run, and the tables with it."""
        self.outcomes[task.name] = outcome
        replace_file(task.outcome, json.dumps(plain(asdict(outcome)), indent=1) + "\n")
        self.write()

    def rows(self) -> list[Row]:
        """One row a run."""
        return [row_of(task, self.outcomes.get(task.name)) for task in self.tasks]

    def write(self) -> None:
        """Write the order and the tables, each file wholly or not at all."""
        rows = self.rows()
        document = {"format": FORMAT, "order": self.order.document()}
        replace_file(self.out / DOCUMENT, json.dumps(plain(document), indent=1) + "\n")
        replace_file(self.out / TABLE, csv_text(rows))
        folders = any(task.run is not None for task in self.tasks)
        title = f"{self.order.command} on {len(self.order.folders)} folders"
        replace_file(self.out / PAGE, summary_page(title, self.line(), rows, folders=folders))

    def line(self) -> str:
        """The command line that makes this batch."""
        order = self.order
        words = ["mphygs", "batch", *order.folders, "--command", order.command, "--out", str(self.out)]
        words += ["--seeds", ",".join(map(str, order.seeds))] if order.seeds else []
        words += ["--each-effect", ",".join(order.each_effect)] if order.each_effect else []
        words += ["--plugin", order.plugin] if order.plugin else []
        return shlex.join([*words, *(["--", *order.options] if order.options else [])])

    def answer(self) -> dict[str, object]:
        """The JSON of the command."""
        runs = []
        for task, row in zip(self.tasks, self.rows(), strict=True):
            outcome = self.outcomes.get(task.name)
            more = {"run": task.run, "log": task.log, "code": outcome and outcome.code}
            runs.append(row.document() | more)
        return {
            "command": self.order.command,
            "out": str(self.out),
            "table": str(self.out / TABLE),
            "page": str(self.out / PAGE),
            "runs": runs,
            "failed": [row["name"] for row in runs if row["state"] == "failed"],
        }


def remove_outcomes(tasks: Sequence[Task]) -> None:
    """Take away what an older batch has said: a run goes on only where it was begun by this one."""
    for task in tasks:
        for path in (task.log, task.outcome):
            path.unlink(missing_ok=True)


def read_order(out: Path) -> Order:
    """What the batch in a folder was asked for. Raises ValueError where there is none."""
    path = out / DOCUMENT
    if not path.is_file():
        raise ValueError(f"--resume: {out} holds no batch; expected the --out of an earlier mphygs batch")
    found = read_document(path).table()
    if found.get("format") != FORMAT or not isinstance(found.get("order"), Mapping):
        raise ValueError(f"{path}: is no {FORMAT}; expected what mphygs batch writes")
    return Order.of(found["order"], str(path))


def _outcome(task: Task) -> Outcome:
    """What came of a run, as it is kept."""
    try:
        outcome = Outcome(**read_document(task.outcome, finite=False).table())
        row_of(task, outcome)
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"{task.outcome}: is damaged; expected what mphygs batch writes") from error
    return outcome

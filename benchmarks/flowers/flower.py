"""The commands that a flower takes: its capture, then stage after stage, then all variants side by side."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Protocol

from judge import judged

from mphygs.baselines.kinds import NAMES
from mphygs.batch.work import Outcome, Task
from mphygs.capture.format import load_capture
from mphygs.capture.json_values import plain
from mphygs.capture.stages import STAGES
from mphygs.commands.batch_order import options_of
from mphygs.commands.image_stages import missing_stages

VARIANTS = {
    "full": (),
    "no-l2d": ("--without", "l2d"),
    "no-ldt": ("--without", "ldt"),
    "no-lg": ("--without", "lg"),
    "no-windows": ("--without", "windows"),
    "no-prestress": ("--without", "prestress"),
    **{name: ("--baseline", name) for name in NAMES},
}
# Options that a capture is told by, and a result.
OF_CAPTURE = ("seed", "size", "frames", "cameras", "rest_views")
OF_RESULT = (*OF_CAPTURE, "spacing", "schedule")
# What the result of a variant says until there is one.
BROKEN_OFF = "was broken off"


class Asked(Protocol):
    """The options of the benchmark that are read here."""

    out: Path
    seed: int
    size: int
    frames: int
    cameras: int
    rest_views: int
    spacing: float | None
    schedule: str
    again: bool


@dataclass
class Flower:
    """One flower in the output folder of `asked`. stages: that are wanted, None for all; variants: to fit.

    failed: why it has no capture or not all stages, empty where it has.
    """

    asked: Asked
    species: str
    variants: Sequence[str]
    stages: Sequence[str] | None = None
    failed: str = ""
    _under_way: dict[str, str] = field(default_factory=dict)
    _gone_on_with: set[str] = field(default_factory=set)

    @property
    def capture(self) -> Path:
        return self.asked.out / "captures" / self.species

    @property
    def home(self) -> Path:
        """Run folder of the stages that all variants share."""
        return self.asked.out / "runs" / self.species / "stages-of"

    @property
    def costs(self) -> dict[str, dict[str, float]]:
        """What every stage cost."""
        path = self._result("stages")
        return json.loads(path.read_text()) if path.is_file() else {}

    def next(self) -> list[Task]:
        """What can be run now, side by side."""
        try:
            return self._next()
        except (ValueError, OSError) as error:
            return self._fail(" ".join(str(error).split()))

    def _next(self) -> list[Task]:
        if not self._made():
            return [self._synth()]
        for stage in missing_stages(load_capture(self.capture), self.home / STAGES):
            if not stage.file.exists() and (self.stages is None or stage.name in self.stages):
                words = (stage.command, str(self.capture.absolute()), "--out", str(self.home.absolute()))
                takes = {option.name for option in fields(options_of(stage.command))}
                return [self._task(stage.name, (*words, *stage.arguments), limited="workers" in takes)]
        return [self._fit(variant) for variant in self.missing()]

    def ended(self, task: Task, outcome: Outcome) -> list[Task]:
        """Keep what came of a task. What can be run after it."""
        name = self._under_way.pop(task.name)
        print(f"{self.species}, {name}: {outcome.seconds:.0f} s", file=sys.stderr, flush=True)
        if name in self.variants:
            self._keep(name, outcome)
            return []
        if not outcome.done:
            return self._fail(f"mphygs {task.words[0]}: {outcome.line}")
        if name == "synth":
            _write(self.capture.with_suffix(".json"), self._given(OF_CAPTURE))
        else:
            cost = {key: getattr(outcome, key) for key in ("seconds", "processor", "memory")}
            _write(self._result("stages"), self.costs | {name: cost})
        return self.next()

    def missing(self) -> list[str]:
        """Variants without a result."""
        return [v for v in self.variants if (found := self.result(v)) is None or "error" in found]

    def result(self, variant: str) -> dict[str, object] | None:
        """The result of a variant by these options, a failure too, or none."""
        path = self._result(variant)
        found = json.loads(path.read_text()) if path.is_file() else {}
        return found if found.get("spec") == self._given(OF_RESULT) else None

    def begin(self) -> list[Task]:
        """What can be run first; results are made anew where that is asked for."""
        for variant in self.variants if self.asked.again else ():
            self._result(variant).unlink(missing_ok=True)
        return self.next() if self.missing() or self.stages is not None else []

    def _fail(self, line: str) -> list[Task]:
        """Nothing more is run of this flower now."""
        self.failed = line
        print(f"{self.species}: {line}", file=sys.stderr, flush=True)
        for variant in self.missing():
            _write(self._result(variant), self._head(variant) | {"error": line})
        return []

    def _made(self) -> bool:
        kept = self.capture.with_suffix(".json")
        return kept.is_file() and json.loads(kept.read_text()) == self._given(OF_CAPTURE)

    def _synth(self) -> Task:
        given = [word for k, v in self._given(OF_CAPTURE).items() for word in (_option(k), str(v))]
        words = ("synth", "flower", "--out", str(self.capture.absolute()), "--species", self.species, *given)
        return self._task("synth", words)

    def _fit(self, variant: str) -> Task:
        run = (self.asked.out / "runs" / self.species / variant).absolute()
        stages = str(self.home.absolute())
        words = ["fit", str(self.capture.absolute()), "--out", str(run), "--stages", stages]
        words += ["--schedule", self.asked.schedule, *VARIANTS[variant]]
        words += [] if self.asked.spacing is None else ["--spacing", str(self.asked.spacing)]
        task = self._task(variant, tuple(words), run=run, limited=True, resumable=True)
        found = self.result(variant)
        if found is None or found["error"] != BROKEN_OFF:
            shutil.rmtree(run, ignore_errors=True)
            task.log.unlink(missing_ok=True)
        elif task.log.exists():
            self._gone_on_with.add(variant)
        _write(self._result(variant), self._head(variant) | {"error": BROKEN_OFF})
        return task

    def _task(self, name: str, words: tuple[str, ...], *, run: Path | None = None, **more: bool) -> Task:
        full = f"{self.species}-{name.replace(' ', '-')}"
        self._under_way[full] = name
        logs, place = self.asked.out.absolute() / "logs", Path(os.getcwd())
        known = {"limited": False, "resumable": False} | more
        return Task(full, str(self.capture), words, run, logs, place, **known)

    def _keep(self, variant: str, outcome: Outcome) -> None:
        """The result of a variant, held against the truth."""
        entry = self._head(variant)
        try:
            if not outcome.done:
                raise ValueError(outcome.line)
            run = self.asked.out / "runs" / self.species / variant
            entry |= judged(run, self.capture, outcome.answer)
            # what was broken off and goes on has spent some before, of the processor it does not say how much
            seconds = max(outcome.seconds, float(outcome.answer.get("seconds", 0.0)))
            spent = {} if variant in self._gone_on_with else {"processor": outcome.processor}
            entry |= {"seconds": seconds, "memory": outcome.memory, "stages": self.costs} | spent
        # whatever one flower trips over, the others go on, and it is run again next time
        except (ValueError, OSError) as error:
            entry["error"] = " ".join(str(error).split())
            print(f"{self.species}, {variant}: {entry['error']}", file=sys.stderr, flush=True)
        _write(self._result(variant), entry)

    def _head(self, variant: str) -> dict[str, object]:
        return {"species": self.species, "variant": variant, "spec": self._given(OF_RESULT)}

    def _given(self, names: Sequence[str]) -> dict[str, object]:
        return {name: getattr(self.asked, name) for name in names}

    def _result(self, name: str) -> Path:
        return self.asked.out / "results" / f"{self.species}-{name}.json"


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _write(path: Path, entry: Mapping[str, object]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(plain(entry), indent=1) + "\n")
    partial.replace(path)

"""`mphygs extend RUN EFFECT...`: add effects, refit from where RUN ended, show before and after."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from mphygs.capture.json_values import plain
from mphygs.commands.claim import claim, clear
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions, OptionError
from mphygs.extend.loop_record import LoopRecord, read_record, recorded_left_out, write_record
from mphygs.extend.named_effects import add_effect
from mphygs.extend.step import FAULT
from mphygs.extend.steps import run_at, step_at, steps_text
from mphygs.fit.of_run import experiment_of
from mphygs.fit.run import load_run
from mphygs.fit.tables import parameters_of
from mphygs.model.registry import effect, effects
from mphygs.simulate.settings import check_effects

PROGRAM = "mphygs extend"
DOCUMENT = "steps.json"
ANSWER = ("steps", "verdict", "effects", "run")


@dataclass(frozen=True, kw_only=True)
class ExtendOptions(CommonOptions):
    """Add effects to a fitted model, refit from where it ended, show the error before and after."""

    run: tyro.conf.Positional[Path]
    """Run folder."""
    effect: tyro.conf.Positional[tuple[str, ...]]
    """Effects to add, one after the other."""
    out: Path | None = None
    """Run folder of the extended model; default: RUN-EFFECT beside RUN."""
    workers: int | None = None
    """Simulations side by side; default: one a core. Changes no number."""
    resume: bool = False
    """Go on in --out where it stopped."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(ExtendOptions, extend_command, program=PROGRAM, argv=argv)


def extend_command(options: ExtendOptions, console: Console) -> Answer:
    """One step per effect; each is kept as asked, and whether it pays on unseen frames is said."""
    # Commas are as good as spaces.
    wanted = [name for word in options.effect for name in word.split(",") if name]
    for name in wanted:
        if name not in effects():
            raise OptionError(f"unknown effect '{name}'; expected some of {', '.join(sorted(effects()))}")
    if not wanted:
        raise OptionError("no effect named; expected at least one to add")
    state = load_run(options.run)
    parameters_of(state)  # complete, or an error
    for number, name in enumerate(wanted):
        if name in (*state.belief.effects, state.belief.law, *wanted[:number]):
            raise OptionError(f"effect '{name}' is in the model already; expected another one")
    source = options.run.resolve()
    out = options.out or options.run.parent / "-".join([source.name, *wanted])
    check_effects(state.transfer, wanted)
    if out.resolve() == source:
        raise OptionError(f"--out {out}: is the run that is extended; expected another folder")
    kept = _recorded(out, wanted) if options.resume else {}
    if not options.resume:
        claim(out, alone=DOCUMENT)
    again = [PROGRAM, shlex.quote(str(options.run)), *wanted, "--out", shlex.quote(str(out)), "--resume"]
    if kept.get("verdict"):
        answer = {key: kept[key] for key in ANSWER}
        return Answer(answer, _text(answer, wanted))
    experiment, belief = experiment_of(
        replace(state, left_out=recorded_left_out(kept) or state.left_out), workers=options.workers
    )
    spacing = state.settings.spacing
    done = LoopRecord.of(kept, out / DOCUMENT)
    steps = done.steps(experiment) or [step_at(experiment, belief, spacing)]
    if not done.documents:
        # What the run leaves out of the measurements is an effect of it, though no term of the model.
        done.tell(steps[0], experiment, before=(FAULT,) if state.left_out else ())
    for number, name in enumerate(wanted):
        if number + 1 < len(steps):
            continue
        console.progress(number / len(wanted), f"adding {name}")
        generator = np.random.default_rng((state.seed, number))
        step, paying = add_effect(
            experiment, steps[-1], name, spacing, generator=generator, report=console.say
        )
        steps.append(step)
        done.tell(step, experiment, extra={"pays": paying})
        if not number:
            # Only now: nothing that is at fault may take an older run's results away.
            out.mkdir(parents=True, exist_ok=True)
            clear(out, ("run.json",), plugin=state.options.get("plugin"))
        write_record(out / DOCUMENT, plain(done.document(experiment) | {"asked": wanted}))
        console.resume = " ".join(again)
    documents = done.documents
    paying = [name for name, told in zip(wanted, documents[1:], strict=True) if told["pays"]]
    verdict = verdict_of(documents[0]["adequate"], paying, steps[-1].explained)
    document = {"steps": documents, "verdict": verdict, "effects": paying, "run": str(out)}
    given = {key: str(v) if isinstance(v, Path) else v for key, v in asdict(options).items()}
    given |= {"command": PROGRAM, "plugin": state.options.get("plugin")}
    extended = run_at(state, out, steps[-1], experiment, options=given, answer=document)
    extended.save()
    write_record(out / DOCUMENT, plain(document | {"asked": wanted}))
    return Answer(document, _text(document, wanted))


def verdict_of(adequate: bool, paying: Sequence[str], explained: bool) -> str:
    """The verdict of an extension.

    adequate: of the first model; paying: added effects that pay on unseen frames; explained: whether the last
    model is at the floor.
    """
    if adequate and not paying:
        return "adequate"
    if not explained:
        return "unknown"
    physics = any(effect(name).kind != "measurement" for name in paying)
    return "missing" if physics else "measurement"


def _recorded(out: Path, wanted: Sequence[str]) -> dict:
    """What was found before it was stopped. Raises OptionError where nothing is kept of these effects."""
    kept = read_record(out / DOCUMENT)
    if not kept.get("asked"):
        raise OptionError(f"--resume: {out} holds no step of {PROGRAM}; expected the --out of one")
    if kept["asked"] != list(wanted):
        raise OptionError(
            f"got {', '.join(wanted)}, but {out} was to add {', '.join(kept['asked'])}; "
            "expected the same to resume"
        )
    return kept


def _text(answer: Mapping, wanted: Sequence[str]) -> str:
    out = answer["run"]
    lines = steps_text(plain(answer["steps"]))
    lines += [f"{name} does not pay on unseen frames" for name in wanted if name not in answer["effects"]]
    lines += ["", f"run folder: {out}", f"next: mphygs compare {shlex.quote(str(out))}"]
    return "\n".join(lines)

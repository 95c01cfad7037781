"""`mphygs extend RUN EFFECT...`: add effects, refit from where RUN ended, show before and after."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import tyro

from mphygs.claim import claim, clear
from mphygs.command import Answer, CommonOptions, Console, OptionError, plain, run
from mphygs.extend.named import add_named
from mphygs.extend.steps import left_out_of, run_at, step_at, step_document, steps_text
from mphygs.fit.of_run import experiment_of
from mphygs.fit.run import load_run
from mphygs.fit.tables import parameters_of
from mphygs.model.registry import effect, effects
from mphygs.simulate.settings import check_effects

PROGRAM = "mphygs extend"
DOCUMENT = "steps.json"


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


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(ExtendOptions, extend, program=PROGRAM, argv=argv)


def extend(options: ExtendOptions, console: Console) -> Answer:
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
    source = options.run.resolve()
    out = options.out or options.run.parent / "-".join([source.name, *wanted])
    check_effects(state.transfer, wanted)
    if out.resolve() == source:
        raise OptionError(f"--out {out}: is the run that is extended; expected another folder")
    claim(out)
    experiment, belief = experiment_of(state, workers=options.workers)
    spacing = state.settings.spacing
    steps = [step_at(experiment, belief, spacing)]
    # What the run leaves out of the measurements is an effect of it, though no term of the model.
    before = ("marker_outliers",) if left_out_of(experiment) else ()
    documents = [step_document(steps[0], experiment, before)]
    pays = []
    for number, name in enumerate(wanted):
        console.progress(number / len(wanted), f"adding {name}")
        generator = np.random.default_rng((state.seed, number))
        step, paying = add_named(
            experiment, steps[-1], name, spacing, generator=generator, report=console.say
        )
        steps.append(step)
        pays.append(paying)
        documents.append(step_document(step, experiment, documents[-1]["effects"]) | {"pays": paying})
    paying = [name for name, good in zip(wanted, pays, strict=True) if good]
    physics = [name for name in paying if effect(name).kind != "measurement"]
    if steps[0].assessment.adequate:
        verdict = "adequate"
    elif not steps[-1].explained:
        verdict = "unknown"
    else:
        verdict = "missing" if physics else "measurement"
    document = {"steps": documents, "verdict": verdict, "effects": paying, "run": str(out)}
    given = {key: str(v) if isinstance(v, Path) else v for key, v in asdict(options).items()}
    given |= {"command": PROGRAM, "plugin": state.options.get("plugin")}
    extended = run_at(state, out, steps[-1], experiment, options=given, answer=document)
    clear(out)
    extended.save()
    (out / DOCUMENT).write_text(json.dumps(plain(document), indent=1) + "\n")
    lines = steps_text(plain(documents))
    lines += [f"{name} does not pay on unseen frames" for name in wanted if name not in paying]
    lines += ["", f"run folder: {out}", f"next: mphygs compare {shlex.quote(str(out))}"]
    return Answer(document, "\n".join(lines))


if __name__ == "__main__":
    sys.exit(main())

"""`mphygs fit CAPTURE`: fit materials, and the effects named, to a capture."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from mphygs.baselines.kinds import fit_baseline, maker_of
from mphygs.capture.format import Capture
from mphygs.commands.claim import clear
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.fit_begun import PROGRAM, begun, in_stages, resumed
from mphygs.commands.fit_options import FitOptions, check_options
from mphygs.commands.image_stages import recorded_seconds
from mphygs.commands.options import OptionError
from mphygs.fit.checkpointed import fit_run
from mphygs.fit.experiment import Experiment
from mphygs.fit.fit_document import fit_document, fit_text
from mphygs.fit.limits import narrowed_to_seen
from mphygs.fit.of_run import HOMOGENEOUS, baseline_of, capture_of, feedback_document
from mphygs.fit.one_sided import coarser_change, limits_of
from mphygs.fit.pictured_run import fit_pictured, with_shares
from mphygs.fit.profile import intervals
from mphygs.fit.run import Run
from mphygs.fit.sensitivity import sensitivity_of
from mphygs.simulate.settings import available_cores
from mphygs.simulate.timeline import MOST_SUBSTEPS


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(FitOptions, fit_command, program=PROGRAM, argv=argv)


def fit_command(options: FitOptions, console: Console) -> Answer:
    """Fit, write the run folder, and say what was found and what to run next."""
    state, capture = fitted(options, console)
    embedded = options.capture is None and not options.resume
    return Answer(dict(state.answer), fit_text(state, capture, embedded=embedded))


def fitted(
    options: FitOptions,
    console: Console,
    *,
    screening: bool = False,
    again: str | None = None,
    ready: Callable[[], None] | None = None,
) -> tuple[Run, Capture]:
    """The complete run of these options, and its capture.

    screening: see `plan_of`; again: the command line that goes on when it is stopped, where the fit is part
    of another command; ready: called when nothing is at fault, before anything is written.
    """
    if options.resume and not in_stages(options):
        state = resumed(options, console)
        capture = capture_of(state)
    else:
        check_options(options)
        state, capture = begun(options, console)
    settings = replace(state.settings, workers=options.workers or available_cores())
    experiment = Experiment(capture, settings, dict(state.ranges), reference=state.belief)
    # What is at fault with the capture on this grid is said here, before an older run is taken away.
    _check_duration(experiment, state)
    if not state.history and not state.answer:
        clear(state.folder, plugin=options.plugin)
    if ready is not None:
        ready()
    console.resume = again or f"{PROGRAM} --out {shlex.quote(str(state.folder))} --resume"
    state.save()
    console.say(
        f"{capture.name}: {', '.join(state.ranges)}; {len(state.belief.free)} unknowns, "
        f"grid {1e3 * state.settings.spacing:.3g} mm; run folder {state.folder}"
    )
    for recording in capture.sequences:
        for finding in () if recording.markers is None else recording.markers.findings:
            console.say(f"{recording.name}: {finding.text}")
    sensors = any(recording.sensors for recording in capture.sequences)
    if sensors and (state.options.get("schedule") == "paper" or baseline_of(state) == HOMOGENEOUS):
        console.say("sensors: compared, but not fitted, which this way of fitting does to markers alone")
    console.begin()
    baseline = baseline_of(state)
    if baseline is not None:
        extra: dict[str, object] = {}
        if baseline == "prior":
            from mphygs.synth.flower.looks import flower_looks

            extra["examples"] = partial(flower_looks, state.seed)
        state = fit_baseline(state, experiment, console.progress, **extra)
        experiment = replace(experiment, make=maker_of(state), problems={})
    elif state.stages is not None:
        state = fit_pictured(state, experiment, console)
    else:
        given = {name: str(state.options[name]) for name in ("optimiser", "schedule")}
        state = fit_run(state, experiment, **given, screening=screening, progress=console.progress)
    simulated = baseline in (None, HOMOGENEOUS)
    if state.stages is not None and simulated:
        console.say("what the grid and unsure boundaries leave open")
        state = with_shares(state, experiment, console.say)
    found = {}
    if options.intervals:
        console.say("the fit is done and kept; intervals from the likelihood:")
        found = intervals(experiment.problem(state.settings.spacing), state.belief, report=console.say)
    problem, evaluation = experiment.problem(state.settings.spacing), None
    if state.stages is None and simulated and not screening:  # the first of many models is no one's answer
        evaluation = problem.evaluate(state.belief)
        change = coarser_change(experiment, state.belief, evaluation, state.settings.spacing)
        limits = limits_of(problem, state.belief, evaluation, change)
        information, spread = narrowed_to_seen(state.belief.free, state.information, state.covariance, limits)
        state = replace(state, information=information, covariance=spread, limits=limits)
    stages = None if state.stages is None else recorded_seconds(state.stages)
    answer = fit_document(state, experiment, found, stages=stages, report=console.say)
    if evaluation is not None:
        answer["sensitivity"] = sensitivity_of(problem, state.belief, evaluation)
    if options.feedback is not None:
        console.say("predicting under feedback")
        answer["feedback"] = feedback_document(
            experiment, state.belief, state.settings.spacing, options.feedback
        )
    state = replace(state, answer=answer)
    state.save()
    return state, capture


def _check_duration(experiment: Experiment, state: Run) -> None:
    """Raises OptionError where a motion is so long that simulating it once takes hours."""
    problem = experiment.problem(state.settings.spacing)
    for name, (_, last) in state.ranges.items():
        predictor = problem.predictors[name]
        seconds = last / predictor.recording.fps
        count = seconds / predictor.stable_substep(state.start)
        if count > MOST_SUBSTEPS:
            raise OptionError(
                f"sequence '{name}': {seconds:.3g} s of motion are {count:.1g} substeps; expected at most "
                f"{MOST_SUBSTEPS:.0e} (is fps {predictor.recording.fps:g} right?), or fewer --frames"
            )

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
from mphygs.fit.countdown import Pieces
from mphygs.fit.experiment import Experiment
from mphygs.fit.fit_document import fit_document, fit_text
from mphygs.fit.limits import narrowed_to_seen
from mphygs.fit.of_run import HOMOGENEOUS, baseline_of, capture_of, feedback_document
from mphygs.fit.one_sided import amounts_of, coarser_change, limits_of
from mphygs.fit.pictured_run import fit_pictured, with_shares
from mphygs.fit.profile import intervals
from mphygs.fit.run import Run
from mphygs.fit.schedule import iterations_of, plan_of
from mphygs.fit.sensitivity import KINDS, sensitivity_of
from mphygs.simulate.settings import available_cores
from mphygs.simulate.timeline import MOST_SUBSTEPS

# What follows a fit, in iterations of it: to look at one number's limits, to compare and write down what was
# found, to see what errors of the measurement do, and to find both ends of an interval.
LIMIT, DOCUMENT, SENSITIVITY, INTERVAL = 0.5, 2.0, 2.5, 18.0
# And what a fit takes that is not made of such iterations: far longer than what follows.
OTHER = 100.0


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
    pieces = _pieces(options, state, experiment, screening, console)
    if baseline is not None:
        extra: dict[str, object] = {}
        if baseline == "prior":
            from mphygs.synth.flower.looks import flower_looks

            extra["examples"] = partial(flower_looks, state.seed)
        state = fit_baseline(state, experiment, pieces.shares("fit"), **extra)
        experiment = replace(experiment, make=maker_of(state), problems={})
    elif state.stages is not None:
        state = fit_pictured(state, experiment, console)
    else:
        given = {name: str(state.options[name]) for name in ("optimiser", "schedule")}
        state = fit_run(state, experiment, **given, screening=screening, progress=pieces.shares("fit"))
    simulated = baseline in (None, HOMOGENEOUS)
    if state.stages is not None and simulated:
        console.say("what the grid and unsure boundaries leave open")
        state = with_shares(state, experiment, console.say)
    found = {}
    if options.intervals:
        console.say("the fit is done and kept; intervals from the likelihood:")
        tell = pieces.lines("intervals", len(state.belief.free))
        found = intervals(experiment.problem(state.settings.spacing), state.belief, report=tell)
    problem, evaluation = experiment.problem(state.settings.spacing), None
    if state.stages is None and simulated and not screening:  # the first of many models is no one's answer
        tell = pieces.lines("limits", 1 + len(amounts_of(state.belief)))
        tell("the fit is done and kept; how far its numbers can be moved")
        evaluation = problem.evaluate(state.belief)
        change = coarser_change(experiment, state.belief, evaluation, state.settings.spacing)
        limits = limits_of(problem, state.belief, evaluation, change, tell)
        information, spread = narrowed_to_seen(state.belief.free, state.information, state.covariance, limits)
        state = replace(state, information=information, covariance=spread, limits=limits)
    stages = None if state.stages is None else recorded_seconds(state.stages)
    tell = console.say if stages is not None else pieces.lines("document", len(capture.sequences))
    answer = fit_document(state, experiment, found, stages=stages, report=tell)
    if evaluation is not None:
        tell = pieces.lines("sensitivity", KINDS)
        answer["sensitivity"] = sensitivity_of(problem, state.belief, evaluation, tell)
    if options.feedback is not None:
        console.say("predicting under feedback")
        answer["feedback"] = feedback_document(
            experiment, state.belief, state.settings.spacing, options.feedback
        )
    state = replace(state, answer=answer)
    state.save()
    return state, capture


def _pieces(
    options: FitOptions, state: Run, experiment: Experiment, screening: bool, console: Console
) -> Pieces:
    """The fit and what follows it, as one whole. Of a baseline, and a fit to pictures, less follows."""
    told = state.stages is None and baseline_of(state) in (None, HOMOGENEOUS) and not screening
    usual = told and state.options.get("schedule") == "fast"
    plan = plan_of(experiment.capture, state.settings.spacing, warm=False, screening=screening)
    free = len(state.belief.free)
    return Pieces(
        console.progress,
        {
            "fit": 0.0 if state.complete else iterations_of(plan) if usual else OTHER,
            "intervals": INTERVAL * free if options.intervals else 0.0,
            "limits": LIMIT * (1 + len(amounts_of(state.belief))) if told else 0.0,
            "document": DOCUMENT,
            "sensitivity": SENSITIVITY if told else 0.0,
        },
    )


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

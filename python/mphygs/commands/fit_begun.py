"""The run of a fit that begins, or goes on: its options turned into a capture, a model and frames."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from mphygs.capture.format import Capture, load_capture
from mphygs.capture.stages import STAGES
from mphygs.commands.claim import claim
from mphygs.commands.console import Console
from mphygs.commands.fit_options import FitOptions
from mphygs.commands.image_stages import has_stages, run_stages
from mphygs.commands.in_use import hold
from mphygs.commands.options import OptionError, split_names
from mphygs.fit.experiment import Experiment
from mphygs.fit.first_frames import starts_text
from mphygs.fit.image_capture import as_one_part, assembled_capture
from mphygs.fit.marker_label_repair import well_labelled
from mphygs.fit.of_run import HOMOGENEOUS, baseline_of
from mphygs.fit.pictured_run import pictured_belief
from mphygs.fit.placement import with_placed_effect
from mphygs.fit.run import Run, capture_digest, folder_name, is_run, load_run
from mphygs.fit.spacings import check_spacing, default_spacing
from mphygs.fit.start import starting_belief
from mphygs.model.substances import substances_by_part
from mphygs.simulate.settings import Settings

PROGRAM = "mphygs fit"
RUNS = Path("runs")
# Options that change no number: a resumed fit may have others.
_FREE_TO_CHANGE = ("json", "resume", "workers", "out", "intervals", "feedback")


def _check_intervals(options: FitOptions, *, pictures: bool) -> None:
    if options.intervals and pictures:
        raise OptionError("--intervals: got a capture in pictures; expected one with markers")


def _check_plain(options: FitOptions, capture: Capture) -> None:
    """What a baseline that moves the object by a model of its own does not know of. Raises OptionError."""
    for recording in capture.sequences:
        more = "sensors" if recording.sensors else "loads of numbers in a file" if recording.actuators else ""
        if more:
            raise OptionError(
                f"--baseline {options.baseline}: sequence '{recording.name}' has {more}; expected none"
            )


def begun(options: FitOptions, console: Console) -> tuple[Run, Capture]:
    """A run that begins, and its capture."""
    out, stages = options.out, None
    if options.capture is None:
        from mphygs.synth.embedded import embedded_capture

        out = out or RUNS / "embedded"
        claim(out, plugin=options.plugin)
        console.say("no capture given: making a small one with known truth and a hidden effect")
        path = embedded_capture(out / "capture")
        capture = load_capture(path)
    else:
        path = options.capture
        capture = well_labelled(load_capture(path))
        out = out or RUNS / folder_name(capture.name)
        claim(out, plugin=options.plugin)
        _check_intervals(options, pictures=has_stages(capture))
        stages, capture = _assembled_from_stages(options, capture, out, console)
    if options.baseline not in (None, HOMOGENEOUS, "prior"):
        _check_plain(options, capture)
    if stages is None and options.baseline == "prior":
        raise OptionError(f"--baseline prior: {path} has markers; expected a capture in pictures")
    if stages is None and options.baseline == HOMOGENEOUS:
        capture = as_one_part(capture)
    if stages is None and (options.without or options.stages):
        name = "--without" if options.without else "--stages"
        raise OptionError(f"{name}: {path} has markers; expected a capture in pictures")
    settings = Settings(
        spacing=options.spacing or default_spacing(capture),
        transfer=options.transfer,
        integrator=options.integrator,
    )
    wanted = split_names(options.sequences)
    if options.preset is not None:
        try:
            substances_by_part(options.preset, [part.name for part in capture.parts])
        except ValueError as error:
            raise OptionError(f"--preset: {error}") from error
    belief = starting_belief(capture, prestress=options.prestress, law=options.law, preset=options.preset)
    if stages is not None:
        belief = pictured_belief(
            belief, stages, without=split_names(options.without), homogeneous=options.baseline == HOMOGENEOUS
        )
    for line in starts_text(capture, belief):
        console.say(line)
    experiment = chosen_ranges(capture, settings, wanted, options.frames)
    belief = experiment.starting(belief)
    for name in split_names(options.effects):
        belief = with_placed_effect(belief, name, capture, tuple(experiment.fitted))
    given = {k: str(v) if isinstance(v, Path) else v for k, v in asdict(options).items()}
    if options.plugin is not None:
        given["plugin"] = str(options.plugin.resolve())
    state = Run(
        folder=out, options=given, seed=options.seed, capture=path, digest=capture_digest(capture),
        settings=settings, ranges=dict(experiment.fitted),
        start=belief, belief=belief, stages=stages,
    )  # fmt: skip
    return state, capture


def chosen_ranges(
    capture: Capture, settings: Settings, wanted: Sequence[str], frames: str | None
) -> Experiment:
    """The experiment on the sequences and frames of the options. Raises OptionError."""
    check_spacing(capture, settings.spacing, "--spacing")
    try:
        experiment = Experiment.of(
            capture, settings, sequences=wanted or None, frames=_frames(frames, capture, wanted)
        )
    except KeyError as error:
        raise OptionError(f"--sequences: {error.args[0]}") from error
    missing = [name for name in wanted if name not in experiment.fitted]
    if missing:
        raise OptionError(
            f"--sequences: '{missing[0]}' has no markers or no frames to fit; expected both, or --frames i:j"
        )
    return experiment


def in_stages(options: FitOptions) -> bool:
    """Whether the run in --out was broken off before its fit began."""
    folder = options.out
    return (
        folder is not None
        and not is_run(folder)
        and (folder / STAGES).is_dir()
        and options.capture is not None
    )


def _assembled_from_stages(
    options: FitOptions, capture: Capture, out: Path, console: Console
) -> tuple[Path | None, Capture]:
    """Folder of the stages, None where none is needed, and the capture with what they found."""
    if not has_stages(capture):
        return None, capture
    home = options.stages or out
    again = f"{PROGRAM} {shlex.quote(str(options.capture))} --out {shlex.quote(str(out))}"
    console.resume = again + (f" --stages {shlex.quote(str(home))}" if options.stages else "")
    run_stages(capture, options.capture, home, console)
    whole = assembled_capture(capture, home / STAGES)
    return home / STAGES, as_one_part(whole) if options.baseline == HOMOGENEOUS else whole


def _frames(text: str | None, capture: Capture, wanted: Sequence[str]) -> tuple[int, int] | None:
    """Frames [i, j) of the text "i:j", within every sequence that they are for."""
    if text is None:
        return None
    try:
        first, last = (int(number) for number in text.split(":"))
    except ValueError as error:
        raise OptionError(f"--frames: got '{text}'; expected i:j, two frame numbers") from error
    for recording in capture.sequences:
        fitted = recording.name in wanted if wanted else recording.fit[1] > recording.fit[0]
        if fitted and not 0 <= first < last <= recording.frames:
            raise OptionError(
                f"--frames: got '{text}'; expected 0 <= i < j <= {recording.frames} for {recording.name}"
            )
    return first, last


def _default_folder(options: FitOptions) -> Path:
    """Where a run of these options is kept when they do not say."""
    return RUNS / (folder_name(load_capture(options.capture).name) if options.capture else "embedded")


def resumed(options: FitOptions, console: Console) -> Run:
    """The run to continue; options given again must be those it began with."""
    folder = options.out or _default_folder(options)
    state = load_run(folder)
    hold(folder)
    for key, default in asdict(FitOptions()).items():
        value = getattr(options, key)
        stored = state.options.get(key, default)
        if key in _FREE_TO_CHANGE or value == default:
            continue
        if key == "capture":
            same = value.resolve() == state.capture.resolve()
        elif isinstance(value, Path):
            same = stored is not None and value.resolve() == Path(stored).resolve()
        else:
            same = value == stored
        if not same:
            raise OptionError(
                f"--{key}: got {value}, but {folder} began with {stored}; expected the same options to resume"
            )
    _check_intervals(options, pictures=state.stages is not None)
    if state.complete and baseline_of(state) in (None, HOMOGENEOUS):
        console.say(f"{folder}: the fit is complete")
    else:
        console.say(f"{folder}: continuing after {len(state.history)} stages")
    return state

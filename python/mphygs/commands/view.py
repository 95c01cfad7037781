"""`mphygs view RUN`: a live 3D viewer in the browser; move a number and see the motion follow."""

from __future__ import annotations

import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mphygs.capture.json_values import plain
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions, OptionError, split_names
from mphygs.fit.of_run import chosen_names, experiment_of
from mphygs.fit.run import load_run
from mphygs.fit.tables import parameters_of
from mphygs.report.live import live_page, live_server, moved_belief, without_effects
from mphygs.report.models import VERTICES, ShownModel, motion_of, scene_document
from mphygs.report.skin import skin_of

PROGRAM = "mphygs view"


@dataclass(frozen=True, kw_only=True)
class ViewOptions(CommonOptions):
    """A live 3D viewer of measured and predicted motion, with a slider for every fitted number and a switch
    for every effect."""

    run: tyro.conf.Positional[Path]
    """Run folder."""
    sequences: Annotated[str | None, tyro.conf.arg(metavar="A,B")] = None
    """Sequences to show; default: all that can be compared."""
    port: int = 8080
    """Port on this machine; 0: any free one."""
    browser: bool = False
    """Open the page in the default browser."""
    workers: int | None = None
    """Simulations side by side; default: one a core. Changes no number."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(ViewOptions, view_command, program=PROGRAM, argv=argv)


def view_command(options: ViewOptions, console: Console) -> Answer:
    """Serve the page until Ctrl-C."""
    if not 0 <= options.port < 65536:
        raise OptionError(f"--port: got {options.port}; expected 0 to 65535")
    state = load_run(options.run)
    parameters_of(state)  # complete, or an error
    experiment, belief = experiment_of(state, workers=options.workers)
    wanted = chosen_names(experiment, split_names(options.sequences))

    skin = skin_of(experiment.capture.parts, VERTICES)

    def simulate(
        name: str, positions: Mapping[str, object], off: Sequence[object]
    ) -> dict[str, object]:
        if name not in wanted:
            raise ValueError(f"sequence '{name}': expected one of {', '.join(wanted)}")
        moved = without_effects(moved_belief(belief, positions), off)
        model = ShownModel("model", moved, state.settings.spacing)
        motion, error = motion_of(experiment, (model,), name, state, skin)
        rms = float(np.sqrt(np.nanmean(error**2)))
        return plain({"motion": motion, "rms": rms, "over_noise": rms / motion["sigma"] / np.sqrt(3.0)})

    motions = {}
    for number, name in enumerate(wanted):
        console.progress(number / len(wanted), f"simulating {name}")
        experiment.predictor(name, state.settings.spacing)
        motions[name] = simulate(name, {}, ())["motion"]
    shown = plain(scene_document(experiment, skin, motions))
    try:
        server = live_server(options.port, live_page(experiment.capture.name, belief, shown), simulate)
    except OSError as error:
        raise OptionError(
            f"--port {options.port}: cannot be used ({error.strerror}); expected a free port"
        ) from error
    address = f"http://127.0.0.1:{server.server_address[1]}/"
    console.say(f"{address}   (Ctrl-C ends)")
    if options.browser:
        webbrowser.open(address)
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        console.say("ended")
    finally:
        server.server_close()
    return Answer({"run": str(state.folder), "address": address}, f"{address} was open")

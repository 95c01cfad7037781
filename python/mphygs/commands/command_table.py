"""`mphygs COMMAND`: the table of all commands, and the one that is named first run."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from types import ModuleType

from mphygs.commands.command import AT_FAULT, DONE, INTERRUPTED

COMMANDS = {
    "reconstruct": "Gaussians of the object at rest, from its dense views",
    "segment": "features, particles and segments of the object at rest",
    "fit": "fit materials, and the effects named, to a capture",
    "predict": "simulate a fitted model on any sequence of the same object",
    "compare": "prediction beside measurement: how far, where and when",
    "diagnose": "which physical effect is missing, if any",
    "extend": "add effects, refit, show before and after",
    "discover": "fit, compare, diagnose, extend, until the error is explained",
    "batch": "one of these on many folders side by side, and one table of them",
    "report": "one self-contained HTML file",
    "view": "a live 3D viewer in the browser",
    "register": "where the object at rest is in frame 0 of its videos",
    "track": "points of the object followed through its videos",
    "contact": "what a hand holds, and how it moves",
    "init": "a capture.json for a folder of files",
    "doctor": "checks of a capture before a fit",
    "synth": "a capture with known truth",
}


def module_of(command: str) -> ModuleType:
    """The module of a command: its `main`, and its options as `<Command>Options`."""
    return importlib.import_module(f"mphygs.commands.{command}")


def usage() -> str:
    """What can be called."""
    lines = [f"  {name.ljust(13)}{summary}" for name, summary in COMMANDS.items()]
    return "\n".join(["usage: mphygs COMMAND [OPTIONS]    (mphygs COMMAND --help shows them)", "", *lines])


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that is named first; returns its exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments and arguments[0] in ("-h", "--help"):
        sys.stdout.write(usage() + "\n")
        return DONE
    if not arguments or arguments[0] not in COMMANDS:
        given = f"unknown command '{arguments[0]}'" if arguments else "no command"
        sys.stderr.write(f"mphygs: {given}; expected one of {', '.join(COMMANDS)}\n")
        return AT_FAULT
    try:
        module = module_of(arguments[0])
    except KeyboardInterrupt:
        # Loading takes seconds; nothing has begun.
        sys.stderr.write(f"mphygs {arguments[0]}: interrupted\n")
        return INTERRUPTED
    return module.main(arguments[1:])

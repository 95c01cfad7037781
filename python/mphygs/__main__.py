"""`mphygs COMMAND`: one name for all commands; each is a module of its own as well."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from mphygs.command import AT_FAULT, DONE, INTERRUPTED

COMMANDS = {
    "reconstruct": ("mphygs.reconstruct", "Gaussians of the object at rest, from its dense views"),
    "segment": ("mphygs.segment", "features, particles and segments of the object at rest"),
    "fit": ("mphygs.fit.__main__", "fit materials, and the effects named, to a capture"),
    "predict": ("mphygs.predict", "simulate a fitted model on any sequence of the same object"),
    "compare": ("mphygs.compare.__main__", "prediction beside measurement: how far, where and when"),
    "diagnose": ("mphygs.diagnose.__main__", "which physical effect is missing, if any"),
    "extend": ("mphygs.extend.__main__", "add effects, refit, show before and after"),
    "discover": ("mphygs.discover", "fit, compare, diagnose, extend, until the error is explained"),
    "batch": ("mphygs.batch.__main__", "one of these on many folders side by side, and one table of them"),
    "report": ("mphygs.report.__main__", "one self-contained HTML file"),
    "view": ("mphygs.view", "a live 3D viewer in the browser"),
    "register": ("mphygs.register", "where the object at rest is in frame 0 of its videos"),
    "track": ("mphygs.track", "points of the object followed through its videos"),
    "contact": ("mphygs.contact", "what a hand holds, and how it moves"),
    "init": ("mphygs.init", "a capture.json for a folder of files"),
    "doctor": ("mphygs.doctor", "checks of a capture before a fit"),
    "synth": ("mphygs.synth.__main__", "a capture with known truth"),
}


def usage() -> str:
    """What can be called."""
    lines = [f"  {name.ljust(13)}{summary}" for name, (_, summary) in COMMANDS.items()]
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
        module = importlib.import_module(COMMANDS[arguments[0]][0])
    except KeyboardInterrupt:
        # Loading takes seconds; nothing has begun.
        sys.stderr.write(f"mphygs {arguments[0]}: interrupted\n")
        return INTERRUPTED
    return module.main(arguments[1:])


if __name__ == "__main__":
    sys.exit(main())

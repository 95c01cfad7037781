"""Makes the capture of one case and seed: a run of its own, for truth by finite elements takes minutes.

    python benchmarks/hidden_effects/make.py CASE SEED FOLDER [--json]
"""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro
from cases import CASES, Case

from mphygs.capture.json_values import plain
from mphygs.synth.make import make_capture

# Beside a capture, what it was made of: written last.
MADE_OF = "case.json"


@dataclass(frozen=True)
class Options:
    """Make the capture of one case."""

    case: tyro.conf.Positional[str]
    """Its name."""
    seed: tyro.conf.Positional[int]
    """Seed of materials, marker places and noise."""
    folder: tyro.conf.Positional[Path]
    """The capture's; what is there is replaced."""
    json: bool = False
    """Print one JSON object."""


def made_of(case: Case, seed: int) -> dict[str, object]:
    """What tells the capture of a case and seed from others."""
    return plain({"case": asdict(case), "seed": seed})


def is_made(folder: Path, case: Case, seed: int) -> bool:
    """Whether a folder holds the whole capture of a case and seed."""
    kept = folder / MADE_OF
    return kept.is_file() and json.loads(kept.read_text()) == made_of(case, seed)


def main() -> int:
    """Make it."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    case = next((case for case in CASES if case.name == options.case), None)
    if case is None:
        print(f"'{options.case}': expected one of {', '.join(c.name for c in CASES)}", file=sys.stderr)
        return 2
    shutil.rmtree(options.folder, ignore_errors=True)
    make_capture(case.recipe(options.seed), options.folder)
    (options.folder / MADE_OF).write_text(json.dumps(made_of(case, options.seed)) + "\n")
    if options.json:
        print(json.dumps({"capture": str(options.folder)}))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Flowers from pixels to prediction: full method, its ablations and what others do, one table.

    python benchmarks/flowers/run.py [--species daisy,lily] [--variants full,no-l2d] [--out DIR] [--json]

Captures, stages, runs and results are kept in the output folder; what is there already is not done again, so
an interrupted benchmark goes on where it stopped. Every command runs in a process of its own, on workers as
`mphygs batch` has them; its time and peak memory are measured.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from flower import VARIANTS, Flower
from judge import segments
from table import document, markdown

from mphygs.batch.run_on_workers import exit_code_of, run_on_workers
from mphygs.batch.work import Outcome, Task
from mphygs.capture.json_values import plain
from mphygs.capture.stages import STAGES
from mphygs.synth.flower import SPECIES

TEN = tuple(SPECIES)[:10]


@dataclass(frozen=True)
class Options:
    """Make flowers, find what they are made of from their videos, and say how well it went."""

    species: Annotated[str, tyro.conf.arg(metavar="a,b")] = ",".join(TEN)
    """Flowers to make."""
    variants: Annotated[str, tyro.conf.arg(metavar="a,b")] = ",".join(VARIANTS)
    """The full method, and what it is held against."""
    out: Path = Path("runs/flowers")
    """Folder for captures, runs and results."""
    seed: int = 0
    """Of growth, materials, motions and textures."""
    size: int = 256
    """Width and height of the pictures [px]."""
    frames: int = 100
    """Of each motion."""
    cameras: int = 5
    """That see the motions."""
    rest_views: int = 32
    """Pictures of the flower at rest."""
    spacing: float | None = None
    """Grid spacing of the fits [m]; default: theirs."""
    schedule: str = "fast"
    """Of the fits: fast or paper."""
    workers: int = 1
    """Commands side by side on this machine."""
    threads: int | None = None
    """Of each of them; default: the cores, shared out."""
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="tcp://HOST:PORT")] = None
    """Of dask.distributed, whose workers are used."""
    segments_only: bool = False
    """Stop where the segments are found, and say how well they agree with the true parts."""
    again: bool = False
    """Fit again where there is a result; captures and stages are kept."""
    json: bool = False
    """Print one JSON object on standard output, and the rest on standard error."""


def grown(flowers: list[Flower], options: Options) -> None:
    """Run all that the flowers still take."""
    first = {task: flower for flower in flowers for task in flower.begin()}
    of = {task.name: flower for task, flower in first.items()}

    def ended(task: Task, outcome: Outcome) -> list[Task]:
        flower = of.pop(task.name)
        after = flower.ended(task, outcome)
        of.update((one.name, flower) for one in after)
        return after

    run_on_workers(list(first), ended, options)


def segmented(options: Options, species: list[str]) -> int:
    """Find the segments of every flower, print a table of them. Returns the exit code."""
    flowers = [Flower(options, name, (), ("reconstruct", "segment")) for name in species]
    grown(flowers, options)
    rows = {}
    for flower in flowers:
        if flower.failed:
            continue
        seconds = {f"{stage}_seconds": cost["seconds"] for stage, cost in flower.costs.items()}
        rows[flower.species] = segments(flower.home / STAGES, flower.capture) | seconds
    failed = int(len(rows) < len(flowers))
    if options.json:
        print(json.dumps(plain(rows)))
        return failed
    print("|  | segments | adjusted Rand index | merged |\n| --- | --- | --- | --- |")
    for name, row in rows.items():
        both = f"{row['adjusted_rand_index']:.2f} | {row['adjusted_rand_index_merged']:.2f}"
        print(f"| {name} | {row['segments']} | {both} |")
    if rows:
        means = [
            sum(row[key] for row in rows.values()) / len(rows)
            for key in ("adjusted_rand_index", "adjusted_rand_index_merged")
        ]
        print(f"| mean |  | {means[0]:.2f} | {means[1]:.2f} |")
    return failed


def main() -> int:
    """Run, print, and keep everything in the output folder."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    species = [name.strip() for name in options.species.split(",") if name.strip()]
    variants = [name.strip() for name in options.variants.split(",") if name.strip()]
    for name, known in [*((s, SPECIES) for s in species), *((v, VARIANTS) for v in variants)]:
        if name not in known:
            print(f"'{name}': expected some of {', '.join(known)}", file=sys.stderr)
            return 2
    return exit_code_of(lambda: tabled(species, variants, options), partial(print, file=sys.stderr))


def tabled(species: list[str], variants: list[str], options: Options) -> int:
    """Run all that is asked for, and tell it. Returns the exit code."""
    if options.segments_only:
        return segmented(options, species)
    flowers = [Flower(options, name, variants) for name in species]
    grown(flowers, options)
    records = [flower.result(variant) for flower in flowers for variant in variants]
    found = document(records)
    (options.out / "table.json").write_text(json.dumps(found, indent=1) + "\n")
    text = markdown(found)
    (options.out / "README.md").write_text(text)
    print(text, file=sys.stderr if options.json else sys.stdout)
    if options.json:
        print(json.dumps(found))
    return 1 if any("error" in entry for entry in records) else 0


if __name__ == "__main__":
    sys.exit(main())

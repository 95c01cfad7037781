"""Flowers from pixels to prediction: full method, its ablations and a homogeneous model, one table.

    python benchmarks/flowers/run.py [--species daisy,lily] [--variants full,no-l2d] [--out DIR] [--json]

Captures, stages, runs and results are kept in the output folder; what is there already is not done again, so
an interrupted benchmark goes on where it stopped. Every command runs in a process of its own, whose time and
peak memory are measured.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro
from judge import judged, segments
from table import document, markdown

from mphygs.baselines.kinds import NAMES
from mphygs.capture.format import load_capture
from mphygs.capture.json_values import plain
from mphygs.capture.stages import STAGES
from mphygs.commands.image_stages import missing_stages
from mphygs.synth.flower import SPECIES

TEN = tuple(SPECIES)[:10]
VARIANTS = {
    "full": (),
    "no-l2d": ("--without", "l2d"),
    "no-ldt": ("--without", "ldt"),
    "no-lg": ("--without", "lg"),
    "no-windows": ("--without", "windows"),
    "no-prestress": ("--without", "prestress"),
    **{name: ("--baseline", name) for name in NAMES},
}

# What the result of a variant says until there is one.
BROKEN_OFF = "was broken off"


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
    workers: int = os.cpu_count() or 1
    """Simulations side by side."""
    segments_only: bool = False
    """Stop where the segments are found, and say how well they agree with the true parts."""
    again: bool = False
    """Fit again where there is a result; captures and stages are kept."""
    json: bool = False
    """Print one JSON object on standard output, and the rest on standard error."""


class CommandError(RuntimeError):
    """A command that failed: its last line."""


def measured(arguments: list[str], log: Path) -> dict[str, float | dict]:
    """Run `mphygs ARGUMENTS --json`. Seconds, those of the processor, peak memory [byte] and the answer.

    Raises CommandError.
    """
    began = time.perf_counter()
    log.parent.mkdir(parents=True, exist_ok=True)
    answer = log.with_suffix(".json")
    command = [sys.executable, "-m", "mphygs", *arguments, "--json"]
    with log.open("a") as errors, answer.open("w") as out:
        child = subprocess.Popen(command, stdout=out, stderr=errors)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        lines = log.read_text().strip().splitlines()
        raise CommandError(f"mphygs {arguments[0]}: {lines[-1] if lines else 'failed'}")
    seconds = time.perf_counter() - began
    return {
        "seconds": seconds,
        "processor": usage.ru_utime + usage.ru_stime,
        "memory": 1024 * usage.ru_maxrss,
        "answer": json.loads(answer.read_text()),
    }


def made(options: Options, species: str) -> Path:
    """The capture of a flower, made unless it is there."""
    folder = options.out / "captures" / species
    keys = ("seed", "size", "frames", "cameras", "rest_views")
    wanted, kept = {key: getattr(options, key) for key in keys}, folder.with_suffix(".json")
    if kept.is_file() and json.loads(kept.read_text()) == wanted:
        return folder
    given = [part for k in keys for part in (f"--{k.replace('_', '-')}", str(wanted[k]))]
    arguments = ["synth", "flower", "--out", str(folder), "--species", species, *given]
    measured(arguments, options.out / "logs" / f"{species}-synth.log")
    _write(kept, wanted)
    return folder


def staged(
    options: Options, species: str, capture: Path, wanted: tuple[str, ...] | None = None
) -> tuple[Path, dict[str, dict[str, float]]]:
    """Run folder with the stages of a flower, and what each cost, kept beside it. wanted: None for all."""
    home = options.out / "runs" / species / "stages-of"
    kept = options.out / "results" / f"{species}-stages.json"
    costs = json.loads(kept.read_text()) if kept.is_file() else {}
    for stage in missing_stages(load_capture(capture), home / STAGES):
        if stage.file.exists() or (wanted is not None and stage.name not in wanted):
            continue
        print(f"    {stage.name}", file=sys.stderr, flush=True)
        log = options.out / "logs" / f"{species}-{stage.name.replace(' ', '-')}.log"
        found = measured([stage.command, str(capture), "--out", str(home), *stage.arguments], log)
        costs[stage.name] = {key: found[key] for key in ("seconds", "processor", "memory")}
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(costs, indent=1) + "\n")
    return home, costs


def segmented(options: Options, species: list[str]) -> int:
    """Find the segments of every flower, print a table of them. Returns the exit code."""
    rows, failed = {}, 0
    for name in species:
        print(name, file=sys.stderr, flush=True)
        try:
            capture = made(options, name)
            home, costs = staged(options, name, capture, ("reconstruct", "segment"))
            seconds = {f"{stage}_seconds": costs[stage]["seconds"] for stage in costs}
            rows[name] = segments(home / STAGES, capture) | seconds
        except (CommandError, ValueError, OSError) as error:
            failed = 1
            print(f"    {' '.join(str(error).split())}", file=sys.stderr, flush=True)
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


def fitted(
    options: Options, species: str, variant: str, capture: Path, home: Path, *, again: bool
) -> dict[str, object]:
    """One variant fitted, judged by the truth. again: it was broken off, and goes on where it was."""
    run = options.out / "runs" / species / variant
    if not again:
        shutil.rmtree(run, ignore_errors=True)
    arguments = ["fit", str(capture), "--out", str(run), "--stages", str(home)]
    arguments += ["--schedule", options.schedule, *VARIANTS[variant]]
    if options.spacing is not None:
        arguments += ["--spacing", str(options.spacing)]
    if again and (run / "run.json").is_file():
        arguments = ["fit", "--out", str(run), "--resume"]
    arguments += ["--workers", str(options.workers)]
    found = measured(arguments, options.out / "logs" / f"{species}-{variant}.log")
    entry = judged(run, capture, found["answer"])
    # what was broken off and goes on has spent some before
    seconds = max(found["seconds"], float(found["answer"].get("seconds", 0.0)))
    spent = {} if again else {"processor": found["processor"]}  # what was broken off did not tell
    return entry | {"seconds": seconds, "memory": found["memory"]} | spent


def records_of(options: Options, species: str, variants: list[str]) -> list[dict[str, object]]:
    """The results of one flower, those that are there already and new ones; a failure is one as well."""
    results = options.out / "results"
    results.mkdir(parents=True, exist_ok=True)
    keys = ("seed", "size", "frames", "cameras", "rest_views", "spacing", "schedule")
    spec = {key: asdict(options)[key] for key in keys}
    records, capture, home, costs = [], None, None, {}
    for variant in variants:
        path = results / f"{species}-{variant}.json"
        known = json.loads(path.read_text()) if path.is_file() and not options.again else {}
        same = known.get("spec") == spec
        if same and "error" not in known:
            records.append(known)
            continue
        print(f"{species}, {variant}", file=sys.stderr, flush=True)
        entry = {"species": species, "variant": variant, "spec": spec}
        _write(path, entry | {"error": BROKEN_OFF})
        try:
            if capture is None:
                capture = made(options, species)
                home, costs = staged(options, species, capture)
            again = same and known["error"] == BROKEN_OFF
            entry |= fitted(options, species, variant, capture, home, again=again) | {"stages": costs}
        # whatever one flower trips over, the others go on, and it is run again next time
        except (CommandError, ValueError, OSError) as error:
            entry["error"] = " ".join(str(error).split())
            print(f"    {entry['error']}", file=sys.stderr, flush=True)
        _write(path, entry)
        records.append(plain(entry))
    return records


def _write(path: Path, entry: dict[str, object]) -> None:
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(plain(entry), indent=1) + "\n")
    partial.replace(path)


def main() -> int:
    """Run, print, and keep everything in the output folder."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    species = [name.strip() for name in options.species.split(",") if name.strip()]
    variants = [name.strip() for name in options.variants.split(",") if name.strip()]
    for name, known in [*((s, SPECIES) for s in species), *((v, VARIANTS) for v in variants)]:
        if name not in known:
            print(f"'{name}': expected some of {', '.join(known)}", file=sys.stderr)
            return 2
    if options.segments_only:
        return segmented(options, species)
    records = [entry for name in species for entry in records_of(options, name, variants)]
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

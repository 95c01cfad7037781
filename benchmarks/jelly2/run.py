"""Speed of both transfers beside Taichi, Warp and plain PyTorch, on one workload in one run.

    pip install . -r benchmarks/jelly2/requirements.txt
    python benchmarks/jelly2/run.py

Each peer runs in a process of its own, one after the other, `--repeats` rounds; the numbers are
medians of the rounds. With one thread the time is the process's CPU time, which another program on
the same machine does not lengthen; with more it is the wall clock's.
"""

import argparse
import importlib
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import workload

PEERS = ("mphygs", "total_lagrangian", "taichi", "warp", "torch")
TITLES = {"total_lagrangian": "mphygs, total Lagrangian"}
OWN = ("mphygs", "total_lagrangian")
ONE_CORE = ("warp",)
BEGIN, END = "<!-- jelly2 begin -->", "<!-- jelly2 end -->"


def measure(peer: str, work: workload.Workload, threads: int) -> dict:
    """One peer's times [ns per particle and substep], its final heights and its gradient."""
    program = importlib.import_module(f"peer_{peer}").Peer(work, threads)
    clock = time.process_time if threads == 1 else time.perf_counter
    program.forward()  # compilation, memory
    program.gradient()
    start = clock()
    positions = program.forward()
    middle = clock()
    gradient = program.gradient()
    end = clock()
    count = getattr(program, "count", work.count)
    return {
        "forward": (middle - start) * 1e9 / (count * work.forward_steps),
        "both": (end - middle) * 1e9 / (count * work.gradient_steps),
        "height": float(positions[:, 2].mean()),
        "gradient": gradient.tolist(),
    }


def reference(work: workload.Workload, peer: str) -> list[float]:
    """The gradient by central differences of a float64 run of one of this package's transfers."""
    program = importlib.import_module(f"peer_{peer}").Peer(work, 1, double=True)
    result = []
    for material in range(2):
        sums = []
        for sign in (1, -1):
            young = list(workload.YOUNG)
            young[material] *= 1 + sign * 1e-4
            sums.append(program.forward(work.gradient_steps, tuple(young))[:, 2].sum())
        result.append(float((sums[0] - sums[1]) / (2e-4 * workload.YOUNG[material])))
    return result


def in_own_process(arguments: list[str], threads: int) -> dict:
    """The JSON that this file prints for one measurement."""
    environment = dict(os.environ, OMP_NUM_THREADS=str(threads), MKL_NUM_THREADS=str(threads))
    command = [sys.executable, str(Path(__file__).resolve()), *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"jelly2: {' '.join(arguments)} failed:\n{done.stderr.strip()[-2000:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def difference(gradient: list[float], truth: list[float]) -> float:
    """Largest error of the two derivatives of the loss by log E, over the larger of the two."""
    scale = [g * e for g, e in zip(truth, workload.YOUNG, strict=True)]
    error = [(a - b) * e for a, b, e in zip(gradient, truth, workload.YOUNG, strict=True)]
    return float(np.max(np.abs(error)) / np.max(np.abs(scale)))


def table(rows: list[dict]) -> str:
    """Markdown; ratios are over this package at the same number of threads."""
    titles = ["particles", "threads", "", "forward", "ratio", "with gradient", "ratio"]
    titles += ["with gradient / forward", "error of dE"]
    lines = ["| " + " | ".join(cells) + " |" for cells in (titles, ["---"] * len(titles))]
    for row in rows:
        own = next(r for r in rows if r["peer"] == "mphygs" and r["key"] == row["key"])
        cells = [str(row["key"][0]), str(row["key"][1]), TITLES.get(row["peer"], row["peer"])]
        for kind in ("forward", "both"):
            cells += [f"{row[kind]:.1f}", f"{row[kind] / own[kind]:.1f}"]
        cells += [f"{row['both'] / row['forward']:.1f}", f"{row['error']:.0e}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write(text: str) -> None:
    """Replaces the section of benchmarks/README.md."""
    path = Path(__file__).resolve().parents[1] / "README.md"
    page = path.read_text() if path.exists() else "# Benchmarks\n"
    if BEGIN not in page:
        page = f"{page.rstrip()}\n\n## jelly2: speed beside peers\n\n{BEGIN}\n{END}\n"
    before, rest = page.split(BEGIN)
    path.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}")


def compare(options: argparse.Namespace) -> list[dict]:
    """All rounds of all peers; rows of medians."""
    rows = []
    for particles in options.particles:
        truth = {
            peer: in_own_process(["--reference", peer, "--particles", str(particles)], 1)["gradient"]
            for peer in OWN
            if peer in options.peers
        }
        for threads in options.threads:
            peers = [p for p in options.peers if threads == 1 or p not in ONE_CORE]
            rounds = {p: [] for p in peers}
            for repeat in range(options.repeats):
                for peer in peers:
                    sys.stderr.write(f"{particles} particles, {threads} threads, {repeat + 1}: {peer}\n")
                    size = ["--particles", str(particles), "--threads", str(threads)]
                    arguments = ["--measure", peer, *size]
                    rounds[peer].append(in_own_process(arguments, threads))
            for peer in peers:
                rows.append(
                    {
                        "peer": peer,
                        "key": (workload.jelly2(particles).count, threads),
                        "forward": statistics.median(r["forward"] for r in rounds[peer]),
                        "both": statistics.median(r["both"] for r in rounds[peer]),
                        "error": difference(rounds[peer][0]["gradient"], truth.get(peer, truth["mphygs"])),
                    }
                )
    return rows


def main() -> None:
    """Command line."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--particles", type=int, nargs="+", default=[40000, 160000])
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--peers", nargs="+", choices=PEERS, default=list(PEERS))
    parser.add_argument("--write", action="store_true", help="put the table into benchmarks/README.md")
    parser.add_argument("--measure", choices=PEERS, help=argparse.SUPPRESS)
    parser.add_argument("--reference", choices=OWN, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure or options.reference:
        work = workload.jelly2(options.particles[0])
        if options.measure:
            result = measure(options.measure, work, options.threads[0])
        else:
            result = {"gradient": reference(work, options.reference)}
        sys.stdout.write(json.dumps(result) + "\n")
        return
    if "mphygs" not in options.peers:
        parser.error("--peers must name mphygs, which the ratios are over")
    rows = compare(options)
    machine = f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores"
    text = f"{machine}, median of {options.repeats} rounds; ns per particle and substep.\n\n{table(rows)}"
    sys.stdout.write(text + "\n")
    if options.write:
        write(text)


if __name__ == "__main__":
    main()

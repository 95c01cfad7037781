"""The flowers' table, as JSON and as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

METRICS = ("psnr", "iou", "chamfer_px")
# Of the paper, over its ten real flowers: PSNR, IoU, chamfer distance in sequence, then across.
PAPER = {
    "M-PhyGs (paper, real flowers)": ((18.49, 0.706, 3.3), (17.99, 0.651, 4.9)),
    "PhysDreamer (paper, real flowers)": ((16.00, 0.319, 52.6), (15.66, 0.252, 16.7)),
    "OmniPhysGS (paper, real flowers)": ((15.31, 0.082, 163.6), (15.39, 0.152, 129.3)),
    "Pixie (paper, real flowers)": ((15.63, 0.225, 72.0), (16.45, 0.315, 58.6)),
    "Spring-Gaus (paper, real flowers)": ((15.61, 0.066, 174.7), (15.54, 0.090, 169.8)),
    "gs-dynamics (paper, real flowers)": ((16.13, 0.343, 40.6), (16.31, 0.297, 65.6)),
    "GIC (paper, real flowers)": ((15.78, 0.095, 169.6), (15.85, 0.062, 208.1)),
}


def document(records: Sequence[Mapping[str, object]]) -> dict[str, object]:
    """All records, and means over flowers by variant."""
    variants = list(dict.fromkeys(str(entry["variant"]) for entry in records))
    means = {}
    for variant in variants:
        done = [e for e in records if e["variant"] == variant and "error" not in e]
        if done:
            means[variant] = _means(done)
    return {"variants": means, "flowers": list(records)}


def _means(done: Sequence[Mapping]) -> dict[str, object]:
    found: dict[str, object] = {"flowers": len(done)}
    for where in ("fit", "in", "cross"):
        found[where] = {key: _mean([entry[where][key] for entry in done]) for key in METRICS}
        found[where]["rms"] = _mean([entry[where]["rms"] for entry in done])
    for symbol in ("E", "rho"):
        errors = [
            abs(item["error"])
            for entry in done
            for key, item in entry["materials"].items()
            if key.endswith(f".{symbol}") and item["identifiable"]
        ]
        found[f"log_{symbol}"] = {"mean": _mean(errors), "count": len(errors)}
    # Pictures make thin parts too thick: what motion determines is their mass.
    fitted = [(e["materials"], e["volume_ratio"]) for e in done if e["materials"]]
    volumes = [(materials[f"{k}.rho"]["error"], r) for materials, of in fitted for k, r in of.items()]
    found["log_mass"] = _median([abs(error + np.log(ratio)) for error, ratio in volumes])
    found["volume_ratio"] = _median([ratio for e in done for ratio in e["volume_ratio"].values()])
    found["error_over_std"] = _median(
        [abs(m["error"]) / m["std"] for materials, _ in fitted for m in materials.values()]
    )
    for symbol in ("E", "rho"):
        known = [m for e in done for key, m in e["materials"].items() if key.endswith(f".{symbol}")]
        found[f"{symbol}_within_two_std"] = _mean([float(abs(m["error"]) < 2.0 * m["std"]) for m in known])
    for name in ("adjusted_rand_index", "adjusted_rand_index_merged"):
        found[name] = _mean([entry[name] for entry in done])
    found["seconds"] = _mean([entry["seconds"] for entry in done])
    # results of before this was measured, and of what went on after a break, have none
    found["processor"] = _mean([entry.get("processor") for entry in done])
    found["stage_seconds"] = _mean([sum(s["seconds"] for s in entry["stages"].values()) for entry in done])
    peaks = [max([e["memory"], *(s["memory"] for s in e["stages"].values())]) for e in done]
    found["memory"] = max(peaks)
    return found


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def markdown(found: Mapping[str, object]) -> str:
    """The document for people."""
    lines = [
        "# Flowers",
        "",
        "In sequence: frames after those fitted; across: the other motion.",
        "",
    ]
    measures = ("", "PSNR in / across", "IoU in / across", "chamfer in / across [px]")
    tracks = "tracks in / across [mm]"
    materials = ("error of log E", "of log rho", "of log mass", "error / std")
    costs = ("flowers", "seconds", "processor [s]", "memory [GB]")
    lines += _row(*measures, tracks, *materials, *costs, head=True)
    for variant, means in found["variants"].items():
        inside, across = means["in"], means["cross"]
        lines += _row(
            variant,
            f"{_number(inside['psnr'], 2)} / {_number(across['psnr'], 2)}",
            f"{_number(inside['iou'], 3)} / {_number(across['iou'], 3)}",
            f"{_number(inside['chamfer_px'], 2)} / {_number(across['chamfer_px'], 2)}",
            " / ".join(_number(1e3 * where["rms"], 2) for where in (inside, across)),
            f"{_number(means['log_E']['mean'], 2)} ({means['log_E']['count']})",
            f"{_number(means['log_rho']['mean'], 2)} ({means['log_rho']['count']})",
            _number(means["log_mass"], 2),
            _number(means["error_over_std"], 2),
            str(means["flowers"]),
            _number(means["seconds"], 0),
            _number(means["processor"], 0),
            _number(means["memory"] / 1e9, 2),
        )
    for name, (inside, across) in PAPER.items():
        pairs = [f"{a:g} / {b:g}" for a, b in zip(inside, across, strict=True)]
        lines += _row(name, *pairs, *[""] * 9)
    lines += [
        "",
        "Means over flowers; of log E and log rho over true parts that the fit says it knows (their number); "
        "medians over all true parts of the mass, and of errors of log E and log rho over their standard "
        "deviations.",
        "",
    ]
    lines += ["## The full method, flower by flower", ""]
    lines += _row(*measures, "segments", "adjusted Rand index", "stages [s]", "fit [s]", head=True)
    for entry in found["flowers"]:
        if entry["variant"] != "full":
            continue
        if "error" in entry:
            lines += _row(entry["species"], entry["error"], "", "", "", "", "", "")
            continue
        pairs = [
            f"{_number(entry['in'][key], digits)} / {_number(entry['cross'][key], digits)}"
            for key, digits in zip(METRICS, (2, 3, 2), strict=True)
        ]
        stages = sum(stage["seconds"] for stage in entry["stages"].values())
        lines += _row(
            entry["species"], *pairs, str(entry["segments"]), _number(entry["adjusted_rand_index"], 2),
            _number(stages, 0), _number(entry["seconds"], 0),
        )  # fmt: skip
    return "\n".join([*lines, ""])


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _row(*cells: str, head: bool = False) -> list[str]:
    line = "| " + " | ".join(cells) + " |"
    return [line, "| " + " | ".join("---" for _ in cells) + " |"] if head else [line]

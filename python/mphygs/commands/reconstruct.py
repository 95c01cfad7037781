"""`mphygs reconstruct CAPTURE`: Gaussians of the object at rest from its dense views."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro

from mphygs.capture.colmap import ColmapPoints
from mphygs.capture.digest import digest_of
from mphygs.capture.errors import fault
from mphygs.capture.format import Capture, load_capture
from mphygs.capture.images import write_image
from mphygs.capture.layouts import read_points
from mphygs.capture.stages import Stage, StageFolder
from mphygs.capture.view_folders import rest_views_of, sequence_views_of
from mphygs.capture.views import Photograph, RestViews
from mphygs.commands.claim import claim
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions, OptionError
from mphygs.render.contact_sheet import contact_sheet
from mphygs.render.density_control import DensityRule
from mphygs.render.gaussian_reconstruction import ReconstructionSettings, reconstruct
from mphygs.render.image_metrics import image_metrics, mean_metrics
from mphygs.render.splatting import splat
from mphygs.scene.agreement import check_first_frame
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.ply import read_gaussians, write_gaussians

PROGRAM = "mphygs reconstruct"
PICTURE = "picture.png"
_SHOWN = 4  # views on the picture


@dataclass(frozen=True, kw_only=True)
class ReconstructOptions(CommonOptions):
    """Gaussians of the object at rest, from dense views with masks. What a run has made already is kept; a
    gaussians.ply of your own in RUN/stages/rest, in metres, is used instead."""

    capture: tyro.conf.Positional[Path]
    """Folder of the capture."""
    out: Path
    """Run folder; the stage's files go to RUN/stages/rest."""
    iterations: int = 1500
    """Steps of the optimisation, one view each."""
    most_gaussians: int = 12_000
    """Number of Gaussians that is not exceeded."""
    longest: int = 400
    """Pictures larger than this along a side are used at a half, a third, ... of their size [px]."""
    seed: int = 0
    """Of the order of the views."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(ReconstructOptions, reconstruct_command, program=PROGRAM, argv=argv)


def reconstruct_command(options: ReconstructOptions, console: Console) -> Answer:
    """Make the stage unless it is there; draw it; say how well the views are explained."""
    console.resume = f"{PROGRAM} {shlex.quote(str(options.capture))} --out {shlex.quote(str(options.out))}"
    capture = load_capture(options.capture)
    claim(options.out)
    stage, state, gaussians = rest_stage(capture, options, console)
    document: dict[str, object] = {
        "run": str(options.out),
        "stage": str(stage.folder),
        "state": state,
        "gaussians": gaussians.count,
        "seconds": console.seconds,
    }
    lines = [f"{gaussians.count} Gaussians in {StageFolder.of(options.out).gaussians} ({_of(state)})"]
    if capture.views is not None:
        photographs = [p.within(options.longest) for p in rest_views_of(capture).read()]
        metrics = {p.camera.name: image_metrics(splat(gaussians, p.camera), p) for p in photographs}
        mean = mean_metrics(metrics.values())
        worst = min(metrics, key=lambda name: metrics[name].iou)
        write_image(stage.folder / PICTURE, _sheet(gaussians, photographs))
        document |= {
            "views": {name: vars(each) for name, each in metrics.items()},
            "psnr": mean.psnr, "iou": mean.iou, "chamfer_px": mean.chamfer_px,
            "picture": str(stage.folder / PICTURE),
        }  # fmt: skip
        lines += [
            f"{len(metrics)} views: PSNR {mean.psnr:.1f} dB, IoU {mean.iou:.3f}, chamfer "
            f"{mean.chamfer_px:.2f} px; least IoU {metrics[worst].iou:.3f} in {worst}",
            f"picture: {stage.folder / PICTURE}",
        ]
    return Answer(document, "\n".join(lines))


def rest_stage(
    capture: Capture, options: ReconstructOptions, console: Console, *, any_options: bool = False
) -> tuple[Stage, str, Gaussians]:
    """The stage, "made", "own" or "new", and its Gaussians.

    any_options: Gaussians that were made with other options, of the same views, are taken as well. Raises
    CaptureError where the capture or a user's own file cannot be used.
    """
    if capture.views is None and capture.gaussians is None:
        raise fault(str(capture.folder / "capture.json"), "gives the object as parts", "object.views")
    if options.iterations < 1 or options.most_gaussians < 100 or options.longest < 16:
        raise OptionError(
            f"--iterations {options.iterations}, --most-gaussians {options.most_gaussians}, --longest "
            f"{options.longest}; expected at least 1, 100 and 16"
        )
    names = ("iterations", "most_gaussians", "longest", "seed")
    if capture.views is None:
        source = digest_of(capture.gaussians, capture.gaussians_scale)
    else:
        source = digest_of(capture.views, capture.views_scale)
    made_of = {name: getattr(options, name) for name in names} | {"source": source}
    path = StageFolder.of(options.out).gaussians
    stage = Stage.of(path, made_of)
    state = stage.state()
    if state == "missing" and any_options and stage.complete("source"):
        state = "made"
    if state != "missing":
        return stage, state, read_gaussians(path)
    if capture.views is None:
        gaussians = read_gaussians(capture.gaussians, capture.gaussians_scale)
    else:
        rest = rest_views_of(capture)
        photographs = _photographs(capture, rest, options, console)
        points = read_points(capture.views, capture.views_scale)
        gaussians = _reconstructed(photographs, points, options, console)
    stage.begin()
    write_gaussians(path, gaussians)
    stage.finish()
    return stage, "new", gaussians


def _photographs(
    capture: Capture, rest: RestViews, options: ReconstructOptions, console: Console
) -> list[Photograph]:
    """The rest views, held against the first frames of all motions seen in views."""
    console.say(f"reading {len(rest.views)} rest views")
    photographs = [p.within(options.longest) for p in rest.read()]
    for sequence in capture.sequences:
        if sequence.views is None:
            continue
        views = sequence_views_of(sequence, rest)
        first = [p.within(options.longest) for p in views.read(0)]
        where = f'sequence "{sequence.name}"'
        found = check_first_frame(photographs, first, views.correspondences, where=where)
        console.say(f"{where} fits: size {found.size:.2f}, colours {found.colours:.0%} in common")
    return photographs


def _reconstructed(
    photographs: Sequence[Photograph],
    points: ColmapPoints | None,
    options: ReconstructOptions,
    console: Console,
) -> Gaussians:
    def tell(iteration: int, iterations: int, loss: float, count: int) -> None:
        if iteration % max(iterations // 20, 1) < 10 or iteration == iterations:
            console.progress(iteration / iterations, f"loss {loss:.4f}, {count} Gaussians")

    console.begin()
    settings = ReconstructionSettings(
        iterations=options.iterations, seed=options.seed, density=DensityRule(most=options.most_gaussians)
    )
    found = reconstruct(photographs, colmap=points, settings=settings, progress=tell)
    return found.gaussians


def _sheet(gaussians: Gaussians, photographs: Sequence[Photograph]) -> np.ndarray:
    """Photographs, what the Gaussians look like, and the difference."""
    chosen = [photographs[k] for k in np.linspace(0, len(photographs) - 1, _SHOWN).round().astype(int)]
    seen, drawn, apart = [], [], []
    for photograph in chosen:
        with torch.no_grad():
            colour = splat(gaussians, photograph.camera).colour.numpy()
        observed = photograph.colour * photograph.mask[..., None]
        seen.append(observed)
        drawn.append(colour)
        apart.append(1.0 - np.repeat(np.abs(colour - observed).mean(2, keepdims=True) * 4.0, 3, axis=2))
    names = [photograph.camera.name for photograph in chosen]
    captions = [names, [f"{n}: Gaussians" for n in names], [f"{n}: 4 x difference" for n in names]]
    return contact_sheet([seen, drawn, apart], captions)


def _of(state: str) -> str:
    return {"own": "your own", "made": "made before", "new": "new"}[state]

"""`mphygs segment CAPTURE`: features of the Gaussians, particles that fill the object, and its segments."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mphygs.capture.digest import digest_of
from mphygs.capture.extractors import Extractor, extractor_of, feature_names
from mphygs.capture.format import Capture, Part, load_capture
from mphygs.capture.images import write_image
from mphygs.capture.mask_groups import MaskGrouper, Superpixels
from mphygs.capture.mask_groups_sam import SamGroups
from mphygs.capture.stages import Stage, StageFolder
from mphygs.capture.view_folders import rest_views_of
from mphygs.capture.views import Photograph
from mphygs.commands.claim import claim
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions, OptionError
from mphygs.commands.reconstruct import ReconstructOptions, rest_stage
from mphygs.render.found_object import ObjectSettings, found_object
from mphygs.render.gaussian_features import gaussian_features
from mphygs.render.object_picture import object_picture
from mphygs.render.orbit_views import pictures_all_round
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.object_files import (
    GaussianFeatures,
    read_features,
    read_particles,
    read_parts,
    write_features,
    write_particles,
    write_parts,
)
from mphygs.scene.segments import SegmentSettings
from mphygs.scene.soft_boundary import Particles

PROGRAM = "mphygs segment"
PICTURE = "picture.png"
# Of the work after reconstruction that is done once features are there.
_FEATURES_SHARE = 0.6
_SIZE_ROUND = 256  # [px] of pictures of an object that is given without any
Tools = tuple[Extractor, MaskGrouper]


@dataclass(frozen=True, kw_only=True)
class SegmentOptions(CommonOptions):
    """Features of the object at rest, particles that fill it, and its segments with a closed mesh each. What
    a run has made already is kept; files of your own in RUN/stages are used instead."""

    capture: tyro.conf.Positional[Path]
    """Folder of the capture."""
    out: Path
    """Run folder; files go to RUN/stages/features and RUN/stages/object."""
    features: Annotated[str, tyro.conf.arg(metavar="A+B")] = "xfeat+colour"
    """What tells places apart: colour, xfeat, dino:FOLDER (a local DINOv2 or DINOv3), or several with +."""
    masks: str = "superpixels"
    """What groups pixels: superpixels, or sam:FOLDER (a local SAM or SAM2)."""
    particles: int = 25_000
    """About so many inside the object."""
    segments: int = 25
    """Number of segments that is not exceeded."""
    alike: float = 1.0
    """Distance in looks and thickness below which two segments are one, over the largest at which both look
    like one kind of place (a distribution of one mode); 0: every petal stays a segment of its own."""
    longest: int = 400
    """Pictures larger than this along a side are used at a half, a third, ... of their size [px]."""
    seed: int = 0
    """Of what is drawn at random."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(SegmentOptions, segment_command, program=PROGRAM, argv=argv)


def segment_command(options: SegmentOptions, console: Console) -> Answer:
    """Make the stages unless they are there; draw them; say what the segments are."""
    console.resume = f"{PROGRAM} {shlex.quote(str(options.capture))} --out {shlex.quote(str(options.out))}"
    settings = _settings(options)
    tools = _tools(options)
    capture = load_capture(options.capture)
    claim(options.out)
    rest = ReconstructOptions(capture=options.capture, out=options.out, longest=options.longest)
    _, _, gaussians = rest_stage(capture, rest, console, any_options=True)
    photographs = _photographs(capture, gaussians, options)
    views = None if capture.views is None else digest_of(capture.views, capture.views_scale)
    console.begin()
    first, features = features_stage(options, tools, views, gaussians, photographs, console)
    second, particles, parts = object_stage(
        options, settings, views, gaussians, features, photographs, console
    )
    picture = second.folder / PICTURE
    write_image(picture, object_picture(gaussians, features, particles, photographs))
    count = np.bincount(particles.label[particles.inside], minlength=particles.segment_count)
    around = int((~particles.inside).sum())
    document = {
        "run": str(options.out),
        "features": {"stage": str(first.folder), "source": features.source},
        "particles": {
            "stage": str(second.folder),
            "inside": int(particles.inside.sum()),
            "band": around,
            "spacing": particles.spacing,
        },
        "segments": {
            part.name: {"particles": int(count[k]), "volume": part.volume, "bounds": part.bounds}
            for k, part in enumerate(parts)
        },
        "picture": str(picture),
        "seconds": console.seconds,
    }
    lines = [
        f"features: {features.source}",
        f"{count.sum()} particles {1e3 * particles.spacing:.2f} mm apart, {around} round them",
        *(
            f"  {p.name}: {1e6 * p.volume:8.3f} cm^3, {n} particles"
            for p, n in zip(parts, count, strict=True)
        ),
        f"picture: {picture}",
    ]
    return Answer(document, "\n".join(lines))


def features_stage(
    options: SegmentOptions,
    tools: Tools | None,
    views: str | None,
    gaussians: Gaussians,
    photographs: Sequence[Photograph],
    console: Console,
) -> tuple[Stage, GaussianFeatures]:
    """The stage and its features, made unless they are there.

    tools: loaded here where None; views: digest of the photographs' folder.
    """
    files = StageFolder.of(options.out)
    names = ("features", "masks", "longest", "seed")
    made_of = {name: getattr(options, name) for name in names} | {
        "gaussians": digest_of(files.gaussians),
        "views": views,
    }
    stage = Stage.of(files.features, made_of)
    if stage.state() == "missing":
        extractor, grouper = tools or (extractor_of(options.features), grouper_of(options.masks))
        features = gaussian_features(
            gaussians,
            photographs,
            extractor,
            grouper,
            made_by=options.features,
            seed=options.seed,
            report=_report(console, 0.0, _FEATURES_SHARE),
        )
        stage.begin()
        write_features(files.features, features)
        stage.finish()
    return stage, read_features(files.features, gaussians.count)


def object_stage(
    options: SegmentOptions,
    settings: ObjectSettings,
    views: str | None,
    gaussians: Gaussians,
    features: GaussianFeatures,
    photographs: Sequence[Photograph],
    console: Console,
) -> tuple[Stage, Particles, list[Part]]:
    """The stage, its particles and its parts, made unless they are there."""
    files = StageFolder.of(options.out)
    names = ("particles", "segments", "alike", "longest", "seed")
    made_of = {name: getattr(options, name) for name in names} | {
        "gaussians": digest_of(files.gaussians),
        "features": digest_of(files.features),
        "views": views,
    }
    stage = Stage.of(files.particles, made_of, f"{files.parts.name}/*.ply")
    if stage.state() == "missing":
        # nothing before: the features were there already
        start = _FEATURES_SHARE if console.seconds > 1.0 else 0.0
        found = found_object(
            gaussians,
            features,
            photographs,
            settings,
            report=_report(console, start, 1.0),
        )
        stage.begin()
        write_particles(files.particles, found.particles)
        write_parts(files.parts, list(found.parts))
        stage.finish()
    particles, parts = read_particles(files.particles), read_parts(files.parts)
    if len(parts) != particles.segment_count:
        raise OptionError(
            f"{stage.folder}: has {len(parts)} meshes in {files.parts.name} and {particles.segment_count} "
            f"segments in {files.particles.name}; expected one mesh a segment"
        )
    return stage, particles, parts


def grouper_of(text: str) -> MaskGrouper:
    """The grouper that `--masks` names. Raises OptionError for names that there are not."""
    folder = _mask_folder(text)
    return Superpixels() if folder is None else SamGroups.of(folder)


def _mask_folder(text: str) -> Path | None:
    """The folder that `--masks` names, None for superpixels."""
    kind, _, folder = text.partition(":")
    if (kind, folder) == ("superpixels", ""):
        return None
    if kind == "sam" and folder:
        return Path(folder)
    raise OptionError(f"--masks: got '{text}'; expected superpixels or sam:FOLDER")


def _tools(options: SegmentOptions) -> Tools | None:
    """What features are made with, so that what is not installed is said before any work is done; None
    where features are there already, which may need none of it. Names are checked in any case."""
    try:
        feature_names(options.features)
    except ValueError as error:
        raise OptionError(f"--features: {error}") from error
    _mask_folder(options.masks)
    if Stage.of(StageFolder.of(options.out).features, {}).complete():
        return None
    return extractor_of(options.features), grouper_of(options.masks)


def _settings(options: SegmentOptions) -> ObjectSettings:
    if options.particles < 200 or options.segments < 1 or options.alike < 0 or options.longest < 16:
        raise OptionError(
            f"--particles {options.particles}, --segments {options.segments}, --alike {options.alike:g}, "
            f"--longest {options.longest}; expected at least 200, 1, 0 and 16"
        )
    return ObjectSettings(
        particles=options.particles,
        segments=SegmentSettings(most=options.segments, alike=options.alike, seed=options.seed),
    )


def _photographs(capture: Capture, gaussians: Gaussians, options: SegmentOptions) -> list[Photograph]:
    if capture.views is None:
        return pictures_all_round(gaussians, size=min(options.longest, _SIZE_ROUND))
    return [p.within(options.longest) for p in rest_views_of(capture).read()]


def _report(console: Console, start: float, end: float) -> Callable[[float, str], None]:
    """Progress within a share of the work, at most a line every few seconds."""
    last = [-np.inf]

    def tell(share: float, text: str) -> None:
        if console.seconds - last[0] >= 3.0:
            last[0] = console.seconds
            console.progress(start + (end - start) * share, text)

    return tell

"""What `mphygs fit` takes, and what of it can be judged without a capture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mphygs.baselines.kinds import Baseline
from mphygs.commands.options import CommonOptions, OptionError, check_gain, split_names
from mphygs.fit.of_run import HOMOGENEOUS
from mphygs.fit.paper_plan import check_windows
from mphygs.fit.pictured_run import PARTS
from mphygs.model.registry import USUAL_LAW, effects, laws
from mphygs.model.substances import substances_of
from mphygs.simulate.settings import check_effects, check_integrator

Law = Literal[laws()]


@dataclass(frozen=True, kw_only=True)
class FitOptions(CommonOptions):
    """Fit materials, and the effects named, to a capture. Without CAPTURE: a small one made on the spot."""

    capture: tyro.conf.Positional[Path | None] = None
    """Folder of the capture."""
    out: Path | None = None
    """Run folder; default: runs/NAME-OF-THE-CAPTURE. A run that is there already is replaced."""
    sequences: Annotated[str | None, tyro.conf.arg(metavar="A,B")] = None
    """Sequences to fit; default: all with frames to fit."""
    effects: Annotated[str | None, tyro.conf.arg(metavar="a,b")] = None
    """Physical effects and faults of measurement to fit as well."""
    frames: Annotated[str | None, tyro.conf.arg(metavar="i:j")] = None
    """Frames to fit, i to j - 1, instead of those that the capture states."""
    schedule: Literal["fast", "paper"] = "fast"
    """fast: growing stretches of the motion, coarse grid first; paper: the paper's
    windows in mid-motion, each from the state that the markers give, by Adam on the adjoint."""
    transfer: Literal["total-lagrangian", "mls"] = "total-lagrangian"
    """How particles and grid exchange momentum."""
    integrator: Literal["explicit", "implicit", "auto"] = "explicit"
    """Steps in time: explicit, as short as stability asks for; implicit, an eighth of a frame or
    less, for what is stiff; auto, whichever cost less at the stiffness that the fit is at. Implicit not with
    --transfer mls."""
    spacing: Annotated[float | None, tyro.conf.arg(metavar="m")] = None
    """Grid spacing [m]; default: from the object's volume."""
    prestress: Literal["off", "paper", "equilibrium"] | None = None
    """How the rest shape carries gravity; default: as the capture says."""
    law: Law = USUAL_LAW
    """Law of elasticity."""
    preset: Annotated[str | None, tyro.conf.arg(metavar="NAME | PART=NAME,...")] = None
    """What the object is made of, about: where stiffness and density start, and what stiffness is expected
    to be. gel, silicone, rubber, petal or stem, of all parts, or by part: stem=stem,petal*=petal."""
    optimiser: Literal["gauss-newton", "adam", "lbfgs"] = "gauss-newton"
    """Of the fast schedule: Gauss-Newton on tangents, or Adam or L-BFGS on the adjoint, slower for so few
    unknowns."""
    stages: Path | None = None
    """Of a capture in pictures: run folder whose stages (Gaussians, parts, tracks, contact) are used, and
    made where they are missing; default: the run folder itself."""
    without: Annotated[str | None, tyro.conf.arg(metavar="a,b")] = None
    """Of a capture in pictures, parts of the method to leave out: l2d (the stage on pictures), ldt (its
    distance maps), lg (grouping of segments that look alike), windows (growing stretches of the motion),
    prestress (the internal force that carries gravity at rest)."""
    baseline: Baseline | None = None
    """What others do, on this capture, in the method's place: homogeneous (one material, of a capture in
    pictures fitted to silhouettes alone), springs (between anchors), neural (the elastic model and a residual
    network), graph (a graph network), field (E as a smooth field, of a capture in pictures fitted to these
    alone), laws (a mixture of laws in every group of points), prior (of a capture in pictures: materials by
    looks, no fit). `compare`, `predict` and `report` take its run."""
    feedback: Annotated[float | None, tyro.conf.arg(metavar="[GAIN]")] = None
    """Also the error of the fitted model under feedback from the measurement, beside the free one. Gain from
    0 to 1, without a number 1: a memory of two frames."""
    intervals: bool = False
    """Also find each interval of two standard deviations from the likelihood: standard errors of a tenth of a
    value and more are lopsided. A few short fits for each of its ends, which are counted from the minimum
    itself: a fit that leaves more than noise stops short of it. Components of a direction have none."""
    seed: int = 0
    """Of everything random that is done with this run."""
    workers: int | None = None
    """Simulations side by side; default: one a core. Changes no number."""
    resume: bool = False
    """Continue the run in --out where it stopped."""


def check_options(options: FitOptions) -> None:
    """Options that can be judged without the capture."""
    check_gain(options.feedback)
    known = effects()
    for name in split_names(options.effects):
        if name not in known:
            raise OptionError(
                f"--effects: unknown effect '{name}'; expected some of {', '.join(sorted(known))}"
            )
    if options.spacing is not None and not 0.0 < options.spacing < math.inf:
        raise OptionError(f"--spacing: got {options.spacing}; expected a length above zero [m]")
    if options.preset is not None:
        try:
            substances_of(options.preset)
        except (KeyError, ValueError) as error:
            raise OptionError(f"--preset: {error.args[0]}") from error
    if options.workers is not None and options.workers < 1:
        raise OptionError(f"--workers: got {options.workers}; expected 1 or more")
    if options.schedule == "paper":
        check_windows(split_names(options.effects))
        if options.optimiser == "lbfgs":
            raise OptionError("--optimiser lbfgs: not with --schedule paper, whose optimiser is adam")
    for name in split_names(options.without):
        if name not in PARTS:
            raise OptionError(f"--without: unknown '{name}'; expected some of {', '.join(PARTS)}")
    if options.baseline is not None:
        _check_baseline(options)
    check_effects(options.transfer, split_names(options.effects))
    check_integrator(options.transfer, options.integrator)


def _check_baseline(options: FitOptions) -> None:
    """A baseline is a model of its own: what is about the method's does not go with it."""
    default = FitOptions()
    own = ("without", "effects", "schedule", "optimiser")
    if options.baseline != HOMOGENEOUS:
        own += ("transfer", "integrator", "law", "feedback", "intervals")
    for key in own:
        if getattr(options, key) != getattr(default, key):
            raise OptionError(f"--baseline {options.baseline}: not with --{key}; expected it without")

"""One material for the whole object, of pictures fitted to silhouettes alone: the representation of GIC.

Cai et al., "GIC: Gaussian-informed continuum for physical property identification and simulation" (2024),
match silhouettes by a chamfer distance and an L1 of masks, and know one material an object. Here Young's
modulus is searched for; density follows from the known mass, or stays as it is where none is known. To
markers the one material is fitted as the method fits several.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import torch
from scipy.optimize import minimize_scalar

from mphygs.baselines.training import Progress
from mphygs.fit.checkpointed import fit_run
from mphygs.fit.determined import information_of
from mphygs.fit.experiment import Experiment
from mphygs.fit.image_fit import Watched, watch
from mphygs.fit.levenberg_marquardt import covariance
from mphygs.fit.of_run import pictured_of
from mphygs.fit.pictured import Pictured
from mphygs.fit.run import Run, StageRecord
from mphygs.model.belief import Belief
from mphygs.render.image_metrics import chamfer_distance
from mphygs.render.splatting import splat
from mphygs.simulate.errors import SimulationError

# Young's moduli that are tried first [Pa], and steps of the search about the best.
TRIED = tuple(10.0**k for k in (6.5, 6.0, 5.5, 5.0, 4.5, 4.0, 3.5))
SEARCHES = 8


def fit(run: Run, experiment: Experiment, progress: Progress) -> Run:
    """The complete run of a belief with one part. Raises SimulationError where no stiffness can be run."""
    if run.complete:
        return run
    pictured = pictured_of(run, experiment)
    if pictured is None:
        return fit_run(run, experiment, progress=progress)
    began = time.monotonic()
    watched = {name: watch(pictured, name, span, looks=False) for name, span in experiment.fitted.items()}
    key = f"{run.belief.parts[0]}.youngs_modulus"
    base = _of_known_mass(run.belief, experiment)
    tried: list[float] = []

    def cost(log_modulus: float) -> float:
        belief = base.with_parameter(key, value=math.exp(log_modulus))
        try:
            found = silhouette_loss(pictured, watched, belief)
        except SimulationError:
            found = math.inf
        tried.append(found)
        share = min(len(tried) / (len(TRIED) + SEARCHES), 1.0)
        progress(share, f"silhouettes: E {math.exp(log_modulus):.3g} Pa, loss {found:.5f}")
        return found

    best = _searched(cost)
    belief = base.with_parameter(key, value=math.exp(best))
    evaluation = experiment.problem(run.settings.spacing).evaluate(belief)
    # what could not be simulated has no cost to tell
    costs = tuple(found for found in tried if math.isfinite(found))
    record = StageRecord(
        "silhouettes", run.settings.spacing, costs, True, "search done", time.monotonic() - began
    )
    return replace(
        run.after(record, belief),
        covariance=covariance(evaluation),
        information=information_of(evaluation, len(belief.free)),
    )


def _of_known_mass(belief: Belief, experiment: Experiment) -> Belief:
    """The belief with the density that gives the known mass."""
    if belief.known_mass is None:
        return belief
    part = experiment.capture.parts[0]
    key = f"{part.name}.density"
    density = min(max(belief.known_mass / part.volume, belief[key].lower), belief[key].upper)
    return belief.with_parameter(key, value=density)


def _searched(cost: Callable[[float], float]) -> float:
    """Logarithm of the modulus of least cost: the best of a few, then Brent's search about it."""
    best = min((cost(math.log(modulus)), math.log(modulus)) for modulus in TRIED)
    if not math.isfinite(best[0]):
        raise SimulationError("no stiffness between 3 kPa and 3 MPa could be simulated")
    step = math.log(TRIED[0] / TRIED[1])
    # Brent's search does not know infinity
    limit = 10.0 * best[0] + 1.0
    found = minimize_scalar(
        lambda x: min(cost(x), limit), bounds=(best[1] - step, best[1] + step), method="bounded",
        options={"maxiter": SEARCHES, "xatol": 0.02},
    )  # fmt: skip
    return float(found.x) if found.fun < best[0] else best[1]


def silhouette_loss(pictured: Pictured, watched: Mapping[str, Watched], belief: Belief) -> float:
    """Mean over views and fitted frames of the chamfer distance between silhouettes, over the picture's
    diagonal, and the L1 of masks."""
    losses = []
    for name, one in watched.items():
        prediction = pictured.moved(name, belief, last=max(one.fitted) + 1)
        placement = pictured.placement(name)
        for frame in one.fitted:
            with torch.no_grad():
                gaussians = pictured.coloured(
                    torch.from_numpy(placement.to_world(prediction.position[frame]))
                )
                for photograph in one.photographs[frame]:
                    opacity = splat(gaussians, photograph.camera).opacity.numpy()
                    apart = chamfer_distance(opacity, photograph.mask) / math.hypot(*photograph.mask.shape)
                    losses.append(apart + float(np.abs(opacity - photograph.mask).mean()))
    return float(np.mean(losses))

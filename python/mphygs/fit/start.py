"""The belief that a fit starts from: what the capture knows, and wide priors for the rest."""

from __future__ import annotations

import math

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.meshes import Part
from mphygs.fit.actuator_parameters import actuator_parameters
from mphygs.fit.first_frames import start_parameters
from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import USUAL_LAW, material_effects
from mphygs.model.substances import substances_by_part
from mphygs.scene.curved_quadrature import thickness_of
from mphygs.simulate.section import QUANTITY

# Soft tissue and plants to hard rubber; a prior this wide moves no number that the data determine.
YOUNGS_MODULUS_MEDIAN, YOUNGS_MODULUS_SPREAD = 1e5, 2.5
DENSITY_SPREAD = 0.5
# Where a density or the mass is known, the other parts are within this factor of it: a model that lacks
# an effect would otherwise buy it with absurd inertia.
DENSITY_FACTOR = 4.0
# How far the thickness of a rod or a shell may be from its mesh's.
THICKNESS_FACTOR = 3.0
DEFAULT_POISSONS_RATIO = 0.4
DEFAULT_DENSITY = 1000.0
# How far the true start of a motion may be from the stated release [frames].
RELEASE_FRAMES = 2.0


def starting_belief(
    capture: Capture,
    *,
    effects: tuple[str, ...] = (),
    prestress: str | None = None,
    law: str = USUAL_LAW,
    preset: str | None = None,
) -> Belief:
    """Materials of every part, free where the capture does not know them, how motions begin that do not begin
    at rest, and the named effects.

    prestress: off, paper or equilibrium; None takes equilibrium for a capture whose rest says so; preset:
    substance, or substances by part (see `substances_by_part`), whose usual stiffness and density it starts
    from and its priors are about. Raises ValueError for a capture without parts, or with a measured start
    that its markers do not show, and for a preset that names no part; KeyError for an unknown one.
    """
    if not capture.parts:
        raise ValueError(f"capture '{capture.name}': expected parts given as meshes")
    known = capture.known
    volume = {part.name: part.volume for part in capture.parts}
    substances = {} if preset is None else substances_by_part(preset, [part.name for part in capture.parts])
    guess = float(np.mean(list(known.density.values()))) if known.density else DEFAULT_DENSITY
    if known.mass is not None:
        rest = known.mass - sum(known.density[n] * volume[n] for n in known.density)
        free_volume = sum(v for n, v in volume.items() if n not in known.density)
        if free_volume > 0 and rest > 0:
            guess = rest / free_volume
    informed = bool(known.density) or known.mass is not None
    density_bounds = (guess / DENSITY_FACTOR, guess * DENSITY_FACTOR) if informed else (5.0, 3e4)
    stated = list(known.density.values())
    density_bounds = (min([density_bounds[0], *stated]), max([density_bounds[1], *stated]))
    parameters = []
    for part in capture.parts:
        own = substances.get(part.name)
        stiffness, spread = YOUNGS_MODULUS_MEDIAN, YOUNGS_MODULUS_SPREAD
        if own is not None:
            stiffness, spread = own.median, own.spread
        density = own.density if own is not None and not informed else guess
        ratio = known.poissons_ratio
        if isinstance(ratio, dict):
            ratio = ratio.get(part.name)
        parameters += [
            Parameter(
                f"{part.name}.youngs_modulus",
                stiffness,
                "Pa",
                1e2,
                1e9,
                log=True,
                prior_mean=math.log(stiffness),
                prior_std=spread,
            ),
            Parameter(
                f"{part.name}.density",
                known.density.get(part.name, density),
                "kg/m^3",
                *density_bounds,
                log=True,
                free=part.name not in known.density,
                prior_mean=math.log(density),
                prior_std=DENSITY_SPREAD,
            ),
            Parameter(
                f"{part.name}.poissons_ratio",
                DEFAULT_POISSONS_RATIO if ratio is None else ratio,
                "-",
                0.0,
                0.4995,
                free=False,
            ),
        ]
        if part.thickness_std > 0.0:
            parameters.append(_thickness(part))
    for recording in capture.sequences:
        if recording.release is not None:
            frame = 1.0 / recording.fps
            earliest = -min(RELEASE_FRAMES, recording.release) * frame
            parameters.append(
                Parameter(
                    f"{recording.name}.release_shift",
                    0.0,
                    "s",
                    earliest,
                    RELEASE_FRAMES * frame,
                    prior_mean=0.0,
                    prior_std=frame,
                    scale=frame,
                )
            )
        parameters += start_parameters(capture, recording)
    parameters += actuator_parameters(capture)
    mode = prestress or ("equilibrium" if capture.rest == "equilibrium" else "off")
    belief = Belief(
        tuple(part.name for part in capture.parts),
        np.asarray(capture.gravity, float),
        tuple(parameters),
        prestress=mode,
        law=law,
        known_mass=known.mass,
    )
    for name in effects:
        belief = with_effect(belief, name)
    return belief


def _thickness(part: Part) -> Parameter:
    """How thick a rod or a shell is [m], about its mesh's thickness."""
    middle = thickness_of(part)
    return Parameter(
        f"{part.name}.{QUANTITY}",
        middle,
        "m",
        middle / THICKNESS_FACTOR,
        middle * THICKNESS_FACTOR,
        log=True,
        prior_mean=math.log(middle),
        prior_std=part.thickness_std / middle,
    )


def with_effect(belief: Belief, name: str) -> Belief:
    """An effect with sensible starting values; effects that need a place or direction get it elsewhere."""
    return belief.with_effect(name, starting_values(belief, name))


def starting_values(belief: Belief, name: str) -> dict[str, float]:
    """Values from which an effect starts in a belief, where these are not its nulls."""
    return next((own.start(belief) for own in material_effects() if own.name == name), {})

"""Where the object at rest is in frame 0 of a motion: rigidly first, then each Gaussian."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mphygs.capture.annotations import Correspondence
from mphygs.capture.cameras import Camera
from mphygs.capture.views import Photograph
from mphygs.motion.alignment import AlignmentRule
from mphygs.motion.rigid import (
    RigidMotion,
    found_rigid,
    pointed_at,
    refined_rigid,
    robust_rigid,
    unlikeness,
)
from mphygs.motion.stiffness import Stiffness
from mphygs.motion.tracking import TrackingRule, aligner_of
from mphygs.scene.gaussians import Gaussians

LEAST_POINTS = 4
# Neighbouring control points hardly disagree: frame 0 is meant to show the shape at rest.
STIFF = Stiffness(rigidity=0.015, similarity=0.04, step=0.02, place=7.0)


@dataclass(frozen=True, eq=False)
class Registration:
    """motion: of the whole; refined: (K, 3) [m], the Gaussians in frame 0; by: what was begun with; apart:
    (N,) [m], how far the points pointed at are from where the rigid motion by them alone puts them; agree:
    (N,) bool, those that were used; difference: root mean square of colours and silhouettes."""

    motion: RigidMotion
    refined: np.ndarray
    by: Literal["correspondences", "pictures"]
    apart: np.ndarray
    agree: np.ndarray
    difference: float


def register(
    gaussians: Gaussians,
    photographs: Sequence[Photograph],
    correspondences: Sequence[Correspondence],
    *,
    rest_cameras: Mapping[str, Camera],
    first_cameras: Mapping[str, Camera],
    rule: TrackingRule | None = None,
    features: Sequence[np.ndarray] | None = None,
) -> Registration:
    """Gaussians of the object at rest brought to frame 0.

    photographs: frame 0 of every camera; correspondences: points seen at rest and in frame 0, of which four
    or more are triangulated and give the first rigid motion (Kabsch, outliers left out); with fewer it is
    searched for in the pictures; rest_cameras, first_cameras: by name, of the resolution in which the points
    were pointed at; features: (H, W, F) a photograph, compared with the
    Gaussians' beside colours. The motion is refined on the pictures and kept where it explains them better;
    then every Gaussian moves a little, neighbours nearly as one.
    """
    rule = rule or TrackingRule()
    apart, agree = np.zeros(0), np.zeros(0, dtype=bool)
    if len(correspondences) >= LEAST_POINTS:
        source, target = pointed_at(correspondences, rest_cameras, first_cameras)
        first, agree = robust_rigid(source, target)
        apart = np.linalg.norm(first.of(source) - target, axis=1)
    else:
        first = found_rigid(gaussians, photographs, rule.alignment)
    aligner = aligner_of(gaussians, replace(rule, alignment=replace(rule.alignment, stiffness=STIFF)))
    aligner = aligner.matched(photographs, aligner.graph.rest.turned(first.rotation, first.shift))
    # drawn as soft as the photographs: other edges pull small pictures to another pose
    finer: AlignmentRule = replace(aligner.rule, levels=rule.alignment.levels[-3:])
    tried = [first, refined_rigid(gaussians, photographs, first, finer)]
    softness = aligner.rule.sight.softness
    motion = min(tried, key=lambda m: unlikeness(m.of_gaussians(gaussians), photographs, softness=softness))
    expected = aligner.graph.rest.turned(motion.rotation, motion.shift)
    alignment = aligner.align(photographs, expected, features=features)
    return Registration(
        motion=motion,
        refined=aligner.graph.carried(alignment.pose),
        by="correspondences" if len(correspondences) >= LEAST_POINTS else "pictures",
        apart=apart,
        agree=agree,
        difference=alignment.difference,
    )

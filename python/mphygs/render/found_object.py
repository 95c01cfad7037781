"""The object that Gaussians show: its solid, particles in it, segments, and their meshes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from mphygs.capture.meshes import Part
from mphygs.capture.views import Photograph
from mphygs.render.orbit_views import seen_depths
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.object_files import GaussianFeatures, segment_name
from mphygs.scene.part_meshes import segment_meshes
from mphygs.scene.segments import FeatureBlock, SegmentSettings, find_segments
from mphygs.scene.soft_boundary import Particles, lattice_particles
from mphygs.scene.solid import SeenDepth, signed_distance, silhouette_distance, solid_behind
from mphygs.scene.thickness import local_thickness

Report = Callable[[float, str], None]
# Voxels of the lattice that the solid is found on: for each particle in the object, the least and the most.
_VOXELS_A_PARTICLE, _VOXELS = 100, (2.5e5, 4e6)
_FAR = 0.1  # of the object's size, beside it, from which a Gaussian floats
_LEAST_OPACITY = 0.05  # of Gaussians that say where the object is
_NEAREST = 4  # Gaussians that a particle has its features from, for segments


@dataclass(frozen=True)
class ObjectSettings:
    """particles: about so many inside; band: of particles outside, in their spacing; weights of what makes a
    segment: appearance, affinity, thickness (its logarithm), beside that of place in `segments`."""

    particles: int = 25_000
    band: float = 1.0
    appearance: float = 1.0
    affinity: float = 1.0
    thickness: float = 0.7
    segments: SegmentSettings = field(default_factory=SegmentSettings)

    def __post_init__(self) -> None:
        if self.particles < 200 or min(self.band, self.appearance, self.affinity, self.thickness) < 0:
            raise ValueError(f"{self}: expected 200 particles or more, and no weight below zero")


@dataclass(frozen=True, eq=False)
class FoundObject:
    """particles: with their segments; parts: a closed mesh each segment; lift: what depths were corrected by
    [m]."""

    particles: Particles
    parts: tuple[Part, ...]
    lift: float


def found_object(
    gaussians: Gaussians,
    features: GaussianFeatures,
    photographs: Sequence[Photograph],
    settings: ObjectSettings,
    *,
    report: Report | None = None,
) -> FoundObject:
    """The solid that no picture sees through, filled with particles, divided into segments.

    Raises ValueError where the pictures leave no solid, or one that is too small for the particles asked for.
    """
    tell = report if report is not None else _silent
    tell(0.0, "surfaces that the views see")
    views = [
        SeenDepth(p.camera, depth, silhouette_distance(p.mask))
        for p, depth in zip(photographs, seen_depths(gaussians, photographs), strict=True)
    ]
    clear = gaussians.opacities.detach().numpy() >= _LEAST_OPACITY
    if clear.sum() < _NEAREST:
        raise ValueError(f"gaussians: {clear.sum()} are opaque; expected an object that can be seen")
    places = _on_object(views, gaussians.positions.detach().double().numpy()[clear])
    voxels = np.clip(_VOXELS_A_PARTICLE * settings.particles, *_VOXELS)
    voxel = float(np.cbrt(np.prod(np.ptp(places, axis=0) + 1e-4) / voxels))
    tell(0.1, "the solid behind them")
    lattice, distance, lift = solid_behind(views, places, spacing=voxel)
    volume = float((distance <= 0).sum()) * lattice.spacing**3
    if volume <= 0:
        raise ValueError("rest views: leave no solid; expected cameras and masks of one object")
    spacing = float(np.cbrt(volume / settings.particles))
    position, signed = lattice_particles(lattice, distance, spacing=spacing, band=settings.band * spacing)
    tell(0.5, "its thickness")
    thickness = lattice.at(local_thickness(distance, spacing=lattice.spacing), position)
    tell(0.7, "segments")
    tree = cKDTree(gaussians.positions.detach().double().numpy())
    near = tree.query(position, k=_NEAREST)[1]
    inside = signed <= 0
    appearance, affinity = features.appearance[near].mean(axis=1), features.affinity[near].mean(axis=1)
    blocks = [
        FeatureBlock(appearance[inside], settings.appearance),
        FeatureBlock(affinity[inside], settings.affinity, tells=False),
        FeatureBlock(np.log(np.maximum(thickness[inside], 0.2 * spacing))[:, None], settings.thickness),
    ]
    own = find_segments(position[inside], blocks, settings.segments)
    label = own[cKDTree(position[inside]).query(position)[1]]
    pixel = _pixel(photographs, position[inside].mean(axis=0))
    particles = Particles(position, signed, spacing, label, features.appearance[near[:, 0]], pixel)
    tell(0.85, "meshes of the segments")
    names = [segment_name(number) for number in range(particles.segment_count)]
    parts = segment_meshes(lattice, distance, position[inside], own, names)
    return FoundObject(particles, tuple(parts), lift)


def _pixel(photographs: Sequence[Photograph], place: np.ndarray) -> float:
    """Width of a pixel [m] at a place (3,), the median over pictures."""
    depths = [float(p.camera.project(place[None])[1][0]) / p.camera.focal.mean() for p in photographs]
    return float(np.median(np.abs(depths)))


def _on_object(views: Sequence[SeenDepth], places: np.ndarray) -> np.ndarray:
    """Places (M, 3) [m] without those that pictures show far beside the object: a single one that floats
    there would make a lattice over all of them coarse."""
    size = float(np.linalg.norm(np.ptp(np.percentile(places, [5, 95], axis=0), axis=0)))
    kept = places[signed_distance(views, places) < _FAR * size]
    if len(kept) == 0:
        raise ValueError("gaussians: none lies where the rest views show the object; expected one object")
    return kept


def _silent(share: float, text: str) -> None:
    """Nobody asked."""

"""What features and segments look like: Gaussians painted by them, beside the photographs."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import cKDTree

from mphygs.capture.features import principal_components
from mphygs.capture.views import Photograph
from mphygs.render.contact_sheet import contact_sheet
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians, harmonics_of_colour
from mphygs.scene.object_files import GaussianFeatures
from mphygs.scene.soft_boundary import Particles

_SHOWN = 4  # views


def segment_colours(count: int) -> np.ndarray:
    """(S, 3) colours, 0 to 1, that neighbours in number can be told apart by."""
    turn = (np.sqrt(5.0) - 1.0) / 2.0
    levels = ((0.75, 0.95), (0.55, 0.75), (0.9, 0.7))
    return np.array([colorsys.hsv_to_rgb((0.33 + turn * k) % 1.0, *levels[k % 3]) for k in range(count)])


def colours_of_features(features: np.ndarray) -> np.ndarray:
    """(K, 3) colours, 0 to 1: the three principal components of features (K, F)."""
    if features.shape[1] == 0:
        return np.full((len(features), 3), 0.5)
    values = principal_components(features, 3).of(features)
    values = np.pad(values, ((0, 0), (0, 3 - values.shape[1])))
    low, high = np.percentile(values, [2, 98], axis=0)
    return np.clip((values - low) / np.maximum(high - low, 1e-6), 0.0, 1.0)


def object_picture(
    gaussians: Gaussians,
    features: GaussianFeatures,
    particles: Particles,
    photographs: Sequence[Photograph],
) -> np.ndarray:
    """Photographs, appearance and affinity as colours, segments, one below the other; (H, W, 3)."""
    places = gaussians.positions.detach().double().numpy()
    nearest = cKDTree(particles.position).query(places)[1]
    paints = {
        "appearance": colours_of_features(features.appearance),
        "affinity": colours_of_features(features.affinity),
        f"{particles.segment_count} segments": segment_colours(particles.segment_count)[
            particles.label[nearest]
        ],
    }
    chosen = [photographs[k] for k in np.linspace(0, len(photographs) - 1, _SHOWN).round().astype(int)]
    rows = [[p.colour * p.mask[..., None] for p in chosen]]
    captions = [[p.camera.name for p in chosen]]
    for name, colours in paints.items():
        painted = replace(
            gaussians, harmonics=harmonics_of_colour(torch.as_tensor(colours, dtype=torch.float32))
        )
        with torch.no_grad():
            rows.append([splat(painted, p.camera).colour.numpy() for p in chosen])
        captions.append([name] * len(chosen))
    return contact_sheet(rows, captions)

"""A small flower in pictures, and the files of its stages made from its truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from mphygs.capture.format import load_capture
from mphygs.capture.meshes import write_mesh
from mphygs.capture.stages import STAGES
from mphygs.capture.view_folders import rest_views_of
from mphygs.render.raw_gaussians import RawGaussians
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians, colour_of_harmonics, harmonics_of_colour
from mphygs.scene.particles import exposed_surface, inside
from mphygs.scene.ply import write_gaussians
from mphygs.synth.flower import Shoot, make_flower

SHOOT = Shoot(size=80, rest_views=10, cameras=3, frames=24, tracks=120, spacing_share=1.3)
SIGMA = 2e-4
# Width of a Gaussian over the distance to its neighbours.
_WIDTH = 0.6


def pictured_flower(
    folder: Path, *, species: str = "daisy", seed: int = 1, hidden: tuple[str, ...] = (), shoot: Shoot = SHOOT
) -> Path:
    """A flower of 24 frames and 80 x 80 pixels, written to `folder`."""
    make_flower(species, folder, seed=seed, shoot=shoot, hidden=hidden)
    return folder


def stages_of_truth(capture: Path, run: Path, *, sigma: float = SIGMA, count: int = 1500) -> Path:
    """Stage files in `run` as perfect stages would leave them, but for white noise of sigma [m] on tracks."""
    truth = load_capture(capture / "truth")
    stages = run / STAGES
    parts = truth.parts
    (stages / "object" / "parts").mkdir(parents=True, exist_ok=True)
    for number, part in enumerate(parts):
        name = f"segment-{number:02d}"
        write_mesh(stages / "object" / "parts" / f"{name}.ply", part.vertices, part.faces)
    position, label = _particles(parts)
    appearance = np.eye(len(parts))[label]
    spacing = np.array(_lattice(parts))
    np.savez(
        stages / "object" / "particles.npz", position=position, label=label.astype(np.int32),
        signed_distance=np.zeros(len(position)), spacing=spacing, appearance=appearance.astype(np.float32),
        pixel=np.array(0.0),
    )  # fmt: skip
    (stages / "rest").mkdir(exist_ok=True)
    write_gaussians(stages / "rest" / "gaussians.ply", gaussians_of_truth(capture, count))
    noise = np.random.default_rng(0)
    for recording in truth.sequences:
        folder = stages / "track" / recording.name
        folder.mkdir(parents=True, exist_ok=True)
        tracks = recording.markers
        moved = tracks.position + sigma * noise.standard_normal(tracks.position.shape)
        moved[3, ::7] = np.nan
        turned = np.tile([1.0, 0, 0, 0], (*moved.shape[:2], 1))
        np.savez(
            folder / "tracks.npz", rest=tracks.at, position=moved, quaternion=turned, sigma=np.array(sigma),
            gaussian=np.zeros(len(tracks.at), np.int32),
        )  # fmt: skip
    return stages


def _lattice(parts: tuple) -> float:
    """Spacing that gives the object about 3000 particles [m]."""
    return float(np.cbrt(sum(part.volume for part in parts) / 3000))


def _particles(parts: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) [m] of a lattice inside the parts, and the number of the part (N,)."""
    low = np.min([part.bounds[0] for part in parts], axis=0)
    high = np.max([part.bounds[1] for part in parts], axis=0)
    axes = [np.arange(a, b, _lattice(parts)) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    found, label = [], []
    for number, part in enumerate(parts):
        within = points[inside(part, points)]
        found.append(within)
        label.append(np.full(len(within), number))
    return np.concatenate(found), np.concatenate(label)


def gaussians_of_truth(capture: Path, count: int, *, iterations: int = 60) -> Gaussians:
    """Round Gaussians on the true surface, of the colours that the rest views show."""
    parts = load_capture(capture / "truth").parts
    triangles = np.concatenate([part.vertices[part.faces] for part in parts])
    area = (
        0.5
        * np.linalg.norm(
            np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
        ).sum()
    )
    points = exposed_surface(parts, max_edge=float(np.sqrt(area / count))).points
    distance = cKDTree(points).query(points, k=4)[0][:, 1:].mean(axis=1)
    number = len(points)
    gaussians = Gaussians(
        positions=torch.as_tensor(points, dtype=torch.float32),
        rotations=torch.tensor([[1.0, 0, 0, 0]]).repeat(number, 1),
        scales=torch.as_tensor(_WIDTH * distance, dtype=torch.float32)[:, None].repeat(1, 3),
        opacities=torch.full((number,), 0.9),
        harmonics=harmonics_of_colour(torch.full((number, 3), 0.5)),
        features=torch.zeros(number, 0),
    )
    photographs = rest_views_of(load_capture(capture)).read()
    raw = RawGaussians(gaussians)
    rates = dict.fromkeys(
        ("positions", "rotations", "log_scales", "logit_opacities", "harmonics", "features"), 0.0
    )
    rates |= {"constant": 0.1, "log_scales": 0.01}
    for iteration in range(iterations):
        photograph = photographs[iteration % len(photographs)]
        picture = splat(raw.gaussians(), photograph.camera)
        mask = torch.from_numpy(photograph.mask)
        loss = (picture.colour - torch.from_numpy(photograph.colour) * mask[..., None]).abs().mean()
        (loss + (picture.opacity - mask).abs().mean()).backward()
        raw.step(rates)
    found = raw.gaussians().each(torch.Tensor.detach)
    assert colour_of_harmonics(found.harmonics).std() > 0.05
    return found

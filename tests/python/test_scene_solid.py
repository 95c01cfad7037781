"""The solid behind what cameras see, how thick it is, and the particles in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from mesh_picture import cameras_around
from mphygs.capture.cameras import Camera
from mphygs.scene.lattice import Lattice
from mphygs.scene.soft_boundary import Particles, lattice_particles, soft_volumes
from mphygs.scene.solid import (
    SeenDepth,
    depth_error,
    largest_body,
    signed_distance,
    silhouette_distance,
    solid_behind,
)
from mphygs.scene.thickness import local_thickness

RADIUS = 0.03


def view_of_ball(camera: Camera, *, behind: float = 0.0) -> SeenDepth:
    """Exact depth, `behind` [m] too large, and silhouette of a ball at the origin."""
    rows, columns = np.indices((camera.height, camera.width)) + 0.5
    rays = camera.rays(np.stack([columns, rows], axis=-1))
    along = -(rays @ camera.position)
    square = RADIUS**2 - (camera.position @ camera.position - along**2)
    distance = along - np.sqrt(np.maximum(square, 0.0))
    forward = camera.camera_from_world[2, :3]
    depth = np.where(square > 0, distance * (rays @ forward) + behind, np.inf)
    # how far the line of sight passes from the ball, on the sphere about the camera that touches it
    middle = camera.position @ camera.position
    beside = np.arccos(np.clip(along / np.sqrt(middle), -1, 1)) - np.arcsin(RADIUS / np.sqrt(middle))
    outside = beside * camera.focal.mean()
    return SeenDepth(camera, depth.astype(np.float32), outside.astype(np.float32))


def test_silhouette_distances_pass_the_edge_where_the_mask_is_half() -> None:
    mask = np.zeros((9, 20), dtype=np.float32)
    mask[:, :10], mask[:, 10] = 1.0, 0.25
    distance = silhouette_distance(mask)[4]
    # the edge stands a quarter into pixel 10, at 10.25; centres are at halves
    assert distance[10] == pytest.approx(0.25) and distance[15] == pytest.approx(5.5, abs=0.3)
    assert distance[3] == pytest.approx(-6.5, abs=0.3)


def test_a_ball_is_found_with_its_distances() -> None:
    views = [view_of_ball(camera) for camera in cameras_around(18, 128)]
    draw = np.random.default_rng(0)
    directions = draw.standard_normal((4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radius = draw.uniform(0.6, 1.5, 4000) * RADIUS
    found = signed_distance(views, directions * radius[:, None])
    error = found - (radius - RADIUS)
    near = np.abs(radius - RADIUS) < 3e-3
    assert np.abs(np.median(error[near])) < 2e-4 and np.percentile(np.abs(error[near]), 90) < 8e-4
    away = np.abs(radius - RADIUS) > 1e-3
    assert ((found > 0) == (radius > RADIUS))[away].mean() > 0.995


def test_depths_that_lie_too_deep_are_lifted_to_the_silhouettes() -> None:
    behind, whole = 8e-4, 4 / 3 * np.pi * RADIUS**3
    views = [view_of_ball(camera, behind=behind) for camera in cameras_around(18, 128)]
    lattice, distance, lift = solid_behind(views, RADIUS * np.array([[-1.0] * 3, [1.0] * 3]), spacing=1e-3)
    assert lift == pytest.approx(behind, rel=0.25)
    volume = (distance <= 0).sum() * lattice.spacing**3
    assert volume == pytest.approx(whole, rel=0.02)
    # without it a shell is missing that is as thick as depths are wrong where a camera looks straight at it
    shell = whole - 4 / 3 * np.pi * (RADIUS - behind) ** 3
    plain = (signed_distance(views, lattice.points()) <= 0).sum() * lattice.spacing**3
    assert whole - plain > 0.5 * shell


def test_right_depths_are_not_lifted_and_hollows_do_not_count() -> None:
    views = [view_of_ball(camera) for camera in cameras_around(18, 128)]
    assert depth_error(views, reach=0.01) < 1e-4
    # a third of the surface lies in a hollow that no silhouette shows
    draw = np.random.default_rng(1)
    hollow = []
    for view in views:
        deeper = 5e-4 + 6e-3 * (draw.random(view.depth.shape) < 0.33)
        hollow.append(replace(view, depth=view.depth + deeper.astype(np.float32)))
    assert depth_error(hollow, reach=0.02) == pytest.approx(5e-4, abs=2e-4)
    # nothing drawn, nothing to tell it by
    blind = [replace(view, depth=np.full_like(view.depth, np.inf)) for view in views]
    assert depth_error(blind, reach=0.02) == 0.0


def test_what_is_beside_a_silhouette_or_in_no_picture_is_outside() -> None:
    views = [view_of_ball(camera) for camera in cameras_around(6, 64)]
    far = np.array([[0.0, 0.0, 5.0], [0.05, 0.0, 0.0]])
    assert (signed_distance(views, far) > 0).all()
    bodies = np.zeros((12, 12, 12), dtype=bool)
    bodies[1:8, 1:8, 1:8], bodies[10, 10, 10] = True, True
    kept = largest_body(bodies)
    assert kept.sum() == 343 and not kept[10, 10, 10]


def test_thickness_is_the_diameter_of_the_ball_that_fits() -> None:
    spacing = 1e-3
    lattice = Lattice.about(np.array([[-0.03] * 3, [0.03] * 3]), spacing=spacing, margin=0.0)
    x, y, z = lattice.points().T
    plate = np.maximum(np.abs(z) - 2e-3, np.maximum(np.abs(x), np.abs(y)) - 0.028)
    rod = np.maximum(np.hypot(x, y) - 8e-3, np.abs(z) - 0.028)
    # a plate through a rod
    thickness = local_thickness(np.minimum(plate, rod).reshape(lattice.shape), spacing=spacing).ravel()
    at = {
        "plate": (np.abs(z) < 1e-3) & (np.hypot(x, y) > 0.012) & (np.abs(x) < 0.02) & (np.abs(y) < 0.02),
        "rod": (np.hypot(x, y) < 4e-3) & (np.abs(z) < 0.015),
    }
    assert np.median(thickness[at["plate"]]) == pytest.approx(4e-3, rel=0.25)
    assert np.median(thickness[at["rod"]]) == pytest.approx(16e-3, rel=0.25)
    assert (thickness[np.minimum(plate, rod) > 0] == 0).all()


def test_particles_fill_the_solid_and_a_band_round_it() -> None:
    lattice = Lattice.about(np.array([[-0.02] * 3, [0.02] * 3]), spacing=1e-3, margin=4e-3)
    distance = (np.linalg.norm(lattice.points(), axis=1) - 0.02).reshape(lattice.shape)
    places, signed = lattice_particles(lattice, distance, spacing=1.5e-3, band=2e-3)
    assert signed == pytest.approx(np.linalg.norm(places, axis=1) - 0.02, abs=1e-4)
    assert signed.max() <= 2e-3 and (signed > 1e-3).any()
    assert (signed <= 0).sum() * 1.5e-3**3 == pytest.approx(4 / 3 * np.pi * 0.02**3, rel=0.03)
    with pytest.raises(ValueError, match="band"):
        lattice_particles(lattice, distance, spacing=1e-3, band=-1.0)
    with pytest.raises(ValueError, match="label: has shape"):
        Particles(places, signed, 1e-3, np.zeros(3, int), np.zeros((len(places), 2)))


def test_volumes_fade_with_the_offset_of_their_segment() -> None:
    distance = torch.tensor([-1e-3, 0.0, 2e-4, 1e-3], dtype=torch.float64)
    label = torch.tensor([0, 0, 1, 1])
    offsets = torch.tensor([0.0, 1e-4], dtype=torch.float64, requires_grad=True)
    volumes = soft_volumes(distance, label, offsets, spacing=2e-3)
    # V_g (1 / (1 + exp(beta (d + o))) + eps)
    expected = 8e-9 * (1 / (1 + np.exp(5e3 * np.array([-1e-3, 0.0, 3e-4, 1.1e-3]))) + 1e-4)
    assert volumes.detach().numpy() == pytest.approx(expected, rel=1e-12)
    (gradient,) = torch.autograd.grad(volumes.sum(), offsets)
    assert (gradient < 0).all(), "a larger offset takes material away"
    assert torch.autograd.gradcheck(
        lambda d, o: 1e9 * soft_volumes(d, label, o, spacing=2e-3),
        (distance.clone().requires_grad_(), offsets), eps=1e-8, atol=1e-3,
    )  # fmt: skip

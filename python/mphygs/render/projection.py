"""World points and Gaussians through a camera, differentiable, in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

from mphygs.capture.cameras import Camera
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.tensor_rotation import rotation_matrices

# Beyond this share of the picture outside its edge the linearised projection is held, as in 3DGS.
_MARGIN = 0.15


def camera_coordinates(camera: Camera, positions: Tensor) -> Tensor:
    """Points (N, 3) [m] of the world in the camera's axes, (N, 3) [m]."""
    pose = torch.as_tensor(camera.camera_from_world.copy(), dtype=positions.dtype, device=positions.device)
    return positions @ pose[:3, :3].T + pose[:3, 3]


def project_points(camera: Camera, positions: Tensor) -> tuple[Tensor, Tensor]:
    """Pixels (N, 2) [px] and depths (N,) [m] of world points (N, 3) [m]; for depths above 0."""
    own = camera_coordinates(camera, positions)
    focal, centre = positions.new_tensor(camera.focal), positions.new_tensor(camera.centre)
    return own[:, :2] / own[:, 2:] * focal + centre, own[:, 2]


def projected_covariances(camera: Camera, gaussians: Gaussians, blur: float) -> Tensor:
    """Covariances (N, 2, 2) [px^2] of the Gaussians in the picture, to first order (EWA).

    blur: added to the diagonal [px^2]. Zwicker et al. 2001.
    """
    own = camera_coordinates(camera, gaussians.positions)
    focal, centre = own.new_tensor(camera.focal), own.new_tensor(camera.centre)
    size = own.new_tensor([camera.width, camera.height])
    margin = _MARGIN * size / focal
    ratio = own[:, :2] / own[:, 2:]
    ratio = ratio.clamp(-centre / focal - margin, (size - centre) / focal + margin)
    diagonal = torch.diag_embed(focal / own[:, 2:])
    jacobian = torch.cat([diagonal, (-focal * ratio / own[:, 2:])[..., None]], dim=-1)
    rotation = own.new_tensor(camera.camera_from_world[:3, :3])
    lift = jacobian @ rotation @ (rotation_matrices(gaussians.rotations) * gaussians.scales[:, None, :])
    return lift @ lift.mT + blur * torch.eye(2, dtype=own.dtype, device=own.device)

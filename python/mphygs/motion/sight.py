"""What pictures say of where Gaussians should go: small displacements in each picture and how sure they are.

The Gaussians are drawn where they are thought to be, and the picture is compared with the photograph by the
method of Lucas and Kanade (1981): always with the appearance at rest, so that errors do not add up from frame
to frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch

from mphygs.capture.cameras import Camera
from mphygs.capture.views import Photograph
from mphygs.render.picture import Optics, Picture
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians


@dataclass(frozen=True)
class SightRule:
    """window: standard deviation of the weights about a point within which pictures are compared [px];
    blur: of both pictures before [px], since their edges are of different sharpness; largest: difference of
    colour from which a pixel counts less and less, of a range of 1; mask_share: weight of the difference of
    silhouettes beside that of a colour channel; light: width over which the brightness of drawing and
    photograph is made equal [px]; softness: of the drawing, as Optics.blur [px^2]; margin: to stay away from
    the picture's edge [px]."""

    window: float = 1.2
    blur: float = 1.0
    largest: float = 0.15
    mask_share: float = 0.3
    light: float = 8.0
    softness: float = 0.3
    margin: float = 1.0


@dataclass(frozen=True, eq=False)
class Sight:
    """Of one camera and K points.

    visible: (K,) bool; trust: (K,), 1 where drawing and photograph are alike, towards 0 where they are not, 0
    where it is hidden; information: (K, 2, 2) [1/px^2] and pull: (K, 2) [1/px]: the sum of squared
    differences, in units of their variance, is about d A d - 2 b d for a displacement d [px]; camera: of the
    resolution in which pixels are counted; difference: root mean square of the differences where the object
    is.
    """

    camera: Camera
    visible: np.ndarray
    trust: np.ndarray
    information: np.ndarray
    pull: np.ndarray
    difference: float


def seen_points(
    picture: Picture, camera: Camera, points: np.ndarray, *, behind: float, margin: float
) -> np.ndarray:
    """(K,) bool, which points (K, 3) [m] nothing in the picture hides: at most `behind` [m] behind what is
    drawn, and not within `margin` [px] of the edge."""
    pixels, depth = camera.project(points)
    inside = (depth > 0) & np.isfinite(pixels).all(axis=1)
    inside &= (pixels > margin).all(axis=1)
    inside &= (pixels < np.array([camera.width, camera.height]) - margin).all(axis=1)
    drawn = picture.mean_depth(0.3).detach().numpy()
    seen = np.zeros(len(points), dtype=bool)
    column, row = pixels[inside].astype(int).T
    seen[inside] = depth[inside] <= drawn[row, column] + behind
    return seen


def sight_of(
    gaussians: Gaussians,
    points: np.ndarray,
    photograph: Photograph,
    *,
    behind: float,
    factor: int = 1,
    noise: float,
    rule: SightRule,
    features: np.ndarray | None = None,
) -> Sight:
    """What one photograph says of points (K, 3) [m] that are carried by Gaussians where they are drawn.

    behind: how far behind the drawn surface a point is still seen [m]; factor: compare pictures that many
    times smaller, drawn at full size first, for Gaussians drawn small look thicker; noise: standard deviation
    of a difference that is not explained by motion; features: (H, W, F) of the photograph, that the
    Gaussians' features are compared with as colours are; None for colours alone.
    """
    with torch.no_grad():
        picture = splat(gaussians, photograph.camera, optics=Optics(blur=rule.softness))
    seen = seen_points(picture, photograph.camera, points, behind=behind, margin=rule.margin)
    drawn, observed = _channels(picture, photograph, rule, features)
    object_pixels = np.maximum(photograph.mask, picture.opacity.numpy())
    camera = photograph.camera
    if factor > 1:
        camera = camera.resized(max(camera.width // factor, 1), max(camera.height // factor, 1))
        drawn, observed, object_pixels = (
            cv2.resize(each, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
            for each in (drawn, observed, object_pixels)
        )
    object_pixels = object_pixels > 0.5
    drawn, observed = (_blurred(each, rule.blur) for each in (drawn, observed))
    difference = observed - drawn
    mean = 0.5 * (observed + drawn)
    along_u = cv2.Sobel(mean, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    along_v = cv2.Sobel(mean, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    size = (difference**2).sum(axis=2)
    # Geman and McClure: a pixel that shows something else, or nothing, says little
    trust = 1.0 / (1.0 + size / rule.largest**2) ** 2
    products = np.stack(
        [
            (along_u * along_u).sum(axis=2),
            (along_u * along_v).sum(axis=2),
            (along_v * along_v).sum(axis=2),
            -(along_u * difference).sum(axis=2),
            -(along_v * difference).sum(axis=2),
        ],
        axis=2,
    )
    products *= trust[..., None] / noise**2
    smooth = _blurred(np.concatenate([products, trust[..., None]], axis=2), rule.window)
    sampled = np.zeros((len(points), 6))
    if seen.any():
        sampled[seen] = _sampled(smooth, camera.project(points[seen])[0])
    # each pixel counts once, however many points share it
    share = object_pixels.sum() / max(int(seen.sum()), 1)
    information = share * sampled[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    rms = float(np.sqrt(size[object_pixels].mean())) if object_pixels.any() else 0.0
    return Sight(camera, seen, sampled[:, 5], information, share * sampled[:, 3:5], rms)


def _channels(
    picture: Picture, photograph: Photograph, rule: SightRule, features: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Drawing and photograph as (H, W, C) of what is compared."""
    mask, opacity = photograph.mask, picture.opacity.numpy()
    colour, seen = picture.colour.numpy(), photograph.colour * mask[..., None]
    colour = colour * _gain(colour, seen, rule.light)
    drawn, observed = [colour], [seen]
    if features is not None:
        drawn.append(picture.features.numpy())
        observed.append(features * mask[..., None])
    share = np.float32(rule.mask_share)
    drawn.append(share * opacity[..., None])
    observed.append(share * mask[..., None])
    return (np.concatenate(each, axis=2).astype(np.float32) for each in (drawn, observed))


def _gain(drawn: np.ndarray, observed: np.ndarray, width: float) -> np.ndarray:
    """How much brighter the photograph is about each pixel, (H, W, 1), within a third."""
    ratio = [_blurred(each.sum(axis=2), width) + 1e-3 for each in (observed, drawn)]
    return np.clip(ratio[0] / ratio[1], 0.75, 1.33)[..., None]


def _blurred(values: np.ndarray, width: float) -> np.ndarray:
    return cv2.GaussianBlur(values, (0, 0), width, borderType=cv2.BORDER_CONSTANT)


def _sampled(values: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Values (H, W, C) at pixels (N, 2), bilinear between pixel centres."""
    height, width = values.shape[:2]
    place = np.clip(pixels - 0.5, 0.0, [width - 1.001, height - 1.001])
    column, row = place.astype(int).T
    right, down = (place - np.floor(place)).T[:, :, None]
    above = values[row, column] * (1 - right) + values[row, column + 1] * right
    below = values[row + 1, column] * (1 - right) + values[row + 1, column + 1] * right
    return above * (1 - down) + below * down

"""Pictures of a flower: its painted surface under a soft light, over black."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mphygs.capture.cameras import Camera
from mphygs.synth.flower.growth import Flower
from mphygs.synth.flower.paint import Mottling, painted
from mphygs.synth.flower.raster import averaged, hits, vertex_normals
from mphygs.synth.flower.textured_surface import joined_surfaces

SAMPLES = 2  # along each side of a pixel
# Share of light that comes from everywhere: as under clouds, colours change little as the flower turns.
AMBIENT = 0.78
LIGHT = np.array([0.35, -0.45, 0.82]) / np.linalg.norm([0.35, -0.45, 0.82])


@dataclass(frozen=True, eq=False)
class Drawing:
    """colour: (H, W, 3) over black, mask: (H, W), share of each pixel that shows the flower; 0 to 1."""

    colour: np.ndarray
    mask: np.ndarray


class Painter:
    """Draws one flower from any camera, at rest or moved."""

    def __init__(self, flower: Flower, seed: int) -> None:
        whole = joined_surfaces([flower.surfaces[name] for name in flower.species.part_names])
        self.rest, self.faces = whole.vertices, whole.faces
        self.part = np.concatenate(
            [np.full(len(flower.surfaces[n].faces), k) for k, n in enumerate(flower.species.part_names)]
        )
        self._texture = np.column_stack([whole.along, whole.across, whole.number, whole.vertices])
        self._paints = [flower.paints[name] for name in flower.species.part_names]
        generator = np.random.default_rng([seed, 12])
        self._coarse = Mottling.of(generator, (0.012, 0.006))
        self._fine = Mottling.of(generator, (0.0030, 0.0021))

    def at_vertices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The vertices at rest (V, 3) [m], their colours as lit there (V, 3), 0 to 1, and parts (V,)."""
        part = np.zeros(len(self.rest), int)
        part[self.faces] = self.part[:, None]
        normal = vertex_normals(self.rest, self.faces)
        return self.rest, self._colour(part, self._texture, normal), part

    def _colour(self, part: np.ndarray, texture: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(N, 3) colours as lit of points by their parts (N,), texture (N, 6) and normals (N, 3)."""
        colour = np.zeros((len(part), 3))
        for number, paint in enumerate(self._paints):
            own = np.flatnonzero(part == number)
            if len(own):
                along, across, blade = texture[own, :3].T
                colour[own] = painted(paint, along, across, blade, texture[own, 3:], self._coarse, self._fine)
        # Wrapped round the object: no side of it is black.
        shade = AMBIENT + (1.0 - AMBIENT) * (normal @ LIGHT)
        return colour * shade[:, None]

    def draw(self, camera: Camera, vertices: np.ndarray) -> Drawing:
        """The picture of the flower with its vertices at (V, 3) [m]."""
        seen = hits(camera, vertices, self.faces, samples=SAMPLES)
        texture = seen.of_corners(self._texture, self.faces)
        normal = seen.of_corners(vertex_normals(vertices, self.faces), self.faces)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        part = self.part[seen.face]
        values = np.column_stack([self._colour(part, texture, normal), np.ones(len(part))])
        picture = averaged(values, seen, SAMPLES)
        return Drawing(picture[..., :3], picture[..., 3])

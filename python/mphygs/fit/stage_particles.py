"""The particles that the stages of an image capture hand on, held against the parts' meshes."""

from __future__ import annotations

from pathlib import Path

from mphygs.capture.errors import fault
from mphygs.capture.stages import StageFolder
from mphygs.scene.object_files import read_particles
from mphygs.scene.soft_boundary import Particles


def particles_of(folder: Path, segments: int) -> Particles:
    """The particles of a folder of stages. Raises CaptureError where they name other segments than these."""
    path = StageFolder(folder).particles
    particles = read_particles(path)
    if particles.segment_count > segments:
        found = f"names {particles.segment_count} segments"
        raise fault(f"{path}: label", found, f"at most {segments}, one for each mesh of a part")
    if not particles.inside.any():
        raise fault(f"{path}: signed_distance", "is above zero everywhere", "particles inside the object")
    return particles

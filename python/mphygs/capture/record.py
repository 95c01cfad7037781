"""What a capture holds: the object at rest, what is known of it, its recorded motions."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mphygs.capture.actuators import Actuator
from mphygs.capture.holds import Hold, Load
from mphygs.capture.markers import Markers
from mphygs.capture.meshes import Part
from mphygs.capture.sensors import Sensor


@dataclass(frozen=True)
class Known:
    """Quantities measured on their own and not to be fitted; what is absent is unknown.

    density: part name -> [kg/m^3]; poissons_ratio: [1], one for all parts or part name -> ratio; mass: [kg]
    of the whole object.
    """

    density: dict[str, float] = field(default_factory=dict)
    poissons_ratio: float | dict[str, float] | None = None
    mass: float | None = None


@dataclass(frozen=True, eq=False)
class Sequence:
    """One recorded motion. Frame k is at t = k / fps [s]; ranges [a, b) exclude b.

    fit: frames to fit on; predict: frames kept for prediction ((0, 0): none); loads: constant forces;
    release: all points are held at rest until this frame; views: the folder of the measured video,
    views_scale metres per unit of its cameras' places; first_frame: of the files' frames, the one that is
    frame 0, None where it is the first and they are no longer; turn: (3, 3) rotation from the frame that the
    sequence is told in to the one that gravity is told in, None where they are one; start: "rest" where the
    object rests in frame 0, "measured" where it is away from rest or moves then, None: as the first frames
    show; actuators: loads whose numbers are given frame by frame; sensors: other
    instruments.
    """

    name: str
    fps: float
    frames: int
    fit: tuple[int, int] = (0, 0)
    predict: tuple[int, int] = (0, 0)
    held: tuple[Hold, ...] = ()
    loads: tuple[Load, ...] = ()
    release: int | None = None
    markers: Markers | None = None
    views: Path | None = None
    views_scale: float = 1.0
    first_frame: int | None = None
    turn: np.ndarray | None = None
    start: str | None = None
    sensors: tuple[Sensor, ...] = ()
    actuators: tuple[Actuator, ...] = ()


@dataclass(frozen=True, eq=False)
class Capture:
    """One object and its recorded motions. gravity: (3,) [m/s^2], in the object frame.

    The object is given by `parts`, or by `gaussians` (a 3DGS .ply, `gaussians_scale` metres per unit of it),
    or by `views` (a folder of dense rest views, `views_scale` metres per unit of its cameras' places); rest:
    "stress-free", or "equilibrium" when the shape given sags under gravity already; found_as: what parts that
    are found in pictures are simulated as, "solid" or "auto" (see `Part`).
    """

    name: str
    folder: Path
    gravity: np.ndarray
    parts: tuple[Part, ...]
    rest: str
    known: Known
    sequences: tuple[Sequence, ...]
    gaussians: Path | None = None
    views: Path | None = None
    views_scale: float = 1.0
    gaussians_scale: float = 1.0
    found_as: str = "solid"

    def sequence(self, name: str) -> Sequence:
        """The sequence called `name`; KeyError, naming those there are, when there is none."""
        for sequence in self.sequences:
            if sequence.name == name:
                return sequence
        names = ", ".join(sequence.name for sequence in self.sequences)
        raise KeyError(f'capture "{self.name}" has no sequence "{name}"; expected one of {names}')

    @property
    def bounds(self) -> np.ndarray | None:
        """Lower and upper corner of the parts, (2, 3) [m]; None where the object is not given as parts."""
        if not self.parts:
            return None
        boxes = np.stack([part.bounds for part in self.parts])
        return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])

    @property
    def diagonal(self) -> float | None:
        """Length of the diagonal of `bounds` [m]."""
        bounds = self.bounds
        return None if bounds is None else float(np.linalg.norm(bounds[1] - bounds[0]))

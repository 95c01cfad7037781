"""Captures of box-shaped bars made in memory, for tests of the simulation and the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from mphygs.capture.format import Capture
from mphygs.capture.holds import Hold, Load
from mphygs.capture.markers import Markers
from mphygs.capture.meshes import Part
from mphygs.capture.record import Known
from mphygs.capture.record import Sequence as Recording
from mphygs.model.belief import Belief, Parameter

DOWN = np.array([0.0, 0.0, -9.81])


def box_part(name: str, low: Sequence[float], high: Sequence[float]) -> Part:
    """A closed box."""
    mesh = trimesh.creation.box(bounds=np.array([low, high], float))
    return Part(name, np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64))


def bar_capture(
    *,
    lengths: Sequence[float] = (0.06,),
    side: float = 0.02,
    depth: float | None = None,
    held: float | None = 0.006,
    frames: int = 20,
    fps: float = 50.0,
    gravity: np.ndarray = DOWN,
    rest: str = "stress-free",
    known: Known | None = None,
    loads: tuple[Load, ...] = (),
    markers_at: np.ndarray | None = None,
    position: np.ndarray | None = None,
    sigma: float = 1e-4,
    motion: np.ndarray | None = None,
    fit: tuple[int, int] = (0, 0),
) -> Capture:
    """A bar along x of one part per length, held (if at all) over the first `held` metres before x = 0.

    side, depth: along y and z [m]; motion: (T, 3) translation of the hold [m].
    """
    depth = side if depth is None else depth
    parts, start = [], 0.0 if held is None else -held
    ends = np.cumsum(lengths)
    for k, end in enumerate(ends):
        parts.append(box_part(f"part{k}", (start, 0.0, 0.0), (end, side, depth)))
        start = end
    if markers_at is None:
        shares = np.array([[1.0, 0.5, 0.5], [1.0, 1.0, 1.0], [0.7, 0.0, 0.5], [0.4, 0.5, 1.0]])
        markers_at = shares * [ends[-1], side, depth]
    if position is None:
        position = np.tile(markers_at, (frames, 1, 1))
    holds: tuple[Hold, ...] = ()
    if held is not None:
        box = np.array([[-held - 1e-3, -1.0, -1.0], [0.0, 1.0, 1.0]])
        turn = None if motion is None else np.tile([1.0, 0.0, 0.0, 0.0], (len(motion), 1))
        holds = (Hold(box, motion, turn),)
    recording = Recording(
        "a", fps, frames, fit=fit, held=holds, loads=loads, markers=Markers(position, markers_at, sigma)
    )
    return Capture(
        "bar", Path("."), np.asarray(gravity, float), tuple(parts), rest, known or Known(), (recording,)
    )


def turned(capture: Capture, rotation: np.ndarray) -> Capture:
    """The same capture with everything turned about the origin. rotation: (3, 3); boxes need right angles."""
    parts = tuple(Part(p.name, p.vertices @ rotation.T, p.faces) for p in capture.parts)

    def box(corners: np.ndarray) -> np.ndarray:
        assert np.isin(np.abs(rotation), (0.0, 1.0)).all()
        return np.sort(corners @ rotation.T, axis=0)

    def recording(one: Recording) -> Recording:
        assert one.markers is not None and all(h.is_fixed for h in one.held)
        markers = Markers(one.markers.position @ rotation.T, one.markers.at @ rotation.T, one.markers.sigma)
        loads = tuple(Load(box(load.box), rotation @ load.force, load.start_frame) for load in one.loads)
        return replace(one, markers=markers, loads=loads, held=tuple(Hold(box(h.box)) for h in one.held))

    return replace(
        capture,
        parts=parts,
        gravity=rotation @ capture.gravity,
        sequences=tuple(map(recording, capture.sequences)),
    )


def bar_belief(
    capture: Capture,
    *,
    youngs_modulus: Sequence[float] | float = 5e4,
    density: Sequence[float] | float = 1000.0,
    poissons_ratio: float = 0.3,
    prestress: str = "off",
    free: Sequence[str] = (),
    known_mass: float | None = None,
) -> Belief:
    """Materials per part; `free` names the quantities ("part0.youngs_modulus") that are fitted."""
    count = len(capture.parts)
    moduli, densities = np.broadcast_to(youngs_modulus, count), np.broadcast_to(density, count)
    parameters = []
    for part, e, rho in zip(capture.parts, moduli, densities, strict=True):
        for quantity, value, unit, low, high in (
            ("youngs_modulus", e, "Pa", 1e2, 1e9),
            ("density", rho, "kg/m^3", 1.0, 3e4),
            ("poissons_ratio", poissons_ratio, "-", 0.0, 0.4995),
        ):
            key = f"{part.name}.{quantity}"
            log = quantity != "poissons_ratio"
            parameters.append(
                Parameter(key, float(value), unit, low, high, log=log, free=key in free, scale=1.0)
            )
    return Belief(
        tuple(p.name for p in capture.parts), capture.gravity, tuple(parameters), prestress=prestress,
        known_mass=known_mass,
    )  # fmt: skip

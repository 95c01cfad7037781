"""Effects named without a place or a direction: where the object itself suggests to put them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.holds import Load
from mphygs.capture.meshes import Part
from mphygs.fit.start import with_effect
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.scene.closest import closest_material
from mphygs.simulate.fields import GRADIENTS

PLACED = ("attached_mass", "tether")
# A flow or a yield stress has no derivative where it is absent: fits start from a usual value.
_DRAG_COEFFICIENT = 1.0


def principal_axis(part: Part) -> np.ndarray:
    """(3,) unit direction of a part's largest extent, its largest component positive."""
    centred = part.vertices - part.vertices.mean(0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    return axis * np.sign(axis[np.abs(axis).argmax()])


def place_of_effect(capture: Capture, sequences: Sequence[str]) -> np.ndarray:
    """(3,) material point [m] at the marker farthest from what is held."""
    recording = capture.sequence(sequences[0])
    at = recording.markers.at
    distance = np.linalg.norm(at - at.mean(0), axis=1)
    if recording.held:
        boxes = np.array([hold.box for hold in recording.held])
        gap = np.maximum(boxes[:, None, 0] - at, 0.0) + np.maximum(at - boxes[:, None, 1], 0.0)
        distance = np.linalg.norm(gap, axis=-1).min(0)
    return closest_material(capture.parts, at[[distance.argmax()]]).anchor[0]


def place_of_load(capture: Capture, load: Load) -> np.ndarray:
    """(3,) material point [m] in the middle of what of a load's box the object reaches into."""
    vertices = np.concatenate([part.vertices for part in capture.parts])
    box = np.clip(np.asarray(load.box, float), vertices.min(0), vertices.max(0))
    return closest_material(capture.parts, box.mean(0)[None]).anchor[0]


def weights_of_loads(capture: Capture, sequences: Sequence[str]) -> list[tuple[Load, dict[str, object]]]:
    """The known loads of the sequences, alike ones once, each with the settings of its point mass.

    A load that is a weight has a mass as well: it brings inertia in the sequences that have the load; its
    weight is the load, and is not added again. One that ends is no weight: it would have to come off.
    """
    found: dict[bytes, tuple[Load, dict[str, object]]] = {}
    for name in sequences:
        for load in capture.sequence(name).loads:
            if load.end_frame is not None:
                continue
            key = np.asarray(load.box, float).tobytes() + np.asarray(load.force, float).tobytes()
            if key not in found:
                place = place_of_load(capture, load).tolist()
                found[key] = load, {"place": place, "sequences": [], "weight": False, "at_rest": False}
            having = found[key][1]["sequences"]
            if name not in having:
                having.append(name)
    return list(found.values())


def masses_of_loads(capture: Capture, sequences: Sequence[str]) -> list[dict[str, object]]:
    """Settings of a point mass for each known load of the sequences, see `weights_of_loads`."""
    return [settings for _, settings in weights_of_loads(capture, sequences)]


def with_placed_effect(belief: Belief, name: str, capture: Capture, sequences: Sequence[str]) -> Belief:
    """The belief with an effect added; what it needs besides numbers comes from the object.

    A point mass: that of a known load, where there is one (see `masses_of_loads`). Else a place: that of the
    marker farthest from the holds. A part: the largest. An axis:
    that part's longest. Raises ValueError for an effect that is there already, and for one without any
    derivative where it is absent: those are found by trials.
    """
    largest = max(capture.parts, key=lambda part: part.volume)
    if effect(name).kind == "threshold" or name == "marker_outliers":
        raise ValueError(
            f"effect '{name}': a fit cannot start from its absence; "
            f"expected it to be added by: mphygs extend RUN {name}"
        )
    hung = masses_of_loads(capture, sequences) if name == "attached_mass" else []
    if hung:
        return belief.with_effect(name, {}, hung[0])
    if name in PLACED:
        place = place_of_effect(capture, sequences)
        values = {}
        if name == "tether":
            values = dict(zip(("anchor_x", "anchor_y", "anchor_z"), map(float, place), strict=True)) | {
                "k": 1e-3
            }
        return belief.with_effect(name, values, {"place": place.tolist()})
    if name in GRADIENTS:
        return belief.with_effect(
            name, settings={"part": largest.name, "axis": principal_axis(largest).tolist()}
        )
    if name == "fibre":
        return belief.with_effect(
            name, dict(zip(("a_x", "a_y", "a_z"), map(float, principal_axis(largest)), strict=True))
        )
    if name == "wind":
        return belief.with_effect(name, {"c_d": _DRAG_COEFFICIENT})
    return with_effect(belief, name)

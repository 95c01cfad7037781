"""Effects named without a place or a direction: where the object itself suggests to put them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.holds import Load
from mphygs.capture.meshes import Part
from mphygs.fit.start import starting_values
from mphygs.model.belief import Belief
from mphygs.model.descriptor import ParameterSpec
from mphygs.model.registry import effect
from mphygs.scene.closest import closest_material

# What is tied to an anchor where it is begins with so much of its usual strength.
_SLIGHT = 1e-3


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
    marker farthest from the holds, with an anchor there. A part: the largest. An axis or a direction: that
    part's longest. What multiplies a flow has its usual size: a flow has no derivative where that is absent.
    Raises ValueError for an effect that is there already, and for one without any derivative where it is
    absent: those are found by trials.
    """
    spec = effect(name)
    if spec.threshold or spec.fault and not spec.fitted:
        raise ValueError(
            f"effect '{name}': a fit cannot start from its absence; "
            f"expected it to be added by: mphygs extend RUN {name}"
        )
    largest = max(capture.parts, key=lambda part: part.volume)
    values, settings = starting_values(belief, name), {}
    strengths = [p for p in spec.fitted if p.role == "strength"]
    hung = masses_of_loads(capture, sequences) if spec.site == "mass" else []
    if hung:
        settings |= hung[0]
    elif spec.placed:
        place = place_of_effect(capture, sequences)
        settings["place"] = place.tolist()
        if spec.of_role("anchor"):
            values |= _components(spec.of_role("anchor"), place)
            values |= {p.name: _SLIGHT * p.scale for p in strengths}
    if "part" in spec.settings:
        settings["part"] = largest.name
    if "axis" in spec.settings:
        settings["axis"] = principal_axis(largest).tolist()
    for role in ("axis", "direction"):
        values |= _components(spec.of_role(role), principal_axis(largest))
    if spec.of_role("flow"):
        values |= {p.name: p.scale for p in strengths}
    return belief.with_effect(name, values, settings)


def _components(parameters: Sequence[ParameterSpec], vector: np.ndarray) -> dict[str, float]:
    """The components of a vector (3,) by the names of the parameters that stand for them, if any."""
    return {p.name: float(v) for p, v in zip(parameters, vector, strict=False)}

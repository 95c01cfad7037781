"""Sanity of a whole capture; what a value allows on its own is checked where it is read."""

from __future__ import annotations

import numpy as np

from mphygs.capture.actuator_checks import check_actuators
from mphygs.capture.errors import CaptureError, fault
from mphygs.capture.holds import Hold
from mphygs.capture.markers import Markers
from mphygs.capture.material_checks import check_load, check_material, check_names, span
from mphygs.capture.meshes import Part, is_closed
from mphygs.capture.overlap import distance_to_box, just_inside, winding_number
from mphygs.capture.record import Capture, Sequence
from mphygs.capture.sensor_checks import check_sensors

SIZE = (1e-3, 20.0)  # [m] of the object
DENSITY = (5.0, 25000.0)  # [kg/m^3], from light foam to osmium
FAR = 100.0  # sizes of the object, that anything of it moves
STRETCH = 5.0  # sizes of the object, between a marker and what is held
THINNEST = 1.0 / 1500.0  # of a part's size
GRAVITY = 300.0  # [m/s^2]; more is another unit than m/s^2


def check_capture(capture: Capture) -> None:
    """Raise CaptureError at the first thing that contradicts another or cannot be in SI units."""
    check_object(capture)
    file = str(capture.folder / "capture.json")
    check_names(f"{file}: sequences", [sequence.name for sequence in capture.sequences], dots=True)
    for index, sequence in enumerate(capture.sequences):
        where = f"{file}: sequences[{index}]"
        _check_measured(where, sequence)
        for i, hold in enumerate(sequence.held):
            _check_hold(f"{where}.held[{i}]", capture, hold)
        for i, load in enumerate(sequence.loads):
            check_material(f"{where}.loads[{i}].box", capture, load.box)
            check_load(f"{where}.loads[{i}].force", capture, load)
        check_actuators(where, capture, sequence.actuators)
        if sequence.markers is not None:
            _check_markers(f"{where}.markers", capture, sequence, sequence.markers)
            _check_tracks(f"{where}.markers", capture, sequence, sequence.markers)
        check_sensors(where, capture, sequence)


def check_object(capture: Capture) -> None:
    """The same of what the object is, whatever was measured of it."""
    file = str(capture.folder / "capture.json")
    check_names(f"{file}: object.parts", [part.name for part in capture.parts], dots=False)
    _check_units(file, capture)
    _check_owned(file, capture)


def _check_units(file: str, capture: Capture) -> None:
    strength = float(np.linalg.norm(capture.gravity))
    if strength > GRAVITY:
        raise fault(
            f"{file}: gravity", f"is {strength:g} m/s^2 strong", f"at most {GRAVITY:g}, 9.81 on earth"
        )
    known = capture.known
    for name, density in known.density.items():
        _check_density(f"{file}: object.known.density.{name}", density)
    if not capture.parts:
        return
    for index, part in enumerate(capture.parts):
        _check_mesh(f"{file}: object.parts[{index}].mesh", part)
    size = capture.diagonal
    assert size is not None
    if not SIZE[0] <= size <= SIZE[1]:
        largest = int(np.argmax([np.ptp(part.bounds, axis=0).max() for part in capture.parts]))
        raise _wrong_size(f"{file}: object.parts[{largest}].scale", size)
    for index, part in enumerate(capture.parts):
        part_size = float(np.linalg.norm(np.ptp(part.bounds, axis=0)))
        if part_size < size / 500:
            raise fault(
                f"{file}: object.parts[{index}].scale",
                f'part "{part.name}" is {part_size:.3g} m across in an object of {size:.3g} m',
                "parts of like size; units look off by 1000: set scale to 1000 times its value here, "
                "or to 0.001 times its value in the others",
            )
        thickness = 2.0 * part.volume / part.area
        if thickness < THINNEST * part_size:
            raise fault(
                f"{file}: object.parts[{index}].mesh",
                f'part "{part.name}" is {thickness:.2g} m thick, 1/{part_size / thickness:.0f} of its size',
                f"at least 1/{1 / THINNEST:.0f}, for no grid resolves less (are all axes in one unit?)",
            )
        thickness *= 2.0 if part.shape == "rod" else 1.0
        if part.thickness_std >= thickness:
            raise fault(
                f"{file}: object.parts[{index}].thickness_std",
                f"is {part.thickness_std:g} m, of a part that is {thickness:.2g} m thick",
                "less than that (is it in m?)",
            )
    if known.mass is not None:
        volume = sum(part.volume for part in capture.parts)
        mean = known.mass / volume
        if not DENSITY[0] <= mean <= DENSITY[1]:
            raise fault(
                f"{file}: object.known.mass",
                f"{known.mass:g} kg in {volume:.3g} m^3 is {mean:.3g} kg/m^3",
                f"{DENSITY[0]:g} to {DENSITY[1]:g} kg/m^3 (is mass in kg, and scale file unit -> metre?)",
            )
        least = sum(known.density.get(part.name, 0.0) * part.volume for part in capture.parts)
        if least > 1.2 * known.mass:
            raise fault(
                f"{file}: object.known.mass",
                f"{known.mass:g} kg is less than the {least:.3g} kg of the parts of known density",
                "mass of the whole object",
            )


def _check_mesh(where: str, part: Part) -> None:
    """What a file's mesh is made sure of where it is read, for a mesh of arrays."""
    vertices, faces = part.vertices, part.faces
    what = None
    if np.ndim(vertices) != 2 or np.shape(vertices)[1] != 3 or np.ndim(faces) != 2 or np.shape(faces)[1] != 3:
        what = f"has vertices of shape {np.shape(vertices)} and faces of shape {np.shape(faces)}"
    elif not len(faces):
        what = "has no triangles"
    elif faces.min() < 0 or faces.max() >= len(vertices):
        what = f"has faces with corners {faces.min()} to {faces.max()}, of {len(vertices)} vertices"
    elif not np.isfinite(vertices).all():
        what = "has vertices that are not finite"
    elif not is_closed(faces):
        what = "is not closed"
    elif not part.volume > 0.0:
        what = "encloses no volume, or is turned inward"
    if what is not None:
        raise fault(where, f'part "{part.name}" {what}', "a closed mesh (V, 3), (F, 3), wound outward")


def _check_owned(file: str, capture: Capture) -> None:
    """A part that lies inside earlier ones, which own the material where parts overlap, is none."""
    for index, part in enumerate(capture.parts):
        points = just_inside(part.vertices, part.faces)
        for earlier in capture.parts[:index]:
            low, high = earlier.bounds
            if not ((points >= low) & (points <= high)).all() or not len(points):
                continue
            if (winding_number(points, earlier.vertices, earlier.faces) > 0.5).all():
                raise fault(
                    f"{file}: object.parts[{index}].mesh",
                    f'part "{part.name}" lies inside part "{earlier.name}", which owns the material there',
                    "material of its own (is a body given twice? an inner part stands before the outer one)",
                )


def _check_density(where: str, density: float) -> None:
    if not DENSITY[0] <= density <= DENSITY[1]:
        raise fault(where, f"is {density:g} kg/m^3", f"{DENSITY[0]:g} to {DENSITY[1]:g} kg/m^3")


def _wrong_size(where: str, size: float) -> CaptureError:
    """An object too large or too small, with the factor of 1000 that would bring it to a sensible size."""
    factor = 1e-3 if size > SIZE[1] else 1e3
    fits = SIZE[0] <= size * factor <= SIZE[1]
    hint = f"; its units look off by 1000: set scale to {factor:g} times its value" if fits else ""
    return fault(where, f"the object is {size:.3g} m across", f"{SIZE[0]:g} to {SIZE[1]:g} m{hint}")


def _check_measured(where: str, sequence: Sequence) -> None:
    start, stop = sequence.fit
    if start == stop or sequence.views is not None:
        return
    if sequence.markers is None:
        raise fault(f"{where}.fit", "nothing is measured in this sequence", "markers or views to fit to")
    if not np.isfinite(sequence.markers.position[start:stop]).any():
        raise fault(
            f"{where}.fit", f"no marker is measured in frames {start} to {stop}", "measured positions"
        )


def _check_hold(where: str, capture: Capture, hold: Hold) -> None:
    check_material(f"{where}.box", capture, hold.box)
    bounds, size = capture.bounds, capture.diagonal
    if bounds is None or size is None:
        return
    if (hold.box[0] <= bounds[0]).all() and (hold.box[1] >= bounds[1]).all():
        raise fault(f"{where}.box", "holds the whole object", f"some of it to be free: {span(capture)}")
    if hold.position is not None:
        frames = np.arange(len(hold.position))
        rotation, position = hold.poses(frames, 1.0)
        centre = np.clip(hold.box.mean(axis=0), bounds[0], bounds[1])
        far = float(np.abs(rotation @ centre + position - centre).max())
        if far > max(FAR * size, 5.0):
            raise fault(
                f"{where}.motion",
                f"moves the held points {far:.3g} m, {far / size:.0f} times the size of the object",
                "positions in m (units look off by 1000)",
            )


def _check_markers(where: str, capture: Capture, sequence: Sequence, markers: Markers) -> None:
    bounds, size = capture.bounds, capture.diagonal
    if bounds is None or size is None:
        return
    if markers.stated > size:
        raise fault(
            f"{where}.sigma", f"is {markers.stated:g} m, larger than the object", f"far below {size:.3g} m"
        )
    far = distance_to_box(markers.at, bounds)
    worst = int(np.argmax(far))
    if far[worst] > max(0.5 * size, 5e-3):
        raise fault(
            f"{where}.at[{worst}]",
            f"lies {far[worst]:.3g} m from the object",
            f"places on or near {span(capture)} (is it in m, in the object frame?)",
        )
    spread = float(np.linalg.norm(np.ptp(markers.at, axis=0)))
    if len(markers.at) > 1 and spread < size / 500:
        raise fault(
            f"{where}.at",
            f"markers spread over {spread:.3g} m of an object of {size:.3g} m",
            "markers [m] over the object (units look off by 1000: is the scale of the parts right?)",
        )
    # a moving hold may have carried the object elsewhere before the recording began
    carried = [markers.at]
    for hold in sequence.held:
        if hold.position is not None:
            rotation, position = hold.poses(np.zeros(1), 1.0)
            carried.append(markers.at @ rotation[0].T + position[0])
    rest = markers.at_rest(sequence.release)
    away = np.min([np.linalg.norm(rest - at, axis=1) for at in carried], axis=0)
    if sequence.start == "measured":
        # It may be turned over about where it is held, and no more.
        size *= 4.0
    seen = np.isfinite(away)
    if not seen.any():
        return
    worst = int(np.argmax(np.where(seen, away, -1.0)))
    if away[worst] > 0.5 * size:
        raise fault(
            f"{where}.at[{worst}]",
            f"marker {worst} is measured {away[worst]:.3g} m from there at rest",
            f"measured positions in m in the object frame, within {0.5 * size:.3g} m of at",
        )


def _check_tracks(where: str, capture: Capture, sequence: Sequence, markers: Markers) -> None:
    """Positions that no marker on the object has, in any frame, fitted or not."""
    bounds, size = capture.bounds, capture.diagonal
    if bounds is None or size is None:
        return
    frames = np.arange(len(markers.position))
    middle = bounds.mean(axis=0)
    held = []
    for hold in sequence.held:
        rotation, position = hold.poses(frames, 1.0)
        held.append(rotation @ np.clip(hold.box.mean(axis=0), *bounds) + position)
    away = np.min([_distance(markers.position, place[:, None]) for place in (*held, middle[None])], axis=0)
    frame, marker = np.unravel_index(int(np.nanargmax(away)), away.shape)
    most = max(FAR * size, 5.0)
    said = f"marker {marker} is measured {away[frame, marker]:.3g} m from the object in frame {frame}"
    if away[frame, marker] > most:
        raise fault(f"{where}.file", said, f"positions in m, within {most:.3g} m")
    if markers.sigma > size:
        what = f"markers scatter by {markers.sigma:.3g} m, more than the object is across"
        raise fault(f"{where}.file", what, f"positions in m of an object of {size:.3g} m")
    if not held:
        return
    away = np.min([_distance(markers.position, place[:, None]) for place in held], axis=0)
    frame, marker = np.unravel_index(int(np.nanargmax(away)), away.shape)
    if away[frame, marker] > STRETCH * size:
        raise fault(
            f"{where}.file",
            f"marker {marker} is measured {away[frame, marker]:.3g} m from what is held in frame {frame}, "
            f"{away[frame, marker] / size:.1f} times the size of the object",
            f"within {STRETCH:g} times its size (is it still held then?)",
        )


def _distance(position: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(T, M) [m], of any size that a number has."""
    apart = position - place
    largest = np.abs(apart).max(axis=2, keepdims=True)
    return largest[..., 0] * np.linalg.norm(apart / np.where(largest > 0, largest, 1.0), axis=2)

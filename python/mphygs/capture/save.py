"""Writing a capture as a folder that reads back equal."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from mphygs.capture.actuators import Actuator, Force, Pressure, Tendon
from mphygs.capture.checks import check_capture
from mphygs.capture.meshes import Part, write_mesh
from mphygs.capture.record import Capture, Sequence
from mphygs.capture.sensors import FORCE, Sensor
from mphygs.capture.written import replace_arrays, replace_file

FORMAT = "mphygs-capture/1"
RESTS = ("stress-free", "equilibrium")
STARTS = ("rest", "measured")


def save_capture(capture: Capture, folder: str | Path) -> None:
    """Write `capture` to `folder`: capture.json, meshes as .ply, motions and markers as .npz, views copied.

    capture.json comes last, so that a write that was broken off leaves no capture. Raises CaptureError when
    the capture contradicts itself.
    """
    folder = Path(folder)
    check_capture(replace(capture, folder=folder))
    folder.mkdir(parents=True, exist_ok=True)
    shape: dict[str, object] = {}
    if capture.parts:
        shape["parts"] = [
            {"name": part.name, "mesh": f"{part.name}.ply", "scale": 1.0, **_shape_of(part)}
            for part in capture.parts
        ]
        for part in capture.parts:
            write_mesh(folder / f"{part.name}.ply", part.vertices, part.faces)
    if capture.gaussians is not None:
        shape["gaussians"] = _copy(capture.gaussians, folder / "gaussians.ply")
        shape |= {} if capture.gaussians_scale == 1.0 else {"scale": capture.gaussians_scale}
    if capture.views is not None:
        shape["views"] = _copy(capture.views, folder / "rest_views")
        shape |= {} if capture.views_scale == 1.0 else {"scale": capture.views_scale}
    shape |= {} if capture.parts or capture.found_as == "solid" else {"as": capture.found_as}
    known: dict[str, object] = {}
    if capture.known.density:
        known["density"] = capture.known.density
    if capture.known.poissons_ratio is not None:
        known["poissons_ratio"] = capture.known.poissons_ratio
    if capture.known.mass is not None:
        known["mass"] = capture.known.mass
    document = {
        "format": FORMAT,
        "name": capture.name,
        "gravity": np.asarray(capture.gravity).tolist(),
        "object": {**shape, "rest": capture.rest, "known": known},
        "sequences": [_write_sequence(sequence, folder) for sequence in capture.sequences],
    }
    text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False)
    replace_file(folder / "capture.json", text + "\n")


def _write_sequence(sequence: Sequence, folder: Path) -> dict[str, object]:
    held: list[dict[str, object]] = []
    for index, hold in enumerate(sequence.held):
        motion = "fixed"
        if not hold.is_fixed:
            motion = f"{sequence.name}_hold{index}.npz"
            replace_arrays(folder / motion, {"position": hold.position, "quaternion": hold.quaternion})
        held.append({"box": hold.box.tolist(), "motion": motion})
    document: dict[str, object] = {
        "name": sequence.name,
        "fps": sequence.fps,
        "frames": sequence.frames,
        "fit": list(sequence.fit),
        "predict": list(sequence.predict),
        "held": held,
    }
    if sequence.loads or sequence.actuators:
        document["loads"] = [
            {"box": load.box.tolist(), "force": load.force.tolist(), "from": load.start_frame}
            | ({} if load.end_frame is None else {"until": load.end_frame})
            for load in sequence.loads
        ] + [_write_actuator(actuator, sequence.name, folder) for actuator in sequence.actuators]
    if sequence.start is not None:
        document["start"] = sequence.start
    if sequence.release is not None:
        document["release"] = sequence.release
    if sequence.markers is not None:
        markers = sequence.markers
        file = f"{sequence.name}_markers.npz"
        replace_arrays(folder / file, {"position": markers.position})
        document["markers"] = {"file": file, "at": markers.at.tolist(), "sigma": markers.sigma}
        if markers.names:
            document["markers"]["names"] = list(markers.names)
    if sequence.sensors:
        document["sensors"] = [
            _write_sensor(sensor, folder, f"{sequence.name}_sensor{index}.npz")
            for index, sensor in enumerate(sequence.sensors)
        ]
    if sequence.views is not None:
        document["views"] = _copy(sequence.views, folder / "views" / sequence.name)
        document |= {} if sequence.views_scale == 1.0 else {"scale": sequence.views_scale}
    return document


def _write_sensor(sensor: Sensor, folder: Path, file: str) -> dict[str, object]:
    values = np.moveaxis(sensor.value, 1, 0)
    replace_arrays(folder / file, dict(zip(sensor.quantities, values, strict=True)))
    document: dict[str, object] = {"kind": sensor.kind, "file": file}
    if sensor.kind == FORCE:
        document["hold"] = sensor.hold
    else:
        document |= {"at": np.asarray(sensor.at).tolist(), "gravity": sensor.gravity}
    stated = zip(("sigma", "torque_sigma"), sensor.sigma.tolist(), strict=False)
    return document | {key: sigma for key, sigma in stated if np.isfinite(sigma)}


def _write_actuator(actuator: Actuator, sequence: str, folder: Path) -> dict[str, object]:
    file = f"{sequence}_{actuator.name}.npz"
    replace_arrays(folder / file, {actuator.array: actuator.values})
    entry: dict[str, object] = {"name": actuator.name}
    if isinstance(actuator, Force):
        entry |= {"box": actuator.box.tolist(), "force": file}
    elif isinstance(actuator, Pressure):
        patch: dict[str, object] = {} if actuator.part is None else {"part": actuator.part}
        patch |= {} if actuator.box is None else {"box": actuator.box.tolist()}
        entry |= {"patch": patch, "pressure": file}
    elif isinstance(actuator, Tendon):
        entry |= {"tendon": actuator.path.tolist(), "tension": file}
        entry |= {} if actuator.anchor is None else {"anchor": actuator.anchor.tolist()}
    entry["from"] = actuator.start_frame
    entry |= {} if actuator.end_frame is None else {"until": actuator.end_frame}
    return entry | ({"unknown": list(actuator.unknown)} if actuator.unknown else {})


def _shape_of(part: Part) -> dict:
    unsure = {"thickness_std": part.thickness_std} if part.thickness_std else {}
    return unsure | ({} if part.shape == "solid" else {"as": part.shape})


def _copy(source: Path, target: Path) -> str:
    """Copy a file or folder to `target`, unless it stands there already; its path relative to the capture."""
    if source.resolve() != target.resolve():
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, dirs_exist_ok=True)
        else:
            shutil.copyfile(source, target)
    return "/".join(target.parts[-2:]) if target.parent.name == "views" else target.name

"""The run folder: exact options, versions, seed, what is believed, and how it was found."""

from __future__ import annotations

import hashlib
import json
import platform
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import metadata
from pathlib import Path

import numpy as np
from safetensors.numpy import save

from mphygs.capture.document import read_document
from mphygs.capture.errors import CaptureError
from mphygs.capture.format import Capture
from mphygs.capture.tensors import read_tensors
from mphygs.capture.written import replace_file
from mphygs.fit.belief_document import belief_from_document, document_of_belief, plain_value
from mphygs.fit.limits import Limits, limits_document, limits_from_document
from mphygs.fit.run_checks import check_run_document
from mphygs.model.belief import Belief
from mphygs.simulate.settings import Settings

FORMAT = "mphygs-run/1"
DOCUMENT, NUMBERS = "run.json", "numbers.safetensors"
# What a baseline has learnt.
TRAINED = "baseline.safetensors"
# Folder of the stages of an image capture in a run's, which may stand elsewhere.
STAGES = "stages"
_LONGEST_NAME = 100  # bytes of a folder's name


@dataclass(frozen=True)
class StageRecord:
    """One finished stage of the schedule. costs: half the sum of squares after every iteration; misfit: root
    mean square of what it left of the measurements [sigma]."""

    name: str
    spacing: float
    costs: tuple[float, ...]
    converged: bool
    reason: str
    seconds: float
    misfit: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """A fit, finished or on its way.

    folder: where it is kept; options: of the command, as given; capture: folder of the capture fitted,
    digest: of its content; stages: folder of the stages of an image capture, None for others;
    settings: of the simulation, spacing in [m]; ranges: frames fitted per sequence;
    covariance: (P, P) of the free coordinates, information: (P, P) what the measurements alone say of them,
    both None until the fit is complete; limits: how far numbers can be moved, of those that were asked for,
    which both matrices know of; history: stages done;
    start: the belief that the fit began with; earlier: that of the stage before the last one, if any;
    left_out: (frame, marker) by sequence of measurements taken as outliers; answer: JSON of the command, once
    complete.
    """

    folder: Path
    options: Mapping[str, object]
    seed: int
    capture: Path
    digest: str
    settings: Settings
    ranges: Mapping[str, tuple[int, int]]
    start: Belief
    belief: Belief
    versions: Mapping[str, str] = field(default_factory=lambda: versions())
    covariance: np.ndarray | None = None
    information: np.ndarray | None = None
    limits: Mapping[str, Limits] = field(default_factory=dict)
    history: tuple[StageRecord, ...] = ()
    left_out: Mapping[str, tuple[tuple[int, int], ...]] = field(default_factory=dict)
    answer: Mapping[str, object] | None = None
    stages: Path | None = None
    earlier: Belief | None = None

    @property
    def transfer(self) -> str:
        """Name of the transfer that simulates."""
        return self.settings.transfer

    @property
    def complete(self) -> bool:
        """Whether the schedule is done."""
        return self.covariance is not None

    def after(self, record: StageRecord, belief: Belief) -> Run:
        """This run with one more stage done."""
        earlier = self.belief if self.history else None
        return replace(self, belief=belief, earlier=earlier, history=(*self.history, record))

    def save(self) -> None:
        """Write the folder. Files are replaced as a whole: a write that is broken off leaves the last one."""
        self.folder.mkdir(parents=True, exist_ok=True)
        numbers = {"values": np.array([p.value for p in self.belief.parameters])}
        if self.covariance is not None:
            numbers["covariance"] = np.ascontiguousarray(self.covariance)
            numbers["information"] = np.ascontiguousarray(self.information)
        if self.history:
            numbers["costs"] = np.array([cost for stage in self.history for cost in stage.costs])
        content = save(
            numbers, metadata={"format": FORMAT, "keys": json.dumps([p.key for p in self.belief.parameters])}
        )
        replace_file(self.folder / NUMBERS, content)
        replace_file(self.folder / DOCUMENT, json.dumps(self._document(), indent=1) + "\n")

    def _document(self) -> dict[str, object]:
        stages = {} if self.stages is None else {"stages": self._told(self.stages)}
        return {
            "format": FORMAT,
            "complete": self.complete,
            "options": plain_value(self.options),
            "versions": dict(self.versions),
            "seed": self.seed,
            "capture": self._told(self.capture),
            "digest": self.digest,
            **stages,
            "transfer": self.transfer,
            "settings": {
                "spacing": self.settings.spacing,
                "safety": self.settings.safety,
                "dtype": self.settings.dtype,
                "memory_budget": self.settings.memory_budget,
                "integrator": self.settings.integrator,
            },
            "ranges": {name: list(frames) for name, frames in self.ranges.items()},
            "start": document_of_belief(self.start),
            "belief": document_of_belief(self.belief),
            "earlier": None if self.earlier is None else document_of_belief(self.earlier),
            "history": [asdict(record) for record in self.history],
            "left_out": plain_value(self.left_out),
            "limits": limits_document(self.limits),
            "answer": plain_value(self.answer),
        }

    def _told(self, path: Path) -> str:
        """A path as the document has it: what stands inside the run folder moves with it."""
        inside = path.resolve().is_relative_to(self.folder.resolve())
        return str(path.resolve().relative_to(self.folder.resolve()) if inside else path.resolve())


def folder_name(name: str) -> str:
    """A name that may be any text as that of one folder: letters, digits, "_", "-", "+", "." and spaces."""
    plain = re.sub(r"[^\w .+-]+", "-", name).encode()[:_LONGEST_NAME].decode(errors="ignore")
    return plain.strip(" .") or "capture"


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for package in ("mphygs", "numpy", "scipy", "torch"):
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def capture_digest(capture: Capture) -> str:
    """A hash of everything in a capture that a fit depends on."""
    hashed = hashlib.sha256()

    def add(*values: object) -> None:
        for value in values:
            array = np.asarray(value) if isinstance(value, np.ndarray) else None
            hashed.update(array.tobytes() if array is not None else repr(value).encode())

    add(np.asarray(capture.gravity, float), capture.rest, sorted(capture.known.density.items()))
    add(capture.known.poissons_ratio, capture.known.mass)
    for part in capture.parts:
        add(part.name, part.vertices, part.faces)
        if part.shape != "solid":
            add(part.shape, part.thickness_std)
    for recording in capture.sequences:
        add(
            recording.name,
            recording.fps,
            recording.frames,
            recording.fit,
            recording.predict,
            recording.release,
        )
        for hold in recording.held:
            add(np.asarray(hold.box), hold.position, hold.quaternion)
        for actuator in recording.actuators:
            add(type(actuator).__name__, actuator.name, actuator.values, *actuator.places.values())
            add(actuator.start_frame, actuator.end_frame, actuator.unknown, getattr(actuator, "part", None))
        for load in recording.loads:
            add(np.asarray(load.box), np.asarray(load.force), load.start_frame)
            if load.end_frame is not None:
                add(load.end_frame)
        if recording.start is not None:
            add(recording.start)
        if recording.markers is not None:
            add(recording.markers.at, recording.markers.position, recording.markers.sigma)
            if recording.markers.scatter is not None:
                add(recording.markers.scatter)
            if recording.markers.offset:
                add(recording.markers.offset)
            if recording.markers.spread is not None:
                add(recording.markers.spread, recording.markers.memory, recording.markers.lasting)
        for sensor in recording.sensors:
            add(sensor.kind, sensor.value, sensor.sigma, sensor.hold, sensor.at, sensor.gravity)
    return hashed.hexdigest()


def same_file(one: Path, other: str | Path) -> bool:
    """Whether both are there and the same file."""
    return one.exists() and Path(other).exists() and one.samefile(other)


def is_run(folder: Path) -> bool:
    """Whether a folder holds a run."""
    return (folder / DOCUMENT).is_file()


def load_run(path: str | Path) -> Run:
    """The run in a folder. Raises ValueError, one line, where there is none or it is damaged."""
    folder = Path(path)
    if folder.name == DOCUMENT and folder.is_file():
        folder = folder.parent
    if not is_run(folder):
        raise ValueError(f"{folder}: is not a run; expected a folder with a {DOCUMENT}, as fit writes it")
    check_links(folder)
    root = read_document(folder / DOCUMENT, finite=False)
    if root.table().get("format") != FORMAT:
        raise root.child("format").wrong(f'"{FORMAT}"')
    check_run_document(root)
    document = root.table()
    try:
        belief = belief_from_document(document["belief"])
        run = Run(
            folder=folder,
            options=document["options"],
            versions=document["versions"],
            seed=document["seed"],
            # A capture inside the run folder moves with it.
            capture=folder / document["capture"],
            digest=document["digest"],
            stages=folder / document["stages"] if "stages" in document else None,
            settings=Settings(**document["settings"], transfer=document["transfer"]),
            ranges={name: (a, b) for name, (a, b) in document["ranges"].items()},
            start=belief_from_document(document["start"]),
            belief=belief,
            history=tuple(StageRecord(**{**r, "costs": tuple(r["costs"])}) for r in document["history"]),
            left_out={n: tuple((f, m) for f, m in e) for n, e in document["left_out"].items()},
            limits=limits_from_document(document.get("limits", {})),
            answer=document["answer"],
            earlier=belief_from_document(document["earlier"]) if document.get("earlier") else None,
        )
    except ValueError as error:
        raise CaptureError(f"{root.file}: {error}; expected a run as fit writes it") from error
    if not document["complete"]:
        return run
    covariance, information = _matrices(folder, belief)
    return replace(run, covariance=covariance, information=information)


def check_links(folder: Path) -> None:
    """Raises ValueError where what a command writes into a run would go elsewhere, through a link in it."""
    for path in folder.iterdir():
        if path.is_symlink() and path.name != STAGES and not path.resolve().is_relative_to(folder.resolve()):
            raise ValueError(f"{path}: is a link that leads out of the run; expected a file or folder there")


def _matrices(folder: Path, belief: Belief) -> tuple[np.ndarray, np.ndarray]:
    """Covariance and information of a complete run, whose numbers must be those of its belief."""
    where = folder / NUMBERS
    numbers = read_tensors(where, f"the numbers of {DOCUMENT}")
    try:
        values, covariance, information = (numbers[key] for key in ("values", "covariance", "information"))
    except KeyError as error:
        raise ValueError(f"{where}: has no {error}; expected the numbers of {DOCUMENT}") from error
    count = len(belief.free)
    if not all(array.dtype == np.float64 and np.isfinite(array).all() for array in (covariance, information)):
        raise ValueError(f"{where}: holds what is no number; expected the numbers of {DOCUMENT}")
    if not covariance.shape == information.shape == (count, count) or not np.array_equal(
        values, [p.value for p in belief.parameters]
    ):
        raise ValueError(f"{where}: does not belong to {DOCUMENT}; expected the same values in both")
    return covariance, information

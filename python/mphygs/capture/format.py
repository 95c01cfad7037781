"""The capture format, version 1: a folder with capture.json becomes a Capture, checked."""

from __future__ import annotations

from pathlib import Path

from mphygs.capture.actuators import Actuator, is_actuator, read_actuator
from mphygs.capture.checks import check_capture
from mphygs.capture.document import Entry, read_document
from mphygs.capture.errors import CaptureError, fault
from mphygs.capture.files import file_inside, views_inside
from mphygs.capture.holds import Hold, Load, read_hold, read_load
from mphygs.capture.layouts import read_scale
from mphygs.capture.markers import Markers, read_markers
from mphygs.capture.meshes import Part, read_part
from mphygs.capture.record import Capture, Known, Sequence
from mphygs.capture.save import FORMAT, RESTS, STARTS, save_capture
from mphygs.capture.sensors import Sensor, read_sensors

__all__ = [
    "Capture",
    "CaptureError",
    "Hold",
    "Known",
    "Load",
    "Markers",
    "Part",
    "Sensor",
    "Sequence",
    "load_capture",
    "save_capture",
]

FPS = (0.1, 1e6)
MASSES = (1e-9, 1e6)  # [kg]
MOST_FRAMES = 1_000_000
_GEOMETRIES = ("parts", "gaussians", "views")
_UNITS = ("scale", "known_length")  # of views


def load_capture(path: str | Path) -> Capture:
    """The capture in the folder `path` (or whose capture.json is `path`).

    Raises CaptureError, one line with what, where and what was expected, when any of it cannot be used.
    """
    path = Path(path)
    folder = path.parent if path.name == "capture.json" and path.is_file() else path
    if not (folder / "capture.json").is_file():
        raise fault(str(path), "is not a capture", "a folder with a capture.json")
    root = read_document(folder / "capture.json")
    # another version may have other keys, so the version is looked at before them
    version = root.get("format")
    if version is not None and version.value != FORMAT:
        raise version.wrong(f'"{FORMAT}"')
    root.check_keys(required=("format", "name", "gravity", "object", "sequences"))
    name = root["name"].name()
    gravity = root["gravity"].array((3,), most=1e6)
    parts, gaussians, views = _read_geometry(folder, root["object"])
    if gaussians is None:
        views_scale, gaussians_scale = _read_views_scale(root["object"], views), 1.0
    else:
        views_scale, gaussians_scale = 1.0, read_scale(root["object"], None)
    sequences = tuple(_read_sequence(folder, entry) for entry in root["sequences"].elements())
    if not sequences:
        raise root["sequences"].fault("is empty", "at least one sequence")
    capture = Capture(
        name=name,
        folder=folder,
        gravity=gravity,
        parts=parts,
        rest=_read_rest(root["object"]),
        known=_read_known(root["object"].get("known"), tuple(part.name for part in parts)),
        sequences=sequences,
        gaussians=gaussians,
        views=views,
        views_scale=views_scale,
        gaussians_scale=gaussians_scale,
        found_as=_read_found_as(root["object"]),
    )
    check_capture(capture)
    return capture


def _read_geometry(folder: Path, entry: Entry) -> tuple[tuple[Part, ...], Path | None, Path | None]:
    entry.check_keys(required=("rest",), optional=(*_GEOMETRIES, *_UNITS, "known", "as"))
    given = [key for key in _GEOMETRIES if entry.get(key)]
    if len(given) != 1:
        what = f"has {' and '.join(given)}" if given else "has no geometry"
        raise entry.fault(what, f"exactly one of {', '.join(_GEOMETRIES)}")
    if gaussians := entry.get("gaussians"):
        path = file_inside(folder, gaussians)
        with path.open("rb") as stream:
            if stream.read(3) != b"ply":
                raise gaussians.fault(f"{path} is not a .ply file", "a 3D Gaussian splatting .ply")
        return (), path, None
    if views := entry.get("views"):
        return (), None, views_inside(folder, views)
    parts = tuple(read_part(folder, part) for part in entry["parts"].elements())
    if not parts:
        raise entry["parts"].fault("is empty", "at least one part")
    return parts, None, None


def _read_views_scale(entry: Entry, views: Path | None) -> float:
    """Metres per unit of the views beside which it is stated."""
    given = [key for key in _UNITS if entry.get(key)]
    if views is None:
        if given:
            expected = "views or gaussians beside it (a part has a scale)"
            raise entry[given[0]].fault("stands where no views are", expected)
        return 1.0
    return read_scale(entry, views)


def _read_found_as(entry: Entry) -> str:
    """What parts found in pictures are simulated as."""
    given = entry.get("as")
    if given is None:
        return "solid"
    if entry.get("parts"):
        raise given.fault("stands beside parts", 'views or gaussians beside it (a part has its own "as")')
    return given.choice(("solid", "auto"))


def _read_rest(entry: Entry) -> str:
    rest = entry["rest"].text()
    if rest not in RESTS:
        raise entry["rest"].wrong(" or ".join(f'"{choice}"' for choice in RESTS))
    return rest


def _read_known(entry: Entry | None, parts: tuple[str, ...]) -> Known:
    """Known quantities; one density stands for every part, or for "object" where there are no parts."""
    if entry is None:
        return Known()
    entry.check_keys(optional=("density", "poissons_ratio", "mass"))
    density: dict[str, float] = {}
    poissons_ratio: float | dict[str, float] | None = None
    mass: float | None = None
    if given := entry.get("density"):
        value = _read_per_part(given, parts, 0.0, float("inf"), "a density above zero [kg/m^3]")
        density = value if isinstance(value, dict) else dict.fromkeys(parts or ("object",), value)
    if given := entry.get("poissons_ratio"):
        # The bounds of the materials that are fitted.
        poissons_ratio = _read_per_part(
            given, parts, -1e-12, 0.4995, "a Poisson's ratio from 0 to below 0.4995"
        )
    if given := entry.get("mass"):
        mass = given.within(*MASSES, "a mass above zero [kg]")
    return Known(density=density, poissons_ratio=poissons_ratio, mass=mass)


def _read_per_part(
    entry: Entry, parts: tuple[str, ...], above: float, below: float, expected: str
) -> float | dict[str, float]:
    """One number, or part name -> number, each between `above` and `below`."""
    if not isinstance(entry.value, dict):
        number = entry.number()
        if not above < number < below:
            raise entry.wrong(expected)
        return number
    if parts:
        entry.check_keys(optional=parts)
    values: dict[str, float] = {}
    for name, child in entry.children():
        values[name] = child.number()
        if not above < values[name] < below:
            raise child.wrong(expected)
    return values


def _read_sequence(folder: Path, entry: Entry) -> Sequence:
    entry.check_keys(
        required=("name", "fps", "frames"),
        optional=(
            "fit", "predict", "held", "loads", "release", "start", "markers", "views", *_UNITS, "first_frame",
            "sensors",
        ),
    )  # fmt: skip
    name = entry["name"].name()
    fps = entry["fps"].within(*FPS, "frames per second")
    frames = entry["frames"].integer()
    if not 1 <= frames <= MOST_FRAMES:
        raise entry["frames"].wrong(f"at least 1, at most {MOST_FRAMES}")
    release: int | None = None
    if given := entry.get("release"):
        release = given.integer()
        if not 0 <= release < frames:
            raise given.wrong(f"a frame of the sequence, 0 to {frames - 1}")
    first: int | None = None
    if given := entry.get("first_frame"):
        first = given.integer()
        if not 0 <= first <= MOST_FRAMES:
            raise given.wrong(f"a frame of the file, 0 to {MOST_FRAMES}")
    start = _read_start(entry.get("start"), release)
    held, loads, markers, views = (entry.get(key) for key in ("held", "loads", "markers", "views"))
    acting = [
        read_actuator(folder, item, frames, number) if is_actuator(item) else read_load(item, frames)
        for number, item in enumerate(loads.elements() if loads else ())
    ]
    sensors = entry.get("sensors")
    holds = tuple(read_hold(folder, item, frames) for item in held.elements()) if held else ()
    seen = views_inside(folder, views) if views else None
    return Sequence(
        name=name,
        fps=fps,
        frames=frames,
        fit=_read_range(entry.get("fit"), frames),
        predict=_read_range(entry.get("predict"), frames),
        held=holds,
        loads=tuple(given for given in acting if isinstance(given, Load)),
        actuators=tuple(given for given in acting if isinstance(given, Actuator)),
        release=release,
        markers=read_markers(
            folder, markers, fps=fps, frames=frames, release=release, first=first, start=start
        )
        if markers
        else None,
        views=seen,
        views_scale=_read_views_scale(entry, seen),
        first_frame=first,
        start=start,
        sensors=read_sensors(folder, sensors, frames, len(holds)) if sensors else (),
    )


def _read_start(entry: Entry | None, release: int | None) -> str | None:
    if entry is None:
        return None
    start = entry.text()
    if start not in STARTS:
        raise entry.wrong(" or ".join(f'"{choice}"' for choice in STARTS))
    if start == "measured" and release is not None:
        raise entry.fault('is "measured" beside a release', "no release: until then all points are at rest")
    return start


def _read_range(entry: Entry | None, frames: int) -> tuple[int, int]:
    if entry is None:
        return 0, 0
    expected = f"[a, b] with 0 <= a <= b <= {frames}"
    items = entry.elements()
    if len(items) != 2:
        raise entry.fault(f"has {len(items)} elements", expected)
    start, stop = items[0].integer(), items[1].integer()
    if not 0 <= start <= stop <= frames:
        raise entry.fault(f"is [{start}, {stop}]", expected)
    return start, stop

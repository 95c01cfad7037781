"""The stages that follow the object through videos: register, track, contact, each made once a sequence."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from mphygs.capture.digest import digest_of
from mphygs.capture.errors import CaptureError, fault
from mphygs.capture.files import read_arrays
from mphygs.capture.format import Capture
from mphygs.capture.holds import Hold
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.rotation import quaternion_from_matrix
from mphygs.capture.stages import Stage, StageFolder
from mphygs.capture.view_folders import rest_views_of, sequence_views_of
from mphygs.capture.views import Photograph, RestViews, SequenceViews
from mphygs.motion.camera_check import check_cameras
from mphygs.motion.contact_motion import coarse_contact
from mphygs.motion.grip import Grip, find_grip
from mphygs.motion.registration import Registration, register
from mphygs.motion.stage_files import Registered, Tracks, read_registered, read_stage_hold, read_tracks
from mphygs.motion.track_choice import chosen_gaussians, tracks_of
from mphygs.motion.track_noise import variance_of_tracks
from mphygs.motion.tracking import Followed, TrackingRule, aligner_of, follow
from mphygs.scene.agreement import check_first_frame
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.ply import read_gaussians

Report = Callable[[float, str], None]
Source = Literal["own", "capture", "made", "new"]
JACKKNIFED = 6  # frames in which cameras are left out
_KEPT_EVERY = 5  # frames
# Of the work of tracking, the share that is done when the last frame is.
_FOLLOWING = 0.85


@dataclass(frozen=True, eq=False)
class VideoRun:
    """A capture, the run folder in which its stages stand, and the Gaussians at rest.

    longest: pictures larger along a side are used at a half, a third, ... of their size [px]; scale: metres
    per unit of the file of the Gaussians.
    """

    capture: Capture
    folder: Path
    gaussians_file: Path
    gaussians: Gaussians
    rest: RestViews | None
    longest: int
    scale: float = 1.0

    @classmethod
    def of(cls, capture: Capture, folder: Path, gaussians: Path, longest: int, scale: float) -> VideoRun:
        """gaussians: their file, `scale` metres per unit of it. Raises CaptureError for a damaged one."""
        rest = rest_views_of(capture) if capture.views is not None else None
        return cls(capture, folder, gaussians, read_gaussians(gaussians, scale), rest, longest, scale)

    def recordings(self) -> list[Recording]:
        """The sequences that have videos. Raises CaptureError where none has."""
        found = [r for r in self.capture.sequences if r.views is not None]
        if not found:
            raise fault(str(self.capture.folder / "capture.json"), "has no sequence with views", "video")
        return found

    @property
    def files(self) -> StageFolder:
        """Where the stages stand."""
        return StageFolder.of(self.folder)

    def views(self, recording: Recording) -> SequenceViews:
        """The videos of a sequence."""
        return sequence_views_of(recording, self.rest)

    def read(self, views: SequenceViews, frame: int) -> list[Photograph]:
        """The pictures of all cameras in one frame, no larger than `longest`."""
        return [photograph.within(self.longest) for photograph in views.read(frame)]

    def stage(self, file: Path, recording: Recording, made_of: Mapping[str, object]) -> Stage:
        """The stage of a sequence that leaves `file`, made of the Gaussians, the videos and `made_of`."""
        sources = {"gaussians": digest_of(self.gaussians_file, self.scale), "longest": self.longest}
        if recording.views is not None:
            sources["views"] = digest_of(recording.views, recording.views_scale)
        return Stage.of(file, {**sources, **made_of})


def register_stage(
    run: VideoRun, recording: Recording, *, rule: TrackingRule
) -> tuple[Registered, Registration | None]:
    """The object in frame 0, and how it was found; None for the latter where the stage was there.

    Raises CaptureError where a camera's pose is wrong, or the pictures are not of the object.
    """
    path = run.files.pose(recording.name)
    stage = run.stage(path, recording, {"rule": asdict(rule)})
    if stage.state() != "missing":
        return read_registered(path, gaussians=run.gaussians.count), None
    views = run.views(recording)
    rest_cameras = {}
    if run.rest is not None:
        at_rest = [photograph.within(run.longest) for photograph in run.rest.read()]
        where = f'sequence "{recording.name}"'
        check_first_frame(at_rest, views.read(0), views.correspondences, where=where)
        rest_cameras = {name: view.camera for name, view in run.rest.views.items()}
    with named(recording):
        found = register(
            run.gaussians,
            run.read(views, 0),
            views.correspondences,
            rest_cameras=rest_cameras,
            first_cameras={name: views.views[name, 0].camera for name in views.cameras},
            rule=rule,
        )
    check_cameras(run.gaussians, found.refined, run.read(views, 0), where=f'sequence "{recording.name}"')
    arrays = {
        "quaternion": quaternion_from_matrix(found.motion.rotation),
        "position": found.motion.shift,
        "refined": found.refined,
    }
    stage.write(arrays)
    return Registered(**arrays), found


def track_stage(
    run: VideoRun, recording: Recording, *, rule: TrackingRule, count: int, report: Report
) -> tuple[Tracks, Followed | None]:
    """Tracks of a sequence, and what they were made from; None for the latter where the stage was there.

    count: most tracks. Makes the registration where it is missing. A run that was broken off goes on.
    """
    path = run.files.tracks(recording.name)
    stage = run.stage(path, recording, {"rule": asdict(rule), "tracks": count})
    if stage.state() != "own":
        report(0.0, f"{recording.name}: registering")
        registered, _ = register_stage(run, recording, rule=rule)
        stage = stage.also(pose=digest_of(run.files.pose(recording.name)))
    if stage.state() != "missing":
        return read_tracks(path, frames=recording.frames), None
    views = run.views(recording)
    aligner = aligner_of(run.gaussians, rule)
    first = aligner.graph.pose_of(registered.refined)
    aligner = aligner.matched(run.read(views, 0), first)

    def read(frame: int) -> list[Photograph]:
        return run.read(views, frame)

    def keep(followed: Followed) -> None:
        if followed.frames % _KEPT_EVERY == 0 or followed.frames == recording.frames:
            stage.begun.write(vars(followed))
            share = _FOLLOWING * followed.frames / recording.frames
            report(share, f"{recording.name}: frame {followed.frames} of {recording.frames}")

    nodes, compared = len(aligner.graph.nodes), len(aligner.chosen)
    shapes = {
        "position": (None, nodes, 3), "rotation": (None, nodes, 3, 3), "cameras": (None, compared),
        "difference": (None,),
    }  # fmt: skip
    begun = stage.begun
    kept = read_arrays(begun.path(path.name), shapes) if begun.complete(*begun.made_of) else None
    followed = follow(
        aligner,
        read,
        recording.frames,
        first,
        rule=rule,
        done=None if kept is None else Followed(**kept),
        report=keep,
    )
    with named(recording):
        chosen = chosen_gaussians(aligner, followed, count)
    frames = np.unique(
        np.linspace(min(1, recording.frames - 1), recording.frames - 1, JACKKNIFED).astype(int)
    )

    def say(done: int) -> None:
        share = _FOLLOWING + (1 - _FOLLOWING) * done / len(frames)
        report(share, f"{recording.name}: leaving cameras out, {done} of {len(frames)} frames")

    variance = variance_of_tracks(aligner, read, followed, chosen, frames=frames.tolist(), report=say)
    tracks = tracks_of(aligner, followed, chosen, variance)
    stage.write(tracks.arrays())
    stage.begun.forget()
    # as written, in single precision: what follows has the same numbers whether broken off here or not
    return read_tracks(path, frames=recording.frames), followed


def contact_stage(
    run: VideoRun,
    recording: Recording,
    *,
    rule: TrackingRule,
    count: int,
    radius: float | None,
    estimate: bool,
    report: Report,
) -> tuple[Hold, Source, Grip | None]:
    """The motion of what is held, where it comes from, and how it was found.

    radius: of what is held [m], None to find it; estimate: also where the capture gives a hold with poses.
    Raises CaptureError where nothing says where the object is held.
    """
    path = run.files.hold(recording.name)
    stage = run.stage(path, recording, {})
    if stage.state() == "own":
        return read_stage_hold(path, frames=recording.frames), "own", None
    given = [] if estimate else [hold for hold in recording.held if not hold.is_fixed]
    if given:
        hold = given[0]
        arrays = {"position": hold.position, "quaternion": hold.quaternion, "box": hold.box}
        stage.also(capture="hold").write(arrays)
        return hold, "capture", None
    views = run.views(recording)
    if not views.contact:
        raise fault(
            f'sequence "{recording.name}"',
            "says not where the object is held",
            "a hold with poses in capture.json, or contact.json beside the videos",
        )
    tracks, _ = track_stage(run, recording, rule=rule, count=count, report=report)
    stage = stage.also(tracks=digest_of(run.files.tracks(recording.name)), radius=radius)
    if stage.state() != "missing":
        return read_stage_hold(path, frames=recording.frames), "made", None
    cameras = {name: views.views[name, 0].camera for name in views.cameras}
    with named(recording):
        coarse = coarse_contact(cameras, views.contact, recording.frames)
        grip = find_grip(tracks.rest, tracks.position, coarse, radius=radius)
    arrays = {"position": grip.motion.position, "quaternion": grip.motion.quaternion, "box": grip.box}
    stage.write(arrays)
    return Hold(**arrays), "new", grip


@contextmanager
def named(recording: Recording) -> Iterator[None]:
    """Names the sequence in what is wrong with its points, tracks and pixels."""
    try:
        yield
    except np.linalg.LinAlgError:  # a ValueError that no input explains
        raise
    except ValueError as error:
        raise CaptureError(f'sequence "{recording.name}": {error}') from error

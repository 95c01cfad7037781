"""An image capture put together from the files of its stages: what is in it, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mphygs.capture.actuators import Force, Pressure, Tendon
from mphygs.capture.format import Capture, CaptureError, Hold, Known, Sequence
from mphygs.capture.holds import Load
from mphygs.capture.meshes import write_mesh
from mphygs.capture.rotation import matrix_from_quaternion, quaternion_from_rotation_vector
from mphygs.capture.stages import StageFolder
from mphygs.compare.noise import observe
from mphygs.fit.grouping_prior import LIKE_STD, alikeness, with_grouping
from mphygs.fit.image_capture import as_one_part, assembled_capture, placement_of
from mphygs.fit.run import capture_digest
from mphygs.fit.stage_particles import particles_of
from mphygs.fit.start import starting_belief
from mphygs.motion.control_graph import farthest_first
from mphygs.scene.soft_boundary import Particles
from mphygs.simulate.body import Attachment

FRAMES = 40
SIGMA = 3e-4
TURN = quaternion_from_rotation_vector(np.array([0.0, 0.0, 0.4]))
SHIFT = np.array([0.02, -0.01, 0.005])


def recorded() -> Capture:
    """A bar held at one end, in a frame in which it begins turned and shifted."""
    quaternion = np.tile(TURN, (FRAMES, 1))
    position = SHIFT + np.linspace(0, 0.01, FRAMES)[:, None] * [0, 0, 1.0]
    hold = Hold(np.array([[-0.001, -1, -1], [0.012, 1, 1]]), position, quaternion)
    sequence = Sequence("lift", 50.0, FRAMES, (0, 20), (20, FRAMES), (hold,), views=Path("views"))
    gravity = np.array([0.0, 0, -9.81])
    known = Known(poissons_ratio=0.4, mass=0.01)
    return Capture(
        "bar", Path("."), gravity, (), "equilibrium", known, (sequence,), views=Path("rest")
    )  # fmt: skip


def written(folder: Path, memory: float = 0.9) -> tuple[Path, np.ndarray]:
    """Stage files of two boxes and of tracks that are carried rigidly, with errors that last."""
    files = StageFolder(folder)
    files.parts.mkdir(parents=True)
    for number in range(2):
        bounds = np.array([[0.02 * number, 0, 0], [0.02 * (number + 1), 0.01, 0.01]])
        box = trimesh.creation.box(bounds=bounds)
        write_mesh(files.parts / f"segment-{number:02d}.ply", np.array(box.vertices), np.array(box.faces))
    rng = np.random.default_rng(3)
    rest = rng.uniform([0, 0, 0], [0.04, 0.01, 0.01], (600, 3))
    label = (rest[:, 0] > 0.02).astype(np.int32)
    np.savez(
        files.particles, position=rest, label=label, signed_distance=np.where(label, -5e-3, -5e-4),
        spacing=np.array(1e-3),
        appearance=np.eye(2)[label],
    )  # fmt: skip
    errors = np.zeros((FRAMES, 600, 3))
    errors[0] = rng.standard_normal((600, 3))
    for frame in range(1, FRAMES):
        errors[frame] = memory * errors[frame - 1] + np.sqrt(1 - memory**2) * rng.standard_normal((600, 3))
    hold = recorded().sequences[0].held[0]
    moved = rest @ matrix_from_quaternion(TURN).T + hold.position[:, None] + SIGMA * errors
    moved[5, 10] = np.nan
    moved[:30, 11] = np.nan
    files.tracks("lift").parent.mkdir(parents=True)
    np.savez(files.tracks("lift"), rest=rest, position=moved, sigma=np.array(SIGMA))
    return folder, rest


def test_parts_tracks_and_holds_are_told_in_the_frame_of_the_object(tmp_path: Path) -> None:
    folder, rest = written(tmp_path / "stages")
    capture = recorded()
    whole = assembled_capture(capture, folder)
    assert [part.name for part in whole.parts] == ["segment-00", "segment-01"]
    assert [part.shape for part in whole.parts] == ["solid", "solid"]
    told = assembled_capture(replace(capture, found_as="auto"), folder)
    assert [part.shape for part in told.parts] == ["auto", "auto"]
    # particles that do not say what they were found in show as much as their spacing
    path = StageFolder(folder).particles
    thin, thick = (whole.parts[k].boundary for k in range(2))
    assert (thin, thick) == pytest.approx((5e-4, 1.5e-4))
    assert as_one_part(whole).parts[0].boundary == thin
    np.savez(path, **dict(np.load(path)), pixel=np.array(1e-5))
    found = [part.boundary for part in assembled_capture(capture, folder).parts]
    assert found == pytest.approx([1.5e-6, 1.5e-6])
    sequence = whole.sequences[0]
    assert sequence.turn == pytest.approx(matrix_from_quaternion(TURN))
    rotation, position = sequence.held[0].poses(np.array([0.0]), 50.0)
    assert np.abs(rotation - np.eye(3)).max() < 1e-12 and np.abs(position).max() < 1e-12
    placement = placement_of(capture.sequences[0], folder)
    markers = sequence.markers
    assert 100 < len(markers.at) <= 250 and not (markers.at == rest[11]).all(1).any()
    assert np.nanmax(np.abs(markers.position[0] - markers.at)) < 6 * SIGMA
    raw = np.load(StageFolder(folder).tracks("lift"))["position"]
    index = [int(np.flatnonzero((rest == at).all(1))[0]) for at in markers.at]
    assert np.nanmax(np.abs(placement.to_world(markers.position) - raw[:, index])) < 1e-12
    assert capture_digest(assembled_capture(capture, folder)) == capture_digest(whole)
    assert capture_digest(assembled_capture(capture, folder, tracked=False)) != capture_digest(whole)


def test_what_pulls_along_the_worlds_axes_turns_with_the_frame(tmp_path: Path) -> None:
    folder, _ = written(tmp_path / "stages")
    capture, box = recorded(), np.array([[-1.0] * 3, [1.0] * 3])
    force, anchor = np.array([0.1, -0.2, 0.3]), np.array([0.3, 0.1, -0.2])
    load = Load(box, force, 0)
    pulls = Force(np.tile(force, (FRAMES, 1)), "push", box=box)
    tendon = Tendon(np.ones(FRAMES), "pull", path=np.zeros((2, 3)), anchor=anchor)
    pressure = Pressure(np.ones(FRAMES), "blow", box=box)
    acts = {"loads": (load,), "actuators": (pulls, tendon, pressure)}
    before = replace(capture, sequences=(replace(capture.sequences[0], **acts),))
    sequence = assembled_capture(before, folder).sequences[0]
    placement = placement_of(capture.sequences[0], folder)
    turned = placement.rotation.T @ force
    assert not np.allclose(turned, force)
    assert sequence.loads[0].force == pytest.approx(turned)
    assert sequence.actuators[0].values == pytest.approx(np.tile(turned, (FRAMES, 1)))
    assert placement.to_world(sequence.actuators[1].anchor) == pytest.approx(anchor)
    assert sequence.actuators[1].values is tendon.values and sequence.actuators[2] is pressure


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_tracks_on_what_is_held_tell_how_long_errors_last(tmp_path: Path, memory: float) -> None:
    folder, _ = written(tmp_path / "stages", memory)
    sequence = assembled_capture(recorded(), folder).sequences[0]
    markers = sequence.markers
    assert markers.memory * markers.lasting == pytest.approx(memory, abs=0.1)
    count = len(sequence.markers.at)
    free = Attachment(sequence.markers.at, np.zeros((count, 3)), np.zeros((count, 3), int),
                      np.full(count, -1), np.zeros(count, int))  # fmt: skip
    observation = observe(sequence, free)
    assert observation.sigma == pytest.approx(SIGMA, rel=0.15)
    rotation, position = sequence.held[0].poses(np.arange(FRAMES) / 50.0, 50.0)
    errors = sequence.markers.position - sequence.markers.at @ rotation.swapaxes(1, 2) - position[:, None]
    white = observation.whitener(0, FRAMES).whiten(np.nan_to_num(errors))
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.2)


def test_tracks_worse_than_they_say_are_trusted_less(tmp_path: Path) -> None:
    folder, rest = written(tmp_path / "stages")
    path = StageFolder(folder).tracks("lift")
    arrays = dict(np.load(path))
    np.savez(path, **arrays | {"sigma": np.array(SIGMA / 4)})
    assert assembled_capture(recorded(), folder).sequences[0].markers.sigma == pytest.approx(SIGMA, rel=0.2)


def test_farthest_first_covers() -> None:
    points = np.random.default_rng(0).uniform(size=(500, 3))
    chosen = farthest_first(points, 60, from_middle=True)
    assert len(set(chosen)) == 60
    gaps = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(1)
    assert gaps.max() < 0.3


def test_one_part_has_all_the_material(tmp_path: Path) -> None:
    folder, _ = written(tmp_path / "stages")
    whole = assembled_capture(recorded(), folder)
    one = as_one_part(whole)
    assert one.parts[0].volume == pytest.approx(sum(part.volume for part in whole.parts))
    assert one.known.mass == whole.known.mass and len(one.parts) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: np.savez(f.tracks("lift"), rest=np.zeros((4, 3)), position=np.zeros((9, 4, 3)),
                            sigma=np.array(1e-3)), r"tracks\.npz: position: has 9 frames; expected 40"),
        (lambda f: np.savez(f.tracks("lift"), rest=np.zeros((4, 3)), sigma=np.array(1e-3)),
         r'tracks\.npz: array "position" is missing'),
        (lambda f: np.savez(f.tracks("lift"), rest=np.zeros((4, 3)), position=np.zeros((40, 4, 3)),
                            sigma=np.array(0.0)), r"tracks\.npz: sigma"),
        (lambda f: f.tracks("lift").write_bytes(b"PK no"), r"tracks\.npz: is not an .npz"),
        (lambda f: (f.parts / "segment-01.ply").write_bytes(b"ply"), r"segment-01\.ply"),
        (lambda f: [p.unlink() for p in f.parts.glob("*.ply")], r"holds no \.ply"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_used_is_named(tmp_path: Path, change, words: str) -> None:
    folder, _ = written(tmp_path / "stages")
    change(StageFolder(folder))
    with pytest.raises(CaptureError, match=words) as caught:
        assembled_capture(recorded(), folder)
    assert "\n" not in str(caught.value)


def test_particles_of_a_segment_without_a_mesh_are_refused(tmp_path: Path) -> None:
    folder, _ = written(tmp_path / "stages")
    with pytest.raises(CaptureError, match="label: names 2 segments; expected at most 1"):
        particles_of(folder, 1)


def test_a_hold_that_was_found_serves_where_none_is_given(tmp_path: Path) -> None:
    folder, _ = written(tmp_path / "stages")
    capture = recorded()
    hold = capture.sequences[0].held[0]
    path = StageFolder(folder).hold("lift")
    path.parent.mkdir(parents=True)
    np.savez(path, position=hold.position, quaternion=hold.quaternion, box=hold.box)
    bare = replace(capture, sequences=(replace(capture.sequences[0], held=()),))
    bare_digest, digest = (capture_digest(assembled_capture(one, folder)) for one in (bare, capture))
    assert bare_digest == digest


def test_segments_that_look_alike_are_held_together_and_others_are_not() -> None:
    rng = np.random.default_rng(0)
    label = np.repeat([0, 1, 2], 200)
    look = np.array([[1.0, 0], [1.0, 0], [0, 1.0]])[label] + 1e-3 * rng.standard_normal((600, 2))
    particles = Particles(rng.uniform(size=(600, 3)), np.full(600, -1e-3), 1e-3, label, look)
    alike = alikeness(particles, 3)
    assert alike[0, 1] == pytest.approx(0.5, abs=0.1) and alike[0, 2] < 1e-6
    capture = Capture("x", Path("."), np.zeros(3), (), "stress-free", Known(), ())
    boxes = [trimesh.creation.box(bounds=np.array([[k, 0, 0], [k + 1.0, 1, 1]])) for k in range(3)]
    from mphygs.capture.meshes import Part

    parts = tuple(Part(f"s{k}", np.array(b.vertices), np.array(b.faces)) for k, b in enumerate(boxes))
    belief = starting_belief(replace(capture, parts=parts))
    grouped = with_grouping(belief, belief.parts, particles)
    pairs = [x for x in grouped.likenesses if len(x.keys) == 2 and x.keys[0].endswith("modulus")]
    assert [x.keys for x in pairs] == [("s0.youngs_modulus", "s1.youngs_modulus")]
    assert pairs[0].std == pytest.approx(LIKE_STD, rel=0.1)
    # a quadratic form whose derivative is that of differences
    apart = grouped.with_parameter("s0.youngs_modulus", value=3e5).with_parameter("s2.density", value=500.0)
    residual, slope = apart.likeness_rows()
    step = 1e-6
    for k in range(len(apart.free)):
        moved = apart.coordinates
        moved[k] += step
        difference = (apart.at(moved).likeness_rows()[0] - residual) / step
        assert np.abs(difference - slope[:, k]).max() < 1e-5 * max(np.abs(slope[:, k]).max(), 1.0)
    assert np.abs(residual).max() > 1.0
    assert np.abs(belief.likeness_rows()[1]).size == 0

"""What is expected of control points, and how pictures pull at them: closed forms and differences."""

from dataclasses import replace

import numpy as np
import pytest

import rod_video
from mphygs.capture.rotation import matrix_from_rotation_vector
from mphygs.motion.alignment import combined_sights, projection_jacobian
from mphygs.motion.control_graph import ControlGraph, Pose, control_graph
from mphygs.motion.sight import Sight
from mphygs.motion.stiffness import Stiffness, disagreements, turn_and_shift

TURN = matrix_from_rotation_vector(np.array([0.5, -1.1, 0.8]))
SHIFT = np.array([0.03, -0.02, 0.4])


@pytest.fixture(scope="module")
def graph() -> ControlGraph:
    return control_graph(np.random.default_rng(0).uniform(0, 0.1, (200, 3)), count=9)


def wobbled(graph: ControlGraph, size: float, seed: int) -> Pose:
    draw = np.random.default_rng(seed).standard_normal((len(graph.nodes), 6))
    return graph.rest.turned(TURN, SHIFT).moved(size * draw * [1, 1, 1, 0.1, 0.1, 0.1])


def residuals(graph: ControlGraph, pose: Pose, expected: Pose) -> list[np.ndarray]:
    return [residual for _, residual in disagreements(graph, pose, expected, Stiffness())]


def test_a_rigid_motion_as_expected_costs_nothing(graph: ControlGraph) -> None:
    pose = graph.rest.turned(TURN, SHIFT)
    for residual in residuals(graph, pose, pose):
        assert np.abs(residual).max() < 1e-9


def test_another_rigid_motion_than_expected_costs_its_place_alone(graph: ControlGraph) -> None:
    expected = graph.rest.turned(TURN, SHIFT)
    pose = Pose(expected.position + [0.01, 0.0, 0.0], expected.rotation)
    *others, place = residuals(graph, pose, expected)
    assert max(np.abs(residual).max() for residual in others) < 1e-9
    share = 0.01 / (Stiffness().place * graph.spacing)
    assert place.reshape(-1, 6) == pytest.approx(np.tile([0, 0, 0, share, 0, 0], (9, 1)), abs=1e-12)


def test_one_node_pulled_off_costs_its_edges(graph: ControlGraph) -> None:
    rest = graph.rest
    position = rest.position.copy()
    position[2] += [0.0, 0.004, 0.0]
    rigid, similar, step, bend, _ = residuals(graph, Pose(position, rest.rotation), rest)
    touched = (graph.edges == 2).sum(axis=1)
    for residual, sigma in ((rigid, Stiffness().rigidity), (step, Stiffness().step)):
        length = np.linalg.norm(residual.reshape(-1, 3), axis=1)
        assert length == pytest.approx(touched * 0.004 / (sigma * graph.spacing), abs=1e-12)
    assert np.abs(similar).max() == 0.0 and np.abs(bend).max() == 0.0


def test_one_node_turned_costs_the_turn_times_the_distance(graph: ControlGraph) -> None:
    step = np.zeros((9, 6))
    step[3, 2] = 0.1
    _, similar, _, _, _ = residuals(graph, graph.rest.moved(step), graph.rest)
    first, second = graph.edges.T
    length = np.linalg.norm(graph.nodes[first] - graph.nodes[second], axis=1)
    sign = (second == 3).astype(float) - (first == 3)
    found = similar.reshape(-1, 3)
    assert found[:, 2] == pytest.approx(sign * 0.1 * length / (Stiffness().similarity * graph.spacing))
    assert np.abs(found[:, :2]).max() < 1e-12


@pytest.mark.parametrize("which", range(5), ids=["rigid", "similar", "step", "bend", "place"])
def test_jacobians_are_those_of_the_residuals(graph: ControlGraph, which: int) -> None:
    """At poses near the expected one, where the turns' Jacobians are exact."""
    expected = wobbled(graph, 1e-3, 1)
    # edges against rest are exact anywhere; turns between neighbours only to first order of their difference
    pose = expected.moved(np.zeros((9, 6)))
    rows = disagreements(graph, pose, expected, Stiffness())[which][0].toarray()
    size = 1e-6
    numeric = np.zeros_like(rows)
    for column in range(rows.shape[1]):
        step = np.zeros(rows.shape[1])
        step[column] = size
        ends = [
            residuals(graph, pose.moved(sign * step.reshape(-1, 6)), expected)[which] for sign in (1, -1)
        ]
        numeric[:, column] = (ends[0] - ends[1]) / (2 * size)
    # rows are the derivative of the residual with the sign of the shift that takes it to zero
    assert rows == pytest.approx(numeric, abs=5e-3 * np.abs(numeric).max())


def test_arms_turn_and_shift() -> None:
    arms = np.array([[0.1, -0.2, 0.3], [0.0, 0.05, 0.0]])
    step = np.array([1e-7, -2e-7, 3e-7, 1e-7, 2e-7, -1e-7])
    moved = arms @ matrix_from_rotation_vector(step[:3]).T + step[3:] - arms
    assert turn_and_shift(arms) @ step == pytest.approx(moved, abs=1e-13)


@pytest.mark.parametrize("name", ["rigidity", "similarity", "step", "place"])
def test_every_stiffness_is_above_zero(name: str) -> None:
    with pytest.raises(ValueError, match="expected every number above zero"):
        replace(Stiffness(), **{name: 0.0})


def test_pixels_by_points() -> None:
    camera = rod_video.cameras(3)[1]
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (5, 3)) + [0.05, 0, 0]
    jacobian = projection_jacobian(camera, points)
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        numeric = (camera.project(points + step)[0] - camera.project(points - step)[0]) / 2e-6
        assert jacobian[:, :, axis] == pytest.approx(numeric, rel=1e-6, abs=1e-4)


def test_two_cameras_lift_displacements_to_space() -> None:
    """Where each camera says by how many pixels a point is off, the least squares step is the true one."""
    seen_by = rod_video.cameras(3)
    points = np.random.default_rng(0).uniform(-0.03, 0.03, (6, 3)) + [0.05, 0, 0]
    step = 1e-5 * np.random.default_rng(1).standard_normal((6, 3))
    sights = []
    for camera in seen_by:
        pixels = camera.project(points + step)[0] - camera.project(points)[0]
        information = np.tile(np.diag([4.0, 2.0]), (6, 1, 1))
        pull = np.einsum("nij,nj->ni", information, pixels)
        sights.append(Sight(camera, np.ones(6, bool), np.ones(6), information, pull, 0.0))
    information, pull = combined_sights(points, sights)
    assert np.linalg.solve(information, pull[..., None])[..., 0] == pytest.approx(step, abs=1e-8)
    one, _ = combined_sights(points, sights[:1])
    assert np.linalg.matrix_rank(one, tol=1e-3 * np.abs(one).max()).tolist() == [2] * 6, "no depth from one"

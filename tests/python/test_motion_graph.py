"""Control points that carry Gaussians: rigid motions exactly, pieces that only come close on their own."""

import numpy as np
import pytest

from mphygs.capture.rotation import (
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    quaternion_from_matrix,
)
from mphygs.motion.control_graph import CARRIERS, Pose, control_graph, farthest_first

TURN = matrix_from_rotation_vector(np.array([0.5, -1.1, 0.8]))
SHIFT = np.array([0.03, -0.02, 0.4])


def plate(count: int = 20) -> np.ndarray:
    """Points of a bent plate, 10 x 4 cm."""
    u, v = np.meshgrid(np.linspace(0, 0.1, count), np.linspace(0, 0.04, count // 2), indexing="ij")
    return np.stack([u, v, 0.3 * u**2 / 0.1 + 0.1 * v**2 / 0.1], axis=-1).reshape(-1, 3)


def test_the_graph_binds_every_point() -> None:
    points = plate()
    graph = control_graph(points, count=16)
    assert graph.carriers.shape == graph.weights.shape == (len(points), CARRIERS)
    assert graph.weights.sum(axis=1) == pytest.approx(1.0) and graph.weights.min() > 0
    assert (np.diff(graph.weights, axis=1) <= 1e-12).all(), "the heaviest first"
    assert all(len(set(row)) == CARRIERS for row in graph.carriers.tolist())
    # a node sits on a point, which follows it above all
    nearest = np.linalg.norm(points[:, None] - graph.nodes, axis=2).argmin(axis=0)
    assert np.array_equal(graph.carriers[nearest, 0], np.arange(16))
    pairs = set(map(tuple, graph.edges.tolist()))
    assert len(pairs) == len(graph.edges) and pairs == {(b, a) for a, b in pairs}
    lengths = [np.linalg.norm(graph.nodes[a] - graph.nodes[b]) for a, b in pairs]
    assert graph.spacing == pytest.approx(np.mean(lengths))


def test_nothing_moved_is_rest() -> None:
    graph = control_graph(plate(), count=16)
    assert graph.carried(graph.rest) == pytest.approx(graph.points, abs=1e-15)
    assert graph.turns(graph.rest) == pytest.approx(np.tile([1.0, 0, 0, 0], (len(graph.points), 1)))


def test_a_rigid_motion_of_the_nodes_is_one_of_the_points() -> None:
    graph = control_graph(plate(), count=16)
    pose = graph.rest.turned(TURN, SHIFT)
    assert graph.carried(pose) == pytest.approx(graph.points @ TURN.T + SHIFT, abs=1e-14)
    chosen = np.array([3, 17, 60])
    assert graph.carried(pose, chosen) == pytest.approx(graph.carried(pose)[chosen], abs=1e-15)
    assert matrix_from_quaternion(graph.turns(pose)) == pytest.approx(
        np.tile(TURN, (len(graph.points), 1, 1)), abs=1e-12
    )


def test_a_small_step_turns_about_the_node() -> None:
    graph = control_graph(plate(), count=16)
    step = np.zeros((16, 6))
    step[4] = [0.0, 0.0, 0.2, 1e-3, 0.0, 0.0]
    pose = graph.rest.turned(TURN, SHIFT).moved(step)
    turn = matrix_from_rotation_vector(np.array([0.0, 0.0, 0.2]))  # in world axes: after TURN
    assert pose.rotation[4] == pytest.approx(turn @ TURN, abs=1e-13)
    assert pose.position[4] == pytest.approx(TURN @ graph.nodes[4] + SHIFT + [1e-3, 0, 0], abs=1e-13)
    assert pose.rotation[5] == pytest.approx(TURN, abs=1e-13)
    moved = np.linalg.norm(graph.carried(pose) - (graph.points @ TURN.T + SHIFT), axis=1)
    follows = (graph.carriers == 4).any(axis=1)
    assert (moved[~follows] < 1e-15).all() and (moved[follows] > 0).all()


def test_places_give_back_the_pose() -> None:
    graph = control_graph(plate(), count=16)
    pose = graph.pose_of(graph.points @ TURN.T + SHIFT)
    assert pose.position == pytest.approx(graph.nodes @ TURN.T + SHIFT, abs=1e-12)
    assert pose.rotation == pytest.approx(np.tile(TURN, (16, 1, 1)), abs=1e-9)


def test_places_of_a_bent_object_are_nearly_kept() -> None:
    graph = control_graph(plate(), count=24)
    x, y, z = graph.points.T
    curvature = 8.0
    bent = np.stack(
        [np.sin(curvature * x) * (1 / curvature - z), y, (1 - np.cos(curvature * x)) / curvature
         + z * np.cos(curvature * x)], axis=1
    )  # fmt: skip
    carried = graph.carried(graph.pose_of(bent))
    assert np.linalg.norm(bent - graph.points, axis=1).max() > 0.03
    assert np.linalg.norm(carried - bent, axis=1).max() < 2e-3
    assert np.linalg.det(graph.pose_of(bent).rotation) == pytest.approx(1.0)


def test_turns_of_both_signs_are_one_rotation() -> None:
    """Turns by nearly a half circle have quaternions of either sign: their mean must not vanish."""
    graph = control_graph(plate(), count=16)
    spread = np.random.default_rng(0).normal(0.0, 0.02, (16, 3)) + [0.0, 0.0, np.pi]
    rotation = matrix_from_rotation_vector(spread)
    w = quaternion_from_matrix(rotation)
    assert (w @ w[0] < 0).any(), "some are of the other sign"
    half = matrix_from_rotation_vector(np.array([0.0, 0.0, np.pi]))
    turns = matrix_from_quaternion(graph.turns(Pose(graph.nodes, rotation)))
    assert np.abs(turns - half).max() < 0.15


def test_sheets_that_only_come_close_move_on_their_own() -> None:
    """Two strips joined at one end, 3 mm apart while their points are 2 mm apart."""
    u, v = np.meshgrid(np.linspace(0, 0.1, 51), np.linspace(0, 0.01, 6), indexing="ij")
    lower = np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], axis=1)
    upper = lower + [0.0, 0.0, 0.007]
    height = np.arange(1, 4) * 0.007 / 4
    joint = np.array([[0.0, y, z] for y in np.linspace(0, 0.01, 6) for z in height])
    graph = control_graph(np.concatenate([lower, upper, joint]), count=24)
    above = graph.nodes[:, 2] > 0.0035
    far = graph.points[:, 0] > 0.03
    share_of_above = (graph.weights * above[graph.carriers]).sum(axis=1)
    assert share_of_above[: len(lower)][far[: len(lower)]].max() < 1e-3
    assert share_of_above[len(lower) : 2 * len(lower)][far[len(lower) : 2 * len(lower)]].min() > 1 - 1e-3


def test_pieces_that_hang_together_nowhere_are_still_bound() -> None:
    points = np.concatenate([plate(), plate() + [0.0, 0.5, 0.0]])
    graph = control_graph(points, count=20)
    half = len(points) // 2
    own = graph.nodes[graph.carriers][:, :, 1] > 0.25
    assert not own[:half].any() and own[half:].all()


def test_seeds_alone_become_control_points() -> None:
    points = plate()
    seeds = points[:, 0] < 0.05
    graph = control_graph(points, count=8, seeds=seeds)
    assert graph.nodes[:, 0].max() < 0.05 and graph.weights.sum(axis=1) == pytest.approx(1.0)


def test_farthest_first_spreads() -> None:
    line = np.linspace(0, 1, 101)[:, None] * [1.0, 0.0, 0.0]
    assert sorted(line[farthest_first(line, 5), 0].tolist()) == pytest.approx([0, 0.25, 0.5, 0.75, 1.0])


@pytest.mark.parametrize(("count", "points"), [(4, 100), (30, 20)])
def test_too_few_are_refused(count: int, points: int) -> None:
    with pytest.raises(ValueError, match=f"{count} control points on {points} Gaussians; expected more than"):
        control_graph(np.random.default_rng(0).uniform(size=(points, 3)), count=count)

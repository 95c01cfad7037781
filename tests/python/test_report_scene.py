"""What the page's scene is made of: the skin, who paints it, motions as modes within a budget."""

import base64

import numpy as np
import pytest
import trimesh

from mphygs.capture.format import Part
from mphygs.report.motion_data import LARGEST, MISSING, modes_of, motion_document, quantise
from mphygs.report.skin import nearest_markers, skin_of
from thin_meshes import sheet_mesh

# Low and high of what is packed [m].
BOX = (np.full(3, -0.15), np.full(3, 0.15))


def box(name: str, low: float, high: float) -> Part:
    mesh = trimesh.creation.box(bounds=np.array([[low, 0, 0], [high, 0.01, 0.01]]))
    return Part(name, np.array(mesh.vertices), np.array(mesh.faces))


def restored(document: dict, frames: int) -> np.ndarray:
    """(T, N, 3) of what `modes_of` made."""
    whole = np.frombuffer(base64.b64decode(document["mean"]), "<i2").reshape(-1, 3)
    mean = ((whole + float(LARGEST)) / (2 * LARGEST) * (BOX[1] - BOX[0]) + BOX[0]).ravel()
    modes = np.frombuffer(base64.b64decode(document["modes"]), "<i2").reshape(document["count"], -1)
    amplitudes = np.frombuffer(base64.b64decode(document["amplitudes"]), "<f4").reshape(frames, -1)
    return (mean + amplitudes @ modes).reshape(frames, -1, 3)


def test_skin_is_fine_enough_to_bend_and_keeps_the_shape() -> None:
    parts = (box("a", 0.0, 0.04), box("b", 0.04, 0.1))
    skin = skin_of(parts, 1000)
    assert 400 < len(skin.points) < 2200 and set(skin.part) == {0, 1}
    assert skin.faces.max() == len(skin.points) - 1
    for index, part in enumerate(parts):
        own = skin.faces[(skin.part[skin.faces] == index).all(1)]
        assert trimesh.Trimesh(skin.points, own, process=False).volume == pytest.approx(part.volume)
    ball = trimesh.creation.icosphere(5, 0.02)
    coarse = skin_of((Part("ball", np.array(ball.vertices), np.array(ball.faces)),), 800)
    assert 300 < len(coarse.points) <= 800
    volume = trimesh.Trimesh(coarse.points, coarse.faces, process=False).volume
    assert volume == pytest.approx(ball.volume, rel=0.05)


def test_the_skin_of_a_sheet_keeps_both_of_its_faces() -> None:
    """Put together across its thickness it would be one layer, of triangles that face either way."""
    u, w = np.meshgrid(np.linspace(0, 0.05, 160), np.linspace(-0.015, 0.015, 100), indexing="ij")
    sheet = Part("sheet", *sheet_mesh(np.stack([u, w, 10.0 * u**2 + 5.0 * w**2], axis=2), 3e-4))
    skin = skin_of((sheet,), 1500)
    assert 500 < len(skin.points) <= 1500
    mesh = trimesh.Trimesh(skin.points, skin.faces, process=False)
    assert mesh.area == pytest.approx(sheet.area, rel=0.03)
    up = mesh.area_faces[mesh.face_normals[:, 2] > 0.5].sum()
    down = mesh.area_faces[mesh.face_normals[:, 2] < -0.5].sum()
    assert up == pytest.approx(down, rel=0.02) and mesh.volume == pytest.approx(sheet.volume, rel=0.2)


def test_a_vertex_is_painted_by_markers_of_its_own_part() -> None:
    skin = skin_of((box("a", 0.0, 0.05), box("b", 0.05, 0.1)), 200)
    x = np.linspace(0.002, 0.098, 16)
    at = np.stack([x, np.full(16, 0.005), np.full(16, 0.005)], axis=1)
    owner = (x > 0.05).astype(int)
    near, weight = nearest_markers(skin, at, owner)
    assert np.allclose(weight.sum(1), 1.0) and (owner[near] == skin.part[:, None]).all()
    value = (weight * x[near]).sum(1)
    assert np.abs(value - skin.points[:, 0]).max() < 0.012
    assert nearest_markers(skin, at[:0], owner[:0])[0].shape == (len(skin.points), 0)


def test_modes_give_a_motion_back_to_the_tolerance() -> None:
    times, x = np.linspace(0, 1, 60), np.linspace(0, 0.1, 300)
    motion = np.zeros((60, 300, 3))
    motion[..., 0] = x
    motion[..., 2] = np.sin(20 * times)[:, None] * x**2 + 0.01 * np.cos(33 * times)[:, None] * x
    document = modes_of(motion, BOX, 1e-6, 60)
    assert document["count"] == 2
    assert np.abs(restored(document, 60) - motion).max() < 6e-6
    assert modes_of(motion, BOX, 1e-6, 1)["count"] == 1


def test_positions_survive_packing() -> None:
    values = np.random.default_rng(0).uniform(-0.1, 0.3, (50, 3))
    values[7] = np.nan
    low, high = np.full(3, -0.1), np.full(3, 0.3)
    whole = np.frombuffer(base64.b64decode(quantise(values, low, high)), "<i2").reshape(-1, 3)
    assert (whole[7] == MISSING).all()
    back = (whole + float(LARGEST)) / (2 * LARGEST) * (high - low) + low
    assert np.nanmax(np.abs(np.delete(back - values, 7, axis=0))) < 1e-5


def test_a_measurement_far_from_the_prediction_is_shown_where_it_is() -> None:
    predicted = np.random.default_rng(2).uniform(0.0, 0.1, (6, 5, 3))
    predicted[0, 0], predicted[0, 1] = 0.0, 0.1
    measured = predicted[:, :4].copy()
    measured[3, 1, 2] = 0.18  # a petal that the model holds back
    measured[4, 2, 2] = 50.0  # a bad track
    document = motion_document(
        fps=60.0, measured=measured, models={"a": predicted}, fit=(0, 3), sigma=1e-4
    )
    low, high = np.array(document["low"]), np.array(document["high"])
    whole = np.frombuffer(base64.b64decode(document["measured"]), "<i2").reshape(6, 4, 3)
    back = (whole + float(LARGEST)) / (2 * LARGEST) * (high - low) + low
    assert back[3, 1, 2] == pytest.approx(0.18, abs=1e-5)
    assert back[4, 2, 2] == pytest.approx(high[2], abs=1e-5) and high[2] < 0.21
    errors = np.frombuffer(base64.b64decode(document["models"][0]["errors"]), "<f4").reshape(6, 4)
    assert errors[4, 2] == pytest.approx(50.0 - predicted[4, 2, 2])


def test_motions_are_kept_within_their_budget() -> None:
    generator = np.random.default_rng(1)
    frames, markers, budget = 900, 300, 400_000
    models = {k: generator.normal(size=(frames, markers + 800, 3)) for k in ("before", "after")}
    document = motion_document(
        fps=100.0, measured=generator.normal(size=(frames, markers, 3)), models=models, fit=(0, 9),
        sigma=1e-4, budget=budget,
    )  # fmt: skip
    packed = [document["measured"]]
    packed += [m[key] for m in document["models"] for key in ("errors", "mean", "modes", "amplitudes")]
    assert 0.5 * budget < sum(len(text) for text in packed) * 3 / 4 < 1.1 * budget
    stride = document["frames"][1]
    assert stride > 4 and document["frames"][-1] > frames - 1 - stride
    with pytest.raises(ValueError, match="motion: measured"):
        motion_document(
            fps=1.0, measured=np.zeros((2, 4, 3)), models={"a": np.zeros((2, 3, 3))}, fit=(0, 1), sigma=1.0
        )

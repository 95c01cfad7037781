"""Truth of cables and strips: strains and their forces, closed forms, films, and what is refused."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.sparse import csc_matrix

from mphygs.capture.format import Capture, load_capture
from mphygs.capture.holds import Hold
from mphygs.capture.record import Known
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.rotation import matrix_from_rotation_vector
from mphygs.commands.synth import main
from mphygs.synth.hidden import Hidden
from mphygs.synth.implicit_motion import march
from mphygs.synth.make import make_capture
from mphygs.synth.recipe import Material, Recipe, Take
from mphygs.synth.rod_body import RodBody
from mphygs.synth.rod_net import Line, rod_net
from mphygs.synth.rod_section import regular_polygon
from mphygs.synth.rod_strain import nodal_forces, strains
from mphygs.synth.shape import Shape
from mphygs.synth.shapes import shape
from mphygs.synth.shell_body import ShellBody
from mphygs.synth.shell_grid import ShellGrid
from mphygs.synth.shell_sheet import Sheet
from mphygs.synth.shell_strain import fundamental, local_axes, normal, slope_forces
from mphygs.synth.thin_shapes import strip, tube_mesh
from synth_example import made, small, tracks
from test_thin_parts import BENDING, elastica

RADIUS, LENGTH, DENSITY, GRAVITY = 0.0015, 0.1, 1000.0, 9.81


def straight_rod() -> Shape:
    """Along x from 10 mm in the hold."""
    line = np.array([[-0.01, 0.0, 0.0], [0.0, 0.0, 0.0], [LENGTH, 0.0, 0.0]])
    vertices, faces = tube_mesh(line, RADIUS)
    like = strip()
    part = replace(like.parts[0], name="rod", vertices=vertices, faces=faces, shape="rod")
    return replace(
        like, name="rod", parts=(part,), tip=line[-1], lines=(Line(0, line, regular_polygon(RADIUS, 24)),),
        sheet=None, youngs_modulus={"rod": 1e8}, density={"rod": DENSITY}, simulator="rod",
    )  # fmt: skip


def body_of(
    kind: Shape,
    youngs_modulus: float,
    *,
    size: float = 0.002,
    poissons_ratio: float = 0.0,
    hidden: tuple[Hidden, ...] = (),
    gravity: float = GRAVITY,
) -> RodBody | ShellBody:
    """A thin object of one part under a hold that stays."""
    recording = Recording("a", 100.0, 10, held=(Hold(kind.hold),))
    capture = Capture(
        "thin", Path(), np.array([0.0, 0.0, -gravity]), kind.parts, "stress-free", Known(), (recording,)
    )
    material = Material(youngs_modulus, DENSITY, poissons_ratio)
    recipe = Recipe("thin", kind, {kind.part_names[0]: material}, ())
    make = RodBody if kind.lines else ShellBody
    return make(capture, recording, recipe, hidden, size)


def frequencies(body: RodBody | ShellBody, count: int, step: float = 1.0) -> np.ndarray:
    """The lowest natural frequencies about rest [Hz]; step: that viscosity is counted over [s]."""
    rest = body.at_rest()
    free = np.repeat(~body.held, body.inertia.shape[0] // len(body.held))
    stiffness, mass = (
        csc_matrix(a)[free][:, free].toarray() for a in (body.slope(rest, rest, step), body.inertia)
    )
    stiffness = 0.5 * (stiffness + stiffness.T)
    squared = eigh(stiffness, mass, eigvals_only=True, subset_by_index=(0, count - 1))
    return np.sqrt(squared) / (2.0 * np.pi)


@pytest.mark.parametrize("spacing", [0.004, 0.0015, 0.0012])
def test_a_rod_is_free_from_the_edge_of_its_grip_on(spacing: float) -> None:
    """Also where a vertex of its line lies on that edge."""
    whole = shape("cable")
    boxes = np.array([whole.hold, whole.far_hold])
    net = rod_net(whole.lines, boxes, spacing)
    place = net.nodes[net.element].mean(axis=1)
    within = ((place[:, None] > boxes[:, 0]) & (place[:, None] < boxes[:, 1])).all(axis=2).any(axis=1)
    ends = net.nodes[net.element]
    above, below = ends[:, :, None] >= boxes[:, 0] - 1e-9, ends[:, :, None] <= boxes[:, 1] + 1e-9
    gripped = (above & below).all(axis=3)
    assert (gripped.any(axis=2).all(axis=1) == within).all()
    assert net.length[~within].sum() == pytest.approx(0.04 + 0.08 * np.pi, rel=3e-4)


def test_forces_of_a_rod_are_the_slopes_of_its_energy() -> None:
    random = np.random.default_rng(0)
    rest = random.standard_normal((4, 3))
    section = regular_polygon(1.0, 8)
    net = rod_net([Line(0, np.array([[0.0, 0, 0], step]), section) for step in rest], [], 10.0)
    place = random.standard_normal((4, 2, 3))
    rotation = matrix_from_rotation_vector(0.8 * random.standard_normal((4, 2, 3)))
    stiffness = random.uniform(0.5, 2.0, (4, 6))
    given = net.frame, rest, net.length

    def energy(place: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        return 0.5 * (net.length[:, None] * stiffness * strains(place, rotation, *given) ** 2).sum(1)

    found = nodal_forces(place, rotation, *given, stiffness)
    for node in range(2):
        for c in range(3):
            step = np.zeros((4, 2, 3))
            step[:, node, c] = 1e-6
            slope = (energy(place + step, rotation) - energy(place - step, rotation)) / 2e-6
            np.testing.assert_allclose(found[:, node, c], slope, atol=1e-7)
            turned = [rotation @ matrix_from_rotation_vector(s * step) for s in (1.0, -1.0)]
            slope = (energy(place, turned[0]) - energy(place, turned[1])) / 2e-6
            np.testing.assert_allclose(found[:, node, 3 + c], slope, atol=1e-7)
    turn = matrix_from_rotation_vector(np.array([0.3, -1.0, 2.0]))
    same = strains(place @ turn.T + 1.0, turn @ rotation, *given)
    np.testing.assert_allclose(same, strains(place, rotation, *given), atol=1e-12)


def test_forces_of_a_shell_are_the_slopes_of_its_energy() -> None:
    random = np.random.default_rng(1)
    rest = random.standard_normal((4, 5, 3))
    slopes = rest + 0.3 * random.standard_normal(rest.shape)
    square = random.standard_normal((4, 6, 6))
    stiffness = square @ np.swapaxes(square, 1, 2)

    def energy(slopes: np.ndarray) -> np.ndarray:
        strain = fundamental(slopes) - fundamental(rest)
        return 0.5 * np.einsum("qi,qij,qj->q", strain, stiffness, strain)

    stress = np.einsum("qij,qj->qi", stiffness, fundamental(slopes) - fundamental(rest))
    found = slope_forces(slopes, stress)
    for k in range(15):
        step = np.zeros_like(slopes)
        step[:, k // 3, k % 3] = 1e-6
        slope = (energy(slopes + step) - energy(slopes - step)) / 2e-6
        np.testing.assert_allclose(found[:, k // 3, k % 3], slope, atol=1e-6, rtol=1e-6)


def test_strains_of_a_shell_are_those_of_the_space_that_it_lies_in() -> None:
    random = np.random.default_rng(2)
    rest = random.standard_normal((4, 5, 3))
    deformation = np.eye(3) + 0.1 * random.standard_normal((3, 3))
    axes, area = local_axes(rest)
    found = np.einsum("qij,qj->qi", axes, (fundamental(rest @ deformation.T) - fundamental(rest))[:, :3])
    green = 0.5 * (deformation.T @ deformation - np.eye(3))
    one, (up, size) = rest[:, 0] / np.linalg.norm(rest[:, 0], axis=1)[:, None], normal(rest)
    two = np.cross(up, one)
    for row, (a, b, share) in enumerate(((one, one, 1.0), (two, two, 1.0), (one, two, 2.0))):
        np.testing.assert_allclose(found[:, row], share * np.einsum("qi,ij,qj->q", a, green, b), atol=1e-12)
    np.testing.assert_allclose(area, size)


def test_frequencies_of_a_clamped_rod_are_those_of_theory() -> None:
    found = frequencies(body_of(straight_rod(), 1e8, poissons_ratio=0.3), 10)
    second = regular_polygon(RADIUS, 24).second / regular_polygon(RADIUS, 24).area
    theory = BENDING**2 / LENGTH**2 * np.sqrt(1e8 * second / DENSITY) / (2 * np.pi)
    # Shear and the section's own turning take up to 0.7 % of the third (Timoshenko).
    for pair in (found[[0, 2, 4]], found[[1, 3, 5]]):
        assert np.all(np.abs(pair / theory - 1.0) < [1e-3, 5e-3, 1e-2])
    torsion = np.sqrt(1e8 / 2.6 / DENSITY) / (4.0 * LENGTH)
    assert np.abs(found / torsion - 1.0).min() < 2e-3


def test_frequencies_of_a_clamped_strip_are_those_of_theory() -> None:
    found = frequencies(body_of(strip(length=0.1, thickness=3e-4), 1e8, size=0.008), 6)
    theory = BENDING**2 / 0.1**2 * np.sqrt(1e8 * 3e-4**2 / 12 / DENSITY) / (2 * np.pi)
    for each in theory:
        assert np.abs(found / each - 1.0).min() < 3e-3


@pytest.mark.parametrize("kind", ["rod", "strip"])
def test_a_thin_cantilever_hangs_as_the_elastica_does(kind: str) -> None:
    if kind == "rod":
        section = regular_polygon(RADIUS, 24)
        body, load = body_of(straight_rod(), 4e6), DENSITY * GRAVITY * section.area / (4e6 * section.second)
    else:
        body = body_of(strip(length=LENGTH, thickness=1e-3), 8e6, size=0.01)
        load = DENSITY * GRAVITY / (8e6 * 1e-3**2 / 12)
    state, shape_of = body.at_rest(), (len(body.held), -1)
    free = np.repeat(~body.held, body.inertia.shape[0] // len(body.held))
    still = np.zeros(body.inertia.shape[0]).reshape(shape_of)
    whole = body.gravity
    for share in np.linspace(0.05, 1.0, 20):
        body.gravity = share * whole
        for _ in range(30):
            force = body.surplus(state, still, state, 0.0, 1.0).ravel()[free]
            slope = csc_matrix(body.slope(state, state, 1.0))[free][:, free]
            change = np.zeros(len(free))
            change[free] = -np.linalg.solve(slope.toarray(), force)
            state = body.moved(state, change.reshape(shape_of))
            if np.abs(change).max() < 1e-9:
                break
    tip = body.places(np.array([[LENGTH, 0.0, 0.0]]))
    found, _ = body.carried(tip, state, still, 0.0)
    theory = elastica(load, LENGTH)
    assert theory[1] < -0.3 * LENGTH
    np.testing.assert_allclose(found[0, [0, 2]], theory, atol=2e-3 * LENGTH)


class Swing:
    """A mass on a spring of 1 Hz beside one that is held, pulled by one newton."""

    held = np.array([False, True])
    inertia = csc_matrix(np.eye(6))

    def moved(self, state: np.ndarray, change: np.ndarray) -> np.ndarray:
        return state + change

    def imposed(self, state: np.ndarray, time: float) -> np.ndarray:
        return state

    def surplus(self, state, velocity, before, time, step) -> np.ndarray:
        return (2 * np.pi) ** 2 * state - np.array([[1.0, 0, 0], [0, 0, 0]])

    def slope(self, state, before, step) -> csc_matrix:
        return csc_matrix((2 * np.pi) ** 2 * np.eye(6))


def test_steps_in_time_are_of_second_order_and_keep_a_swing() -> None:
    apart = []
    for count in (200, 400):
        found = [m.state[0, 0] for m in march(Swing(), np.zeros((2, 3)), 0.0, 2.0 / count, count)]
        times = 2.0 / count * np.arange(1, count + 1)
        theory = (1.0 - np.cos(2 * np.pi * times)) / (2 * np.pi) ** 2
        apart.append(np.abs(found - theory).max() / theory.max())
    assert apart[0] < 5e-3
    assert apart[0] / apart[1] == pytest.approx(4.0, rel=0.1)


def test_a_grid_of_splines_goes_through_a_sheet_and_finds_feet() -> None:
    u, v = np.meshgrid(np.linspace(0, 0.06, 40), np.linspace(-0.01, 0.01, 12), indexing="ij")
    place = np.stack([np.sin(20 * u) / 20, v, (1 - np.cos(20 * u)) / 20 + 5 * v**2], axis=2)
    grid = ShellGrid.over(Sheet(place, 1e-3), 0.004)
    points = place[3:-3:5, 2:-2:3].reshape(-1, 3)
    index, shares = grid.shapes(grid.feet(points + [0.0, 0.0, 1e-9]))
    found = np.einsum("qoi,qic->oqc", shares[:, :3], grid.control[index])
    np.testing.assert_allclose(found[0], points, atol=3e-5)
    for slope in found[1:]:
        assert np.abs(np.einsum("qc,qc->q", slope, points - found[0])).max() < 1e-9


@pytest.mark.parametrize("kind", ["rod", "strip"])
def test_viscosity_takes_from_a_swing_what_theory_says(kind: str) -> None:
    eta, ratio = 3e4, 0.3
    # Of a strip, where its hold keeps its sides from narrowing it is less: 3 % of 100 mm, half that of 200.
    kind_of = straight_rod() if kind == "rod" else strip(length=2 * LENGTH, thickness=3e-4)
    hidden = (Hidden("viscosity", "effect", {"eta": eta}),)
    body = body_of(kind_of, 1e8, size=0.01, poissons_ratio=ratio, hidden=hidden)
    plain = body_of(kind_of, 1e8, size=0.01, poissons_ratio=ratio)
    lowest = frequencies(plain, 1)[0]
    # Of the slope over a step, what is not elastic is the damping over the step.
    stiffer = frequencies(body, 1, step=0.1)[0]
    lag = ((stiffer / lowest) ** 2 - 1.0) * 0.1
    assert lag == pytest.approx(4.0 / 3.0 * (1.0 + ratio) ** 2 * eta / 1e8, rel=0.03)


def test_a_cable_is_filmed_between_two_hands(tmp_path: Path) -> None:
    options = {"frames": 8, "marker_count": 32, "noise_free": True, "spacing_share": 2.0}
    take = Take("a", (), 100.0, 8, (0, 8), (0, 0), 2)
    recipe = replace(small("cable", **options), takes=(take,))
    make_capture(recipe, tmp_path / "still", measure_signal=False)
    read = load_capture(tmp_path / "still")
    assert [part.shape for part in read.parts] == ["rod", "rod"]
    assert len(read.sequences[0].held) == 2
    rest = read.sequences[0].markers.at.reshape(-1, 4, 3)
    assert np.linalg.norm(rest - rest.mean(1, keepdims=True), axis=2) == pytest.approx(0.006, rel=1e-2)
    fallen = tracks(read)
    assert np.abs(fallen[2] - fallen[0]).max() < 1e-6
    assert 1e-5 < np.abs(fallen[-1] - fallen[0]).max() < 1e-2
    answer = json.loads((tmp_path / "still" / "answer.json").read_text())
    assert answer["simulation"]["simulator"] == "rod"
    assert answer["simulation"]["shares_code_with_the_model"] is False
    assert answer["far_motions"] == [[]]
    heavy = small("cable", ("attached_mass",), **options)
    make_capture(replace(heavy, takes=(take,)), tmp_path / "heavy", measure_signal=False)
    assert np.abs(tracks(load_capture(tmp_path / "heavy")) - fallen).max() > 1e-6


@pytest.mark.parametrize("kind", ["cable", "branched-cable", "strip"])
def test_a_thin_object_follows_its_hold_as_a_whole_where_nothing_bends_it(kind: str, tmp_path: Path) -> None:
    # A slow turn of all that holds it, without weight: a rigid motion, of every marker.
    recipe = small(kind, frames=10, marker_count=24, noise_free=True, spacing_share=2.0)
    (take,) = recipe.takes
    move = (replace(take.motions[0], kind="turn", axis=(0.0, 1.0, 0.3), degrees=20.0, stop=20.0, start=0.0),)
    take = replace(take, motions=move, far_motions=move, fps=0.5, release=0)
    weightless = replace(recipe.shape, gravity=np.zeros(3), far_pivot=recipe.shape.pivot)
    make_capture(replace(recipe, shape=weightless, takes=(take,)), tmp_path, measure_signal=False)
    read = load_capture(tmp_path)
    turn, shift = read.sequences[0].held[0].poses(np.array([18.0]), 0.5)
    rigid = read.sequences[0].markers.at @ turn[0].T + shift[0]
    assert np.abs(rigid - read.sequences[0].markers.at).max() > 5e-3
    np.testing.assert_allclose(tracks(read)[-1], rigid, atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "share", "apart"), [("cable", 6.0, 0.04), ("strip", 2.5, 0.04)])
def test_the_model_moves_as_independent_truth_does(kind: str, share: float, apart: float, tmp_path) -> None:
    found = []
    for simulator, spacing in ((None, 1.2), ("total-lagrangian", share)):
        options = {"frames": 14, "simulator": simulator, "noise_free": True, "spacing_share": spacing}
        _, capture = made(tmp_path / str(simulator), kind, **options)
        found.append(tracks(capture))
    moved = found[0] - found[0][0]
    assert np.linalg.norm(found[1] - found[0]) < apart * np.linalg.norm(moved)
    assert np.abs(found[1] - found[0]).max() > 1e-7


@pytest.mark.parametrize("module", ["rod", "shell"])
def test_truth_of_thin_things_shares_no_code_with_the_model(module: str) -> None:
    told = (
        "import sys, types, mphygs; from pathlib import Path; synth = types.ModuleType('mphygs.synth');"
        "synth.__path__ = [str(Path(mphygs.__file__).parent / 'synth')]; sys.modules['mphygs.synth'] = synth;"
        f"import mphygs.synth.{module}; print(*(m for m in sys.modules if m.startswith('mphygs.')))"
    )
    loaded = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    assert {name.split(".")[1] for name in loaded.stdout.split()} == {"capture", "synth"}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["cable", "--hidden", "plasticity"], "the simulator rod has no 'plasticity'"),
        (["cable", "--hidden", "actuation"], "the simulator rod has no 'actuation'"),
        (["strip", "--hidden", "contact"], "the simulator shell has no 'contact'"),
        (["cable", "--markers", "30"], "a multiple of 4"),
        (["cable", "--sensors", "force"], "no sensors"),
        (["cable", "--simulator", "shell"], "expected strip"),
        (["bar", "--simulator", "rod"], "expected cable"),
        (["cable", "--start", "pulled"], "expected rest or moving"),
    ],
)
def test_what_thin_truth_cannot_have_ends_in_one_line(options, said, tmp_path, capsys) -> None:
    assert main([*options, "--frames", "8", "--out", str(tmp_path / "x")]) == 2
    heard = capsys.readouterr()
    assert said in heard.err and len([s for s in heard.err.splitlines() if s.startswith("mphygs")]) <= 1
    assert not (tmp_path / "x" / "answer.json").exists()


def test_a_branched_cable_hangs_together() -> None:
    kind = shape("branched-cable")
    net = rod_net(kind.lines, np.array([kind.hold, kind.far_hold]), 0.005)
    ends = np.bincount(net.element.ravel(), minlength=len(net.nodes))
    assert (ends == 1).sum() == 3 and (ends == 3).sum() == 1
    volume = sum(
        kind.lines[k].section.area * length for k, length in zip(net.line, net.length, strict=True)
    )
    assert volume == pytest.approx(kind.volume, rel=5e-3)

"""The independent finite elements and the core tell the same story, effect by effect."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mphygs.capture.actuators import Pressure
from mphygs.capture.format import load_capture
from mphygs.synth import finite_element_body
from mphygs.synth.bare_recordings import bare_capture, bare_recording
from mphygs.synth.brick_mesh import brick_mesh
from mphygs.synth.finite_element import simulate_finite_element
from mphygs.synth.finite_element_drive import Driven
from mphygs.synth.finite_element_stress import MaterialStress
from mphygs.synth.make import make_capture
from mphygs.synth.recipe import truth_spacing
from mphygs.synth.shapes import block_flower, flower, two_part_bar
from synth_example import made, small, tracks

FRAMES = 9
FLOWER = {"simulator": "finite-element", "noise_free": True, "spacing_share": 1.2}
# The effect's own change of the motion, one simulator against the other, on coarse grids.
TOLERANCE = 0.1
COMPARED = (
    "gravity:delta_g_y=3",
    "mass_damping:alpha=5",
    "wind",
    "tether:k=2",
    "attached_mass:m=3e-3",
    "fibre",
    "relaxation:ratio=1",
    "stiffness_gradient",
    "base_motion:a_y=5:f=3",
    "base_motion:a_y=9:f=8:phase=-2:pulse=1",
)


def positions(folder, simulator: str, hidden: tuple[str, ...]) -> np.ndarray:
    options = {"frames": FRAMES, "simulator": simulator, "noise_free": True, "spacing_share": 1.25}
    return tracks(made(folder, "two-part-bar", hidden, **options)[1])


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> dict[str, np.ndarray]:
    """The motion without anything hidden, by either simulator."""
    folder = tmp_path_factory.mktemp("plain")
    return {s: positions(folder / s, s, ()) for s in ("finite-element", "total-lagrangian")}


def test_two_simulators_agree_without_any_effect(plain) -> None:
    moved = np.abs(plain["finite-element"] - plain["finite-element"][0]).max()
    apart = np.abs(plain["finite-element"] - plain["total-lagrangian"]).max()
    assert moved > 5e-3
    # Not the same to the last digit: they share no discretisation.
    assert 1e-6 < apart < 0.05 * moved


@pytest.mark.slow
@pytest.mark.parametrize("hidden", COMPARED)
def test_an_effect_does_the_same_in_both(hidden, plain, tmp_path) -> None:
    change = {s: positions(tmp_path / s, s, (hidden,)) - plain[s] for s in plain}
    ours, core = change["finite-element"], change["total-lagrangian"]
    assert np.abs(core).max() > 5e-4  # [m]
    assert np.linalg.norm(ours - core) < TOLERANCE * np.linalg.norm(core)


def random_state(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Deformation and its rate at five points, (3, 3, 5)."""
    generator = np.random.default_rng(seed)
    f = np.eye(3)[..., None] + 0.15 * generator.standard_normal((3, 3, 5))
    return f, generator.standard_normal((3, 3, 5))


def energy(f: np.ndarray, fibre: float, c_2: float) -> np.ndarray:
    """(5,) of the neo-Hookean solid with mu 2, lambda 3, a fibre along z and a second-order term."""
    square, j = np.einsum("ijq,ijq->q", f, f), np.linalg.det(np.moveaxis(f, 2, 0))
    base = (square - 3.0) - 2.0 * np.log(j) + 1.5 * np.log(j) ** 2
    return base + 0.5 * fibre * ((f[:, 2] ** 2).sum(0) - 1.0) ** 2 + c_2 * (j ** (-2 / 3) * square - 3.0) ** 2


@pytest.mark.parametrize(("fibre", "c_2"), [(0.0, 0.0), (4.0, 0.0), (0.0, 5.0)])
def test_elastic_stress_is_the_slope_of_the_energy(fibre, c_2) -> None:
    f, rate = random_state()
    effects = {"fibre": {"k_f": fibre, "a_x": 0.0, "a_y": 0.0, "a_z": 1.0}, "stiffening": {"c_2": c_2}}
    material = MaterialStress(np.full(5, 2.0), np.full(5, 3.0), effects)
    stress = material.stress(f, rate, 0.0, 1e-3)
    for i in range(3):
        for k in range(3):
            step = np.zeros((3, 3, 1))
            step[i, k] = 1e-6
            slope = (energy(f + step, fibre, c_2) - energy(f - step, fibre, c_2)) / 2e-6
            assert stress[i, k] == pytest.approx(slope, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("growth", [0.0, 0.3])
def test_viscous_stress_is_twice_eta_times_the_deviator_of_the_rate(growth) -> None:
    f, rate = random_state(1)
    grown = {"eigenstrain": {"rate": growth}} if growth else {}
    plain = MaterialStress(np.full(5, 2.0), np.full(5, 3.0), grown)
    viscous = MaterialStress(np.full(5, 2.0), np.full(5, 3.0), grown | {"viscosity": {"eta": 7.0}})
    added = viscous.stress(f, rate, 0.5, 1e-3) - plain.stress(f, rate, 0.5, 1e-3)
    for q in range(5):
        spin = rate[..., q] @ np.linalg.inv(f[..., q])
        d = 0.5 * (spin + spin.T)
        cauchy = 14.0 * (d - np.trace(d) / 3.0 * np.eye(3))
        measured = added[..., q] @ f[..., q].T / np.linalg.det(f[..., q])
        assert measured == pytest.approx(cauchy, rel=1e-9, abs=1e-9)


def test_a_grown_solid_is_free_of_stress_at_its_grown_size_alone() -> None:
    material = MaterialStress(np.full(1, 2.0), np.full(1, 3.0), {"eigenstrain": {"rate": 0.2}})
    size = np.exp(0.2 * 1.5)
    still = np.zeros((3, 3, 1))
    assert np.abs(material.stress(size * np.eye(3)[..., None], still, 1.5, 1e-3)).max() < 1e-12
    assert np.abs(material.stress(np.eye(3)[..., None] + still, still, 1.5, 1e-3)).max() > 0.5


def test_the_maxwell_branch_jumps_and_relaxes() -> None:
    effects = {"relaxation": {"ratio": 0.5, "tau": 0.2}}
    material = MaterialStress(np.full(1, 2.0), np.full(1, 3.0), effects)
    rest, still = np.eye(3)[..., None], np.zeros((3, 3, 1))
    stretched = np.diag([1.3, 1.0, 1.0])[..., None]
    base = MaterialStress(np.full(1, 2.0), np.full(1, 3.0), {}).stress(stretched, still, 0.0, 1e-4)
    material.stress(rest, still, 0.0, 1e-4)
    jump = material.stress(stretched, still, 1e-4, 1e-4)
    assert jump == pytest.approx(1.5 * base, rel=1e-3)
    for k in range(2000):
        later = material.stress(stretched, still, 1e-4 * (k + 2), 1e-4)
    assert later == pytest.approx((1.0 + 0.5 * np.exp(-1.0)) * base, rel=2e-3)


def test_the_mesh_has_the_volume_the_area_and_exact_slopes() -> None:
    body = two_part_bar()
    mesh = brick_mesh(body.parts, body.hold, 0.0101)
    (x, y, z) = (0.09 - 0.0072, 0.018, 0.020)
    assert mesh.volume.sum() == pytest.approx(x * y * z)
    about = mesh.lumped(np.ones_like(mesh.volume))
    assert about.sum() == pytest.approx(x * y * z)
    assert (about > 0.0).all()
    assert mesh.surface_area.sum() == pytest.approx(2.0 * x * (y + z) + y * z)
    assert mesh.size.max() <= 0.0101
    split = 0.55 * 0.09
    assert ((mesh.points[..., 0] < split) == (mesh.part == 0)[:, None]).all()
    quadratic = mesh.nodes[:, 0] ** 2 * mesh.nodes[:, 1]
    slopes = [(quadratic[mesh.element] @ mesh.slope[j].T) / mesh.size[:, j, None] for j in range(3)]
    px, py = mesh.points[..., 0], mesh.points[..., 1]
    assert slopes[0] == pytest.approx(2.0 * px * py)
    assert slopes[1] == pytest.approx(px**2)
    assert slopes[2] == pytest.approx(np.zeros_like(px), abs=1e-12)
    somewhere = np.array([[0.05, 0.004, -0.003], [0.08, -0.009, 0.01]])
    assert mesh.weights(somewhere) @ mesh.nodes == pytest.approx(somewhere)


def test_a_flower_of_blocks_is_meshed_to_its_surface() -> None:
    body = block_flower()
    mesh = brick_mesh(body.parts, body.hold, 0.006)
    held = 4.0 * 0.006**3
    assert mesh.volume.sum() == pytest.approx(body.volume - held)
    for number, part in enumerate(body.parts[1:], start=1):
        assert mesh.volume[mesh.part == number].sum() == pytest.approx(part.volume)
    # All parts' surfaces, less what touches (both sides), what is held (sides and bottom), and the cut.
    head, leaf, section = 4.0, 2.0, 4.0
    faces = sum(part.area for part in body.parts) / 0.006**2 - 2.0 * (head + 2.0 * leaf) - (8.0 + section)
    assert mesh.surface_area.sum() == pytest.approx(faces * 0.006**2)


@pytest.mark.parametrize("part", [None, 1])
def test_a_pressure_acts_on_the_area_that_its_box_cuts_out(part) -> None:
    body = two_part_bar()
    mesh = brick_mesh(body.parts, body.hold, 0.0101)
    low, high = mesh.nodes.min(0), mesh.nodes.max(0)
    if part == 1:
        low[0] = 0.55 * 0.09
    low[1] += 5e-4
    box = np.array([[0.031, low[1], high[2] - 1e-4], [0.0777, 0.0013, high[2] + 1e-4]])
    actuator = Pressure(
        np.full(3, 50.0), "blown", part=None if part is None else body.part_names[part], box=box
    )
    driven = Driven(actuator, mesh, SimpleNamespace(box=body.hold), body.part_names, 10.0, None)
    stretched = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.3], [0.0, 0.1, 1.2]])
    force = driven.force(mesh.nodes @ stretched.T, 0.05)
    area = (0.0777 - max(0.031, low[0])) * (0.0013 - low[1])
    normal = np.linalg.det(stretched) * np.linalg.inv(stretched).T @ [0.0, 0.0, 1.0]
    assert force.sum(0) == pytest.approx(-50.0 * area * normal)
    # Where it acts, by its moment about the origin.
    middle = stretched @ [0.5 * (0.0777 + max(0.031, low[0])), 0.5 * (0.0013 + low[1]), high[2]]
    moment = np.cross(mesh.nodes @ stretched.T, force).sum(0)
    assert moment == pytest.approx(np.cross(middle, force.sum(0)))


def test_a_pressure_all_around_has_no_sum_but_what_the_hold_keeps_from_it() -> None:
    body = block_flower()
    mesh = brick_mesh(body.parts, body.hold, 0.006)
    around = mesh.patch(None, None)
    cut = 4.0 * 0.006**2
    assert np.linalg.norm(around.area, axis=1).sum() == pytest.approx(mesh.surface_area.sum())
    assert around.area.sum(0) == pytest.approx([0.0, 0.0, cut], abs=1e-12)
    # The divergence theorem, with the cut's own share.
    flux = np.einsum("mi,mi->", around.value @ mesh.nodes, around.area)
    bottom = mesh.nodes[:, 2].min()
    assert flux - cut * bottom == pytest.approx(3.0 * mesh.volume.sum())


def test_it_shares_no_code_with_the_model() -> None:
    """Whatever comes in with it, with the package's own way in, which knows both simulators, left out."""
    told = (
        "import sys, types, mphygs; from pathlib import Path; synth = types.ModuleType('mphygs.synth');"
        "synth.__path__ = [str(Path(mphygs.__file__).parent / 'synth')]; sys.modules['mphygs.synth'] = synth;"
        "import mphygs.synth.finite_element; print(*(m for m in sys.modules if m.startswith('mphygs.')))"
    )
    loaded = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    packages = {name.split(".")[1] for name in loaded.stdout.split()}
    assert packages == {"capture", "scene", "synth"}
    scene = {name for name in loaded.stdout.split() if name.startswith("mphygs.scene.")}
    assert scene == {"mphygs.scene.rays"}


def unmoved(folder, hidden: tuple[str, ...], frames: int = 3) -> np.ndarray:
    """Displacement (T, M, 3) [m] of a flower whose hold stays: none where its shape is in equilibrium."""
    recipe = small("block-flower", hidden, frames=frames, **FLOWER)
    recipe = replace(recipe, takes=(replace(recipe.takes[0], motions=()),))
    make_capture(recipe, folder, measure_signal=False)
    position = tracks(load_capture(folder))
    return position - position[0]


@pytest.mark.parametrize(
    "hidden",
    [
        ("attached_mass:m=1e-3",),
        # in a brick that the hold grips in part
        ("attached_mass:m=1e-3:place=0.002/0/0.008",),
        pytest.param((), marks=pytest.mark.slow),
        pytest.param(("wind:w_x=2:c_d=1.5:at_rest=true",), marks=pytest.mark.slow),
        pytest.param(("fibre",), marks=pytest.mark.slow),
    ],
)
def test_a_flower_that_carries_its_loads_stays(hidden, tmp_path) -> None:
    assert np.abs(unmoved(tmp_path, hidden)).max() < 2e-8


def test_a_load_that_came_after_the_scan_makes_it_swing(tmp_path) -> None:
    moved = unmoved(tmp_path, ("wind:w_x=2:w_y=0:c_d=1.5:at_rest=false",))
    assert 1e-3 < moved[-1, :, 0].max() < 2e-2
    assert moved[-1, :, 0].min() > -1e-3


def test_velocities_are_those_of_the_positions_beside_the_hold_too() -> None:
    recipe = small("two-part-bar", frames=40, simulator="finite-element", spacing_share=2.0)
    shake = replace(recipe.takes[0].motions[0], start=0.0, frequency=60.0, ramp=0.004)
    fast = replace(recipe.takes[0], motions=(shake,), fps=8000.0, release=0)
    low, high = recipe.shape.hold
    beside = np.array([[high[0] + 0.002, *(0.5 * (low + high))[1:]], recipe.shape.tip])
    capture = bare_capture(recipe, Path(), beside)
    motion = simulate_finite_element(
        capture, bare_recording(recipe, fast, beside), recipe, (), truth_spacing(2.0, recipe.shape.volume)
    )
    # The shake begins with a jump of its acceleration.
    between = 0.5 * 8000.0 * (motion.position[4:] - motion.position[2:-2])
    assert np.abs(between[:, 0]).max() > 0.1
    np.testing.assert_allclose(motion.velocity[3:-1], between, atol=0.01 * np.abs(between).max())


def test_both_simulators_tell_the_same_forces_and_accelerations(tmp_path) -> None:
    sensors = ("force:sigma=1e-9", "torque:sigma=1e-9", "acceleration:sigma=1e-9")
    found = []
    for simulator, share in (("finite-element", 1.4), ("total-lagrangian", 0.8)):
        options = {"simulator": simulator, "spacing_share": share, "sensors": sensors, "noise_free": True}
        _, capture = made(tmp_path / simulator, "bar", frames=12, **options)
        found.append([sensor.value for sensor in capture.sequences[0].sensors])
    for one, other in zip(*found, strict=True):
        for v in range(one.shape[1]):
            told = np.isfinite(one[:, v]).all(1)
            apart, size = (one - other)[told, v], (one - one[told].mean(0))[told, v]
            # The fast modes of a bar that is let go part first: they are a tenth of it here.
            assert 0.0 < np.sqrt(np.mean(apart**2)) < 0.3 * np.sqrt(np.mean(size**2))


@pytest.mark.slow
def test_both_simulators_move_a_flower_that_carries_its_weight(tmp_path) -> None:
    share = {"finite-element": 1.2, "total-lagrangian": 0.9}
    found = [
        tracks(made(tmp_path, "block-flower", frames=8, **FLOWER | {"simulator": s, "spacing_share": x})[1])
        for s, x in share.items()
    ]
    moved, apart = np.abs(found[0] - found[0][0]).max(), np.abs(found[0] - found[1]).max()
    assert moved > 5e-3
    assert 1e-6 < apart < 0.06 * moved


def test_a_node_on_a_wall_sticks_up_to_mu_times_what_presses_on_it() -> None:
    body = object.__new__(finite_element_body.FiniteElementBody)
    wall = {"d": 0.0, "n_x": 0.0, "n_y": 0.0, "n_z": 1.0, "mu": 0.5, "stiffness": 1e6}
    body.effects, body.mass = {"contact": wall}, np.full(4, 1e-3)
    body.mesh = SimpleNamespace(surface_area=np.full(4, 1e-4))
    x = np.array([[0.0, 0, -1e-4], [0, 0, -1e-4], [0, 0, -1e-4], [0, 0, 1e-4]])
    assert body._pressing(x, np.array([0.0, 0, 1])).ravel() == pytest.approx([0.01, 0.01, 0.01, 0.0])
    force = np.array([[0.002, 0, 0.03], [0.003, 0.02, 0.0], [0, 0, 0], [0.002, 0, 0]])
    v, dt = np.zeros((4, 3)), 1e-4
    v[2] = [0.0, -1e-4, 5.0]
    found = body._friction(x, v, force, dt)
    # Held; slides; stopped from a slow slip; nowhere near.
    assert found[0] == pytest.approx([-0.002, 0.0, 0.0])
    assert np.linalg.norm(found[1]) == pytest.approx(0.005)
    assert np.cross(found[1], force[1]) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12) and found[1, 1] < 0.0
    assert found[2] == pytest.approx([0.0, 1e-4 * 1e-3 / dt, 0.0])
    assert found[3] == pytest.approx([0.0, 0.0, 0.0])


def test_what_it_does_not_know_is_refused(tmp_path) -> None:
    for hidden in ("plasticity", "hold_compliance"):
        with pytest.raises(ValueError, match=hidden):
            make_capture(small("bar", (hidden,), simulator="finite-element"), tmp_path)
    with pytest.raises(ValueError, match="part 'stem'.*boxes"):
        make_capture(small("flower", simulator="finite-element"), tmp_path)
    with pytest.raises(ValueError, match="boxes"):
        brick_mesh(flower().parts, flower().hold, 0.01)
    with pytest.raises(ValueError, match="expected one of total-lagrangian"):
        small("bar", simulator="crystal-ball")

"""The examples, run as they stand, and what they find."""

import importlib
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from mphygs.model import registry

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> ModuleType:
    """The example that the test is named after."""
    monkeypatch.setattr(registry, "_USER", {})
    monkeypatch.syspath_prepend(str(EXAMPLES))
    name = request.function.__name__.removeprefix("test_")
    for module in ("bar", name):
        sys.modules.pop(module, None)
    found = importlib.import_module(name)
    yield found
    for module in ("bar", name):
        sys.modules.pop(module, None)


def test_every_example_is_told_of_and_run() -> None:
    told = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    for path in EXAMPLES.glob("*.py"):
        assert f"`{path.name}`" in told
        assert path.stem == "bar" or f"test_{path.stem}" in globals(), path.name


@pytest.mark.slow
def test_verdict(example: ModuleType) -> None:
    found = example.main()
    assert (found.verdict, found.effects) == ("missing", ("viscosity",))
    assert found.parameters["bar.youngs_modulus"].value == pytest.approx(2.5e5, rel=0.05)


def test_force(example: ModuleType) -> None:
    found = example.main()
    for key, true in (("bar.youngs_modulus", 2.5e5), ("bar.density", 1000.0)):
        number = found["and force"].parameters[key]
        assert number.determined and abs(number.value - true) < 2.0 * number.std < 0.1 * true
        assert not found["markers"].parameters[key].determined


@pytest.mark.slow
def test_gradient(example: ModuleType) -> None:
    found = example.main()
    assert found["bar.youngs_modulus"] == pytest.approx(2.5e5, rel=0.1)
    assert found["viscosity.eta"] == pytest.approx(60.0, rel=0.4)


@pytest.mark.filterwarnings("ignore:effect 'push'")
def test_effect_in_python(example: ModuleType) -> None:
    found = example.main()
    push = found.parameters["push.a"]
    assert push.determined and push.value == pytest.approx(3.0, abs=max(4 * push.std, 0.1))


def test_effect_in_cpp(example: ModuleType, tmp_path: Path) -> None:
    motion = example.main()
    assert motion is None or motion.position.shape == (40, 12, 3)
    tools = [shutil.which(name) for name in ("g++", "cmake", "ninja")]
    if None in tools:
        pytest.skip("no g++, cmake and ninja here")
    # The lists of laws and effects, as the build writes them for MPHYGS_EXTRA_EFFECTS=examples.
    (tmp_path / "CMakeLists.txt").write_text(
        f'cmake_minimum_required(VERSION 3.24)\nproject(lists NONE)\nset(PROJECT_SOURCE_DIR "{ROOT}")\n'
        f'include("{ROOT}/cmake/EffectList.cmake")\nmphygs_write_lists("{tmp_path}/lists" "{EXAMPLES}")\n'
    )
    line = [tools[1], "-G", "Ninja", "-S", str(tmp_path), "-B", str(tmp_path / "build")]
    subprocess.run(line, capture_output=True, check=True)
    assert "Buoyancy" in (tmp_path / "lists" / "mphygs" / "effect_list.hpp").read_text()
    # On numbers, as the forward simulation runs it.
    program = tmp_path / "check.cpp"
    program.write_text(
        '#include "buoyancy.hpp"\n#include <cstdio>\n'
        "int main() { mphygs::BodyPoint<double> p{}; double q[2] = {9.0, 0.5};\n"
        "for (double z : {0.0, 1.0}) { p.position[2] = z;\n"
        'std::printf("%g ", double(mphygs::Buoyancy::acceleration(p, q)[2])); } }\n'
    )
    places = (EXAMPLES, ROOT / "cpp" / "include", tmp_path / "lists")
    folders = [word for path in places for word in ("-I", path)]
    line = [tools[0], "-std=c++20", *folders, program]
    made = subprocess.run([*line, "-o", tmp_path / "check"], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr[:2000]
    assert subprocess.run([tmp_path / "check"], capture_output=True, text=True, check=True).stdout == "9 0 "


@pytest.mark.slow
def test_law(example: ModuleType) -> None:
    errors = example.main()
    assert set(errors) == set(registry.laws()) and max(errors.values()) < 1.3


@pytest.mark.slow
def test_batch(example: ModuleType) -> None:
    rows = example.main()
    assert len(rows) == 3
    for row in rows:
        assert row["bar.youngs_modulus"] == pytest.approx(row["truth"], rel=0.05)


def test_check(example: ModuleType) -> None:
    told = example.main()
    assert told["findings"] == [] and told["parameters"]["viscosity.eta"]["determined"]


def test_next_motion(example: ModuleType) -> None:
    expected = example.main()
    assert len(expected) == 3 and all(0 < std < 5.0 for std in expected.values())
    # Near the first natural frequency the viscosity shows most.
    assert min(expected, key=expected.get) == "8 Hz"


@pytest.mark.slow
def test_tendon(example: ModuleType) -> None:
    found = example.main().parameters
    for key, truth, near in (
        ("finger.youngs_modulus", 1.2e5, 0.05),
        ("tendon.gain", 0.7, 0.05),
        ("tendon.delay", 0.02, 0.1),
    ):
        assert found[key].determined and found[key].value == pytest.approx(truth, rel=near), key


@pytest.mark.slow
def test_beam(example: ModuleType, shared_data: Path) -> None:
    found = example.main(shared_data / "silicone-beam")
    errors = [row for row in found.rows() if row["sequence"] == "gravity-a" and row["frames"] == "predict"]
    assert errors[-1]["rms"] < 0.3 * errors[0]["rms"]


@pytest.mark.slow
def test_video(example: ModuleType, tmp_path: Path) -> None:
    found = example.main(tmp_path)
    fitted = [ranges["fit"] for ranges in found.sequences.values() if ranges["fit"] is not None]
    assert fitted and all(error.psnr > 20.0 and error.iou > 0.8 for error in fitted)

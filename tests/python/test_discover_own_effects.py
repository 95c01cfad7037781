"""Effects and laws in C++ from a user's folder are found by the loop, with no other file changed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "tests" / "cpp" / "example_effects"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package compiled with the example effects."""
    if shutil.which("cmake") is None or shutil.which("ninja") is None:
        pytest.skip("cmake and ninja are not there to compile effects with")
    work = tmp_path_factory.mktemp("own-effects")
    build, site = work / "build", work / "site"
    commands = (
        ["cmake", "-S", ROOT, "-B", build, "-G", "Ninja", f"-DMPHYGS_EXTRA_EFFECTS={FOLDER}",
         f"-DPython_EXECUTABLE={sys.executable}"],
        ["cmake", "--build", build, "--target", "_core", "-j", "2"],
    )  # fmt: skip
    for command in commands:
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    ignored = shutil.ignore_patterns("*.so", "__pycache__")
    shutil.copytree(ROOT / "python" / "mphygs", site / "mphygs", ignore=ignored)
    for module in build.glob("_core*.so"):
        shutil.copy(module, site / "mphygs")
    return site


def answer(site: Path, *words: object) -> dict:
    """The JSON of a command of that package."""
    done = subprocess.run(
        [sys.executable, "-m", *map(str, words), "--json"],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(site), "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


# A soft bar, whose strains tell limits, and laws where it is pulled aside.
SOFT = ("--seed", 56)


@pytest.mark.parametrize(
    ("hidden", "name", "candidates", "made"),
    [
        ("dashpot:c=0.05", "dashpot", None, ("--seed", 3)),  # acts at a place
        ("restoring:k=40", "restoring", None, ("--seed", 3)),
        # Has a history. A bar that bends does not tell it from a relaxation.
        ("volume_memory:k=4e5:tau=0.1", "volume_memory", "volume_memory,viscosity,air_drag,gravity",
         ("--seed", 3)),
        # A threshold with a strength.
        ("locking:limit=0.02:k=1e5", "locking", None, SOFT),
        # A law.
        ("saint-venant-kirchhoff", "saint-venant-kirchhoff", None, (*SOFT, "--start", "pulled")),
    ],
)  # fmt: skip
def test_an_effect_of_a_users_folder_is_found(
    package: Path, tmp_path: Path, hidden: str, name: str, candidates: str | None, made: tuple
) -> None:
    capture = tmp_path / "capture"
    answer(package, "mphygs.synth", "bar", "--hidden", hidden, *made, "--out", capture)
    among = [] if candidates is None else ["--effects", candidates]
    run = tmp_path / "run"
    found = answer(package, "mphygs.discover", capture, "--out", run, "--workers", 1, *among)
    alike = {name, *(t for step in found["steps"] if name in step["added"] for t in step["ties"])}
    assert found["verdict"] == "missing" and name in alike and set(found["effects"]) & alike
    assert name in [row["effect"] for row in found["table"]]

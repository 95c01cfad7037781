"""The choice of the compiled core in a portable wheel."""

import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from mphygs import _load_core


@pytest.mark.parametrize(("level", "name"), [(2, "v2"), (3, "v3"), (4, "v4"), (5, "v4")])
def test_takes_the_highest_variant_that_runs(level: int, name: str) -> None:
    assert _load_core.variant_name(level) == f"mphygs._core_{name}"


def test_an_old_processor_is_told_what_is_missing() -> None:
    with pytest.raises(ImportError, match=r"x86-64-v1.*needs x86-64-v2"):
        _load_core.variant_name(1)


def test_loads_the_variant_for_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    processor = ModuleType("mphygs._processor")
    processor.level = lambda: 3  # type: ignore[attr-defined]
    core = ModuleType("mphygs._core_v3")
    monkeypatch.setitem(sys.modules, "mphygs._processor", processor)
    monkeypatch.setitem(sys.modules, "mphygs._core_v3", core)
    assert _load_core.load() is core


def test_a_package_that_was_never_compiled_says_so(tmp_path: Path) -> None:
    package = tmp_path / "mphygs"
    package.mkdir()
    source = Path(_load_core.__file__).parent
    for name in ("_core.py", "_load_core.py"):
        shutil.copy(source / name, package)
    (package / "__init__.py").touch()
    run = subprocess.run(
        [sys.executable, "-c", "from mphygs import _core"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert run.returncode != 0
    assert "the compiled core is missing" in run.stderr


def test_the_core_of_this_installation_answers() -> None:
    core = importlib.import_module("mphygs._core")
    assert any(effect["name"] == "gravity" for effect in core.effects())

"""The documentation as a site: it builds without a warning and tells of everything there is."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

import mphygs
from mphygs.commands.command_table import COMMANDS
from mphygs.model.registry import effects
from mphygs.synth.hidden import hidden_names

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
@pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("mkdocs", "mkdocstrings")),
    reason="mkdocs and mkdocstrings are not installed",
)
def test_the_site_builds_and_tells_of_everything(tmp_path: Path) -> None:
    line = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    found = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False, env=dict(os.environ))
    assert found.returncode == 0, found.stderr[-3000:]
    told = {
        page: (tmp_path / page / "index.html").read_text(encoding="utf-8")
        for page in ("every-effect", "commands", "interface")
    }
    for name, spec in effects().items():
        assert f'id="{name}"' in told["every-effect"], name
        for parameter in spec.parameters:
            assert f"<td>{parameter.name}</td>" in told["every-effect"], (name, parameter.name)
        if name in hidden_names():
            assert f"images/effects/{name}.svg" in told["every-effect"], name
            assert b"<svg" in (tmp_path / "images" / "effects" / f"{name}.svg").read_bytes()
    for name in COMMANDS:
        assert f'id="{name}"' in told["commands"], name
    assert "--spacing" in told["commands"] or "<code>spacing</code>" in told["commands"]
    for name in mphygs.__all__:
        assert name in told["interface"], name
    assert "Simo" in told["every-effect"], "the source of a formula"


def test_every_command_is_in_the_table_of_files() -> None:
    told = (ROOT / "docs" / "json.md").read_text(encoding="utf-8")
    for name in ("fit", "predict", "compare", "diagnose", "extend", "discover", "doctor", "init", "batch"):
        assert f"`{name}`" in told

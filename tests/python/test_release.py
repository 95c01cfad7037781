"""A release: one version, that of the tag, and no other place that states one."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_change_log_and_citation_say_the_version_of_the_tag() -> None:
    newest = re.search(r"^## \[(\S+?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert newest is not None

    def told(tag: str) -> subprocess.CompletedProcess[str]:
        line = [sys.executable, str(ROOT / ".ci" / "version"), tag]
        return subprocess.run(line, capture_output=True, text=True, check=False)

    assert told(f"v{newest[1]}").returncode == 0, told(f"v{newest[1]}").stderr
    wrong = told(f"v{newest[1]}0")
    assert wrong.returncode == 1
    assert "CHANGELOG.md says" in wrong.stderr and "CITATION.cff says" in wrong.stderr


def test_the_package_states_no_version_of_its_own() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert 'dynamic = ["version"]' in text and not re.search(r"^version =", text, re.MULTILINE)

"""Data flows one way: no package imports one that stands after it."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2] / "python" / "mphygs"
LAYERS = (
    "capture", "scene", "render", "motion", "model", "simulate", "compare", "fit", "diagnose", "extend",
    "baselines", "synth", "report",
)  # fmt: skip
# What every package may use besides the packages above it.
COMMON = {"_core"}


def imported_modules(source: str, package: str) -> set[str]:
    """First names below `mphygs` that a module of `mphygs.<package>` imports, wherever the import stands."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [node.module or ""]
            if node.module == "mphygs":
                names = [f"mphygs.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            # One dot is the package itself, two are mphygs.
            stem = ["mphygs", package][: 3 - node.level]
            stem += [node.module] if node.module else []
            names = [".".join([*stem, alias.name]) for alias in node.names]
        for name in names:
            parts = name.split(".")
            if parts[0] == "mphygs" and len(parts) > 1:
                found.add(parts[1])
    return found


def violations(source: str, package: str) -> set[str]:
    """Imports of a module of `package` that its place in LAYERS does not allow."""
    allowed = {*LAYERS[: LAYERS.index(package) + 1], *COMMON}
    return imported_modules(source, package) - allowed


def modules() -> list[Path]:
    """Commands (__main__.py), batches of them and the interface in Python (api) stand above all packages."""
    return sorted(
        path
        for path in ROOT.rglob("*.py")
        if path.parent not in (ROOT, ROOT / "api", ROOT / "batch") and path.name != "__main__.py"
    )


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_only_what_stands_above(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    assert package in LAYERS, f"{package} is no package of the architecture: {', '.join(LAYERS)}"
    wrong = violations(path.read_text(encoding="utf-8"), package)
    assert not wrong, f"{package} stands above or beside {', '.join(sorted(wrong))} and may not import it"


@pytest.mark.parametrize(
    ("source", "package", "expected"),
    [
        ("import mphygs.fit.start", "capture", {"fit"}),
        ("import numpy, mphygs.report", "fit", {"report"}),
        ("from mphygs.fit import start", "scene", {"fit"}),
        ("from mphygs import fit, capture", "scene", {"fit"}),
        ("from ..fit.start import x", "scene", {"fit"}),
        ("from .. import fit", "scene", {"fit"}),
        ("from . import rays", "scene", set()),
        ("from .rays import hit", "scene", set()),
        ("def f():\n    from mphygs.diagnose import score", "compare", {"diagnose"}),
        ("from mphygs import _core, capture", "scene", set()),
        ("from mphygs import fit_command", "scene", {"fit_command"}),
        ("from mphygs.compare import noise", "report", set()),
        ("import mphygsical", "capture", set()),
    ],
)
def test_finds_every_kind_of_import(source: str, package: str, expected: set[str]) -> None:
    assert violations(source, package) == expected


def test_looks_at_the_package() -> None:
    assert len(modules()) > 20

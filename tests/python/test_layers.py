"""Data flows one way: no package imports one after it; the commands alone parse, print and exit."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mphygs.commands.command_table import COMMANDS

ROOT = Path(__file__).resolve().parents[2] / "python" / "mphygs"
# What `python -m` runs: every __main__.py, and the modules that stand beside the packages.
ENTRY = "__main__"
LAYERS = (
    "_load_core", "_core", "capture", "scene", "render", "motion", "model", "simulate", "compare", "fit",
    "diagnose", "extend", "baselines", "synth", "report", "batch", "commands", "api", "__init__", ENTRY,
)  # fmt: skip
# Modules that read command lines or write to terminals, and names that do.
PARSERS = {"argparse", "click", "getopt", "optparse", "rich", "tyro"}
FUNCTIONS = {"breakpoint", "exit", "input", "print", "quit", "SystemExit"}
ATTRIBUTES = {
    "sys": {"argv", "exit", "stderr", "stdin", "stdout", "__stderr__", "__stdin__", "__stdout__"},
    "os": {"_exit"},
}


def modules() -> list[Path]:
    return sorted(ROOT.rglob("*.py"))


def layer_of(path: Path) -> str:
    """The layer of a module, by its path below the package."""
    names = path.relative_to(ROOT).with_suffix("").parts
    alone = len(names) == 1 and names[0] not in LAYERS
    return ENTRY if alone or names[-1] == ENTRY else names[0]


def package_of(path: Path) -> str:
    """The package that relative imports of a module are meant from."""
    return ".".join(("mphygs", *path.relative_to(ROOT).parts[:-1]))


def imported(source: str, package: str) -> set[str]:
    """Layers that a module of a package imports, wherever the import stands."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            stem = package.split(".")[: len(package.split(".")) + 1 - node.level] if node.level else []
            stem += node.module.split(".") if node.module else []
            names = [".".join([*stem, alias.name]) for alias in node.names]
        for name in names:
            first, *parts = name.split(".")
            if first == "mphygs" and parts:
                found.add(ENTRY if ENTRY in parts else parts[0])
    return found


def violations(source: str, package: str, layer: str) -> set[str]:
    """Layers, or names that are none, that a module of a layer imports and may not."""
    return imported(source, package) - set(LAYERS[: LAYERS.index(layer) + 1])


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_only_what_stands_above(path: Path) -> None:
    layer = layer_of(path)
    assert layer in LAYERS, f"{layer} is no package of the architecture: {', '.join(LAYERS)}"
    wrong = violations(path.read_text(encoding="utf-8"), package_of(path), layer)
    assert not wrong, f"{layer} stands above or beside {', '.join(sorted(wrong))} and may not import it"


@pytest.mark.parametrize(
    ("source", "package", "expected"),
    [
        ("import mphygs.fit.start", "capture", {"fit"}),
        ("import numpy, mphygs.report", "fit", {"report"}),
        ("from mphygs.fit import start", "scene", {"fit"}),
        ("from mphygs import fit, capture", "scene", {"fit"}),
        ("from ..fit.start import x", "scene", {"fit"}),
        ("from ...report import page", "synth.flower", {"report"}),
        ("from .. import make", "synth.flower", set()),
        ("from .. import fit", "scene", {"fit"}),
        ("from . import rays", "scene", set()),
        ("from .rays import hit", "scene", set()),
        ("def f():\n    from mphygs.diagnose import score", "compare", {"diagnose"}),
        ("from mphygs import _core, capture", "scene", set()),
        ("from mphygs import fit_command", "scene", {"fit_command"}),
        ("from mphygs.fit.__main__ import main", "api", {"__main__"}),
        ("import mphygs.discover", "api", {"discover"}),
        ("from mphygs.commands.fit import fitted", "batch", {"commands"}),
        ("from mphygs.api.fitting import fit", "commands", {"api"}),
        ("from mphygs.compare import noise", "report", set()),
        ("import mphygsical", "capture", set()),
    ],
)
def test_finds_every_kind_of_import(source: str, package: str, expected: set[str]) -> None:
    assert violations(source, f"mphygs.{package}", package.split(".")[0]) == expected


def test_every_package_is_a_layer_and_every_layer_is_there() -> None:
    assert {layer_of(path) for path in modules()} == set(LAYERS)


def command_line(source: str) -> list[str]:
    """What of a module belongs to the command line: parsers, streams, exits."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.split(".")[0] in PARSERS]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            if node.module.split(".")[0] in PARSERS:
                found.append(node.module)
            wrong = ATTRIBUTES.get(node.module, set())
            found += [f"{node.module}.{alias.name}" for alias in node.names if alias.name in wrong]
        elif isinstance(node, ast.Name) and node.id in FUNCTIONS and isinstance(node.ctx, ast.Load):
            found.append(node.id)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.attr in ATTRIBUTES.get(node.value.id, set()):
                found.append(f"{node.value.id}.{node.attr}")
    return found


@pytest.mark.parametrize(
    "path",
    [path for path in modules() if layer_of(path) not in ("commands", ENTRY)],
    ids=lambda path: str(path.relative_to(ROOT)),
)
def test_a_library_neither_parses_nor_prints_nor_exits(path: Path) -> None:
    assert command_line(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("def f():\n    print(1)", ["print"]),
        ("f(report=print)", ["print"]),
        ("import sys\nsys.stderr.write('a')", ["sys.stderr"]),
        ("from sys import stdout, path", ["sys.stdout"]),
        ("raise SystemExit(2)", ["SystemExit"]),
        ("sys.exit(main())", ["sys.exit"]),
        ("import tyro", ["tyro"]),
        ("from rich.progress import Progress", ["rich.progress"]),
        ("reprint(sys.executable, text.print)", []),
    ],
)
def test_finds_what_belongs_to_the_command_line(source: str, expected: list[str]) -> None:
    assert command_line(source) == expected


# All alike: a command's entry, a baseline's fit, motion and first weights, what errors a layer raises.
ALIKE = {"main", "fit", "maker", "starting_weights", "errors.py"}


def test_one_name_means_one_thing() -> None:
    files: dict[str, list[str]] = {}
    names: dict[str, list[str]] = {}
    for path in modules():
        place = str(path.relative_to(ROOT))
        # What python -m runs is named after the command, the interface after what it calls.
        if layer_of(path) == ENTRY or path.stem == "__init__":
            continue
        files.setdefault(path.name, []).append(place)
        if layer_of(path) == "api":
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
                names.setdefault(node.name, []).append(place)
    found = {**files, **names}
    assert not {name: where for name, where in found.items() if len(where) > 1 and name not in ALIKE}


def test_what_python_runs_calls_a_command_and_nothing_else() -> None:
    shape = re.compile(
        r"import sys\nfrom mphygs\.commands\.(\w+) import main\n"
        r"if __name__ == '__main__':\n    sys\.exit\(main\(\)\)"
    )
    called = {}
    for path in modules():
        if layer_of(path) == ENTRY:
            tree = ast.parse(path.read_text(encoding="utf-8"))
            tree.body = tree.body[1:]
            found = shape.fullmatch(ast.unparse(tree))
            assert found is not None, f"{path}: does more than call a command"
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(ENTRY).rstrip(".")
            called[name] = found[1]
    expected = {name: name for name in COMMANDS} | {"": "command_table", "synth.flower": "synth_flower"}
    assert called == expected


def test_what_works_on_markers_loads_no_torch() -> None:
    """It takes nearly as long to load as all else, and every run of a batch is a process of its own."""
    names = ("batch", "compare", "diagnose", "discover", "doctor", "extend", "fit", "predict", "report")
    lines = [f"import mphygs.commands.{name}" for name in names]
    lines += ["import sys", "sys.exit('torch' in sys.modules)"]
    assert subprocess.run([sys.executable, "-c", "\n".join(lines)], check=False).returncode == 0

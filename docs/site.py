"""What the site makes of the package itself: the front page, every effect, every command, the interface.

A hook of MkDocs (`mkdocs build --strict`); the pages made here stand in no file, so they cannot grow stale.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import itertools
import re
import sys
from dataclasses import MISSING, fields
from pathlib import Path

from mkdocs.structure.files import File, Files

import mphygs
from mphygs.commands.command_table import COMMANDS, module_of
from mphygs.model.descriptor import EffectSpec
from mphygs.model.registry import effects, faults, material_effects

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs"))

from effect_pictures import picture, pictured  # noqa: E402

SITES = {
    "volume": "in every point of the material",
    "body": "on every point of the body",
    "surface": "on the exposed surface",
    "point": "at one place",
    "mass": "at one place, as inertia and weight",
    "hold": "between the object and what holds it",
    "material": "on what the material is",
    "measurement": "on what is seen of the motion, not on the motion",
}


def on_files(files: Files, config: object) -> Files:
    """Add the pages that are made here."""
    pages = {
        "index.md": front_page(),
        "every-effect.md": effects_page(),
        "commands.md": commands_page(),
        "interface.md": interface_page(),
    }
    for path, content in pages.items():
        files.append(File.generated(config, path, content=content))
    for name in pictured():
        if name in effects():
            files.append(File.generated(config, _picture_of(name), content=picture(name)))
    return files


def _picture_of(name: str) -> str:
    return f"images/effects/{name}.svg"


def on_page_markdown(markdown: str, **_: object) -> str:
    """Links to files of the repository become their names: the site holds the documentation alone."""
    return re.sub(r"\[([^\]]+)\]\(\.\./[^)]+\)", r"\1", markdown)


def front_page() -> str:
    """The repository's README, with its links to the documentation turned into the site's."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    text = text.replace("](docs/", "](")
    return re.sub(r"(?<![\[\w/(])docs/([\w-]+\.md)", r"[\1](\1)", text)


def effects_page() -> str:
    """All effects by their descriptors."""
    lines = ["# Every effect", "", "As the registry of this build describes them."]
    lines += ["An effect whose numbers are at their null is absent. Pictures are of a bar clamped at x = 0,"]
    lines += ["let go and shaken, with the effect (line, crosses) and without (dashed, circles): the point"]
    lines += ["that differs most, and all points at that time."]
    lines += ["`mphygs synth bar --hidden NAME` makes captures of them.", ""]
    for name, spec in effects().items():
        lines += [f"## {name}", "", f"`{spec.summary}`", ""]
        if words := source_words(spec):
            lines += ["```text", words, "```", ""]
        if name in pictured():
            lines += [f"![a bar without and with {name}]({_picture_of(name)})", ""]
        lines.append(f"Acts {SITES.get(spec.site, spec.site)}; {spec.kind}.")
        if spec.history:
            lines.append(f"It remembers: {spec.history} numbers a point.")
        if spec.settings:
            lines.append(f"It needs {', '.join(spec.settings)}.")
        if spec.not_with_mls:
            lines.append(f"Not with the MLS-MPM transfer: {spec.not_with_mls}.")
        if spec.parameters:
            head = "| number | unit | null | bounds | usual size | fitted | role |"
            lines += ["", head, "|" + " --- |" * 7]
            lines += [
                f"| {p.name} | {p.unit} | {p.null:g} | {p.lower:g} to {p.upper:g} | {p.scale:g} | "
                f"{'yes' if p.fitted else 'no'} | {p.role} |"
                for p in spec.parameters
            ]
        lines.append("")
    return "\n".join(lines)


def source_words(spec: EffectSpec) -> str:
    """What stands above an effect in its own file: formula and source. Empty where the file is not here."""
    if spec.in_core:
        path = ROOT / "cpp" / "include" / "mphygs" / "effects" / f"{spec.name}.hpp"
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        head = itertools.takewhile(lambda line: line.startswith("//"), text.splitlines())
        return "\n".join(line.removeprefix("//").removeprefix(" ") for line in head).strip()
    known = {e.name: e for e in (*faults(), *material_effects())}
    if spec.name not in known:
        return ""
    return (importlib.import_module(type(known[spec.name]).__module__).__doc__ or "").strip()


def commands_page() -> str:
    """All commands with their options, from the dataclasses that they read."""
    lines = ["# Commands", "", "`mphygs NAME --help` says the same.", ""]
    for name, summary in COMMANDS.items():
        options = getattr(module_of(name), f"{name.capitalize()}Options")
        told = _told_of(options)
        lines += [f"## {name}", "", f"{summary[:1].upper()}{summary[1:]}.", ""]
        for field in fields(options):
            if field.name in ("json", "plugin"):
                continue
            needed = field.default is MISSING and field.default_factory is MISSING
            default = "" if needed or field.default in (None, False) else f" (default: `{field.default}`)"
            flag = field.name.replace("_", "-")
            lines.append(f"- `{flag}`{' (needed)' if needed else default}: {told.get(field.name, '')}")
        lines.append("")
    lines += ["All of them take `--json` (one JSON object on standard output) and `--plugin FILE`.", ""]
    return "\n".join(lines)


def _told_of(options: type) -> dict[str, str]:
    """What stands below each option in the source."""
    own = ast.parse(inspect.getsource(options)).body[0]
    assert isinstance(own, ast.ClassDef)
    told = {}
    for before, after in zip(own.body[:-1], own.body[1:], strict=True):
        if isinstance(before, ast.AnnAssign) and isinstance(after, ast.Expr):
            told[before.target.id] = " ".join(str(after.value.value).split())
    return told


def interface_page() -> str:
    """The names of `mphygs`, each from its docstring."""
    where = {**mphygs._WHERE, **mphygs._CALLED}
    lines = ["# Interface in Python", "", "How they go together: [From Python](python.md).", ""]
    for name in mphygs.__all__:
        function = getattr(importlib.import_module(where[name]), name)
        lines += [f"::: {function.__module__}.{function.__qualname__}", ""]
    return "\n".join(lines)

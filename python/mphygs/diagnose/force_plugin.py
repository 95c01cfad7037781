"""A formula as an effect in Python: the file with which it is added to the model."""

from __future__ import annotations

from collections.abc import Sequence

from mphygs.diagnose.force_features import KINDS, Feature
from mphygs.diagnose.force_formula import Formula

EFFECT = "missing_force"
AWAY = [
    "def away(position, place, core):",
    '    """(x - p) / |x - p|^3, finite within the core."""',
    "    arm = position - position.new_tensor(place)",
    "    return arm / (arm.square().sum(-1, keepdim=True) + core**2) ** 1.5",
    "",
    "",
]


def plugin_text(formula: Formula, features: Sequence[Feature], part_names: Sequence[str]) -> str | None:
    """The file that registers the formula as the effect `missing_force`, its coefficients to be fitted.

    None where there is no formula, or a term of it needs what an effect in Python is not shown.
    """
    if not formula.terms or any(KINDS[f.kind].code is None for f in features):
        return None
    specs, lines = [], []
    for number, (term, feature) in enumerate(zip(formula.terms, features, strict=True), start=1):
        size = float(f"{max(abs(term.coefficient), 1e-6):.2g}")
        limits = f"lower={-1e3 * size!r}, upper={1e3 * size!r}, scale={size!r}"
        specs.append(f'        ParameterSpec("c_{number}", "{feature.unit}", null=0.0, {limits}),')
        force = KINDS[feature.kind].code(feature.numbers)
        inside = ""
        if feature.part is not None:
            lines.append(f"        # on part {feature.part}")
            inside = f" * (state.part == {list(part_names).index(feature.part)})[:, None]"
        lines.append(f'        force = force + parameters["c_{number}"] * {force}{inside}')
    body = "\n".join(lines)
    text = [f'"""{formula.text} [N/kg], as an effect of the model."""', ""]
    if "math." in body:
        text += ["import math", ""]
    text += ["from mphygs.model.registry import ParameterSpec"]
    text += ["from mphygs.model.user_effect import register_effect", "", ""]
    if "away(" in body:
        text += AWAY
    text += ["@register_effect", "class MissingForce:"]
    text += ['    """A force whose formula the diagnosis proposed."""', "", f'    name = "{EFFECT}"']
    text += ["    parameters = (", *specs, "    )", "", "    def force(self, state, parameters):"]
    text += ["        mass, force = state.mass[:, None], 0.0"]
    if "speed" in body:
        text += ["        speed = (state.velocity.square().sum(-1, keepdim=True) + 1e-12).sqrt()"]
    return "\n".join([*text, *lines, "        return force", ""])

"""A belief as JSON, number for number, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from mphygs.model.belief import Belief, LikenessPrior, Parameter, Term
from mphygs.model.registry import effects

# Absent where they have these values: JSON has no infinity.
_ABSENT = {"lower": -math.inf, "upper": math.inf, "prior_std": math.inf, "widest": None}


def plain_value(value: object) -> object:
    """A value with arrays, tuples and mappings as JSON knows them. Raises TypeError for anything else."""
    if isinstance(value, Mapping):
        return {str(key): plain_value(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain_value(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"{type(value).__name__} cannot be kept in a run")


def document_of_belief(belief: Belief) -> dict[str, object]:
    """Everything of a belief; floats keep all their bits."""
    parameters = []
    for parameter in belief.parameters:
        entry = asdict(parameter)
        for key, usual in _ABSENT.items():
            if entry[key] == usual:
                del entry[key]
        parameters.append(plain_value(entry))
    document = {
        "parts": list(belief.parts),
        "gravity": np.asarray(belief.gravity, float).tolist(),
        "parameters": parameters,
        "terms": [{"name": term.name, "settings": plain_value(term.settings)} for term in belief.terms],
        "prestress": belief.prestress,
        "law": belief.law,
        "known_mass": belief.known_mass,
    }
    if belief.likenesses:
        document["likenesses"] = [plain_value(asdict(likeness)) for likeness in belief.likenesses]
    return document


def belief_from_document(document: Mapping[str, object]) -> Belief:
    """The belief that `document_of_belief` wrote. Raises KeyError, TypeError or ValueError if not, or where
    an effect has been given a parameter since."""
    parameters = tuple(Parameter(**entry) for entry in document["parameters"])
    terms = tuple(Term(entry["name"], entry["settings"]) for entry in document["terms"])
    keys = {parameter.key for parameter in parameters}
    for term in terms:
        for p in effects()[term.name].parameters if term.name in effects() else ():
            if f"{term.name}.{p.name}" not in keys:
                raise ValueError(f"parameters: expected {term.name}.{p.name} among them")
    return Belief(
        parts=tuple(document["parts"]),
        gravity=np.array(document["gravity"], float),
        parameters=parameters,
        terms=terms,
        prestress=document["prestress"],
        law=document["law"],
        known_mass=document["known_mass"],
        likenesses=tuple(
            LikenessPrior(tuple(entry["keys"]), tuple(entry["coefficients"]), entry["std"])
            for entry in document.get("likenesses", ())
        ),
    )

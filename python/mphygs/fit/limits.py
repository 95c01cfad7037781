"""How far numbers can be moved until the data object, and what a number is told as of which they do on one
side alone: a bound, in place of a value with a standard error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from mphygs.fit.determined import SAYS_NOTHING, determinations, reference_std
from mphygs.model.belief import Parameter

# Of the noise [sigma]: a model that leaves more determines nothing, however well the motion would tell it.
FAR = 5.0


@dataclass(frozen=True)
class Limits:
    """Factors nearest to 1 on how far a number is from its null that are excluded, on either side; None where
    none is.

    phases: whether vibrations of other phases, at stiffnesses between them, fit as well; leaps: whether the
    motion goes by leaps where the derivatives at the minimum promise a steady change; weak: whether a number
    that is as small as may be is told by its standard error as well as any: one that is not in logarithms;
    null: where there is nothing of it, in its unit.
    """

    soft: float | None
    stiff: float | None
    phases: bool = False
    leaps: bool = False
    weak: bool = False
    null: float = 0.0

    @property
    def one_sided(self) -> bool:
        """Whether one side is excluded, and not the other."""
        return (self.soft is None) != (self.stiff is None)

    @property
    def seen(self) -> bool:
        """Whether both are, and nothing between them fits as well."""
        closed = self.stiff is not None and (self.weak or self.soft is not None)
        return closed and not (self.phases or self.leaps)

    @property
    def there(self) -> bool:
        """Whether the data say anything of it."""
        return self.soft is not None or self.stiff is not None

    def bound(self, value: float) -> dict[str, float]:
        """{"lower": ...}, {"upper": ...} or both of a number that is not seen, in its unit."""
        if self.seen:
            return {}
        ends = [self.null + f * (value - self.null) for f in (self.soft, self.stiff) if f is not None]
        return {"lower" if end < value else "upper": end for end in ends}

    def words(self, key: str, value: float, unit: str) -> str:
        """The same as a remark, "" where there is no bound."""
        bound = self.bound(value)
        leaps = "the motion goes by leaps there, no standard error is known" if self.leaps else ""
        if len(bound) == 2:
            ends = " and ".join(f"{end:.2g}" for end in sorted(bound.values()))
            why = leaps or "vibrations of several phases fit as well"
            return f"between {ends} {unit}: {why}"
        for side, end in bound.items():
            less = self.soft is not None
            if key.endswith(".youngs_modulus"):
                much = "softer would move more" if less else "stiffer would move less"
                why = f"what is {much} than is seen"
            else:
                why = f"{'less' if less else 'more'} of it does not fit"
            return f"{'at least' if side == 'lower' else 'at most'} {end:.2g} {unit}: {leaps or why}"
        return leaps


def narrowed_to_seen(
    free: Sequence[Parameter], information: np.ndarray, covariance: np.ndarray, limits: Mapping[str, Limits]
) -> tuple[np.ndarray, np.ndarray]:
    """Information and covariance, (P, P) each, that know as little of a number that is not seen as before the
    data; what they do not determine anyway stays as it is."""
    covariance, information = covariance.copy(), information.copy()
    known = determinations(free, information, covariance)
    for index, p in enumerate(free):
        if p.key not in limits or limits[p.key].seen or not known[p.key].determined:
            continue
        wide = reference_std(p) / np.sqrt(max(covariance[index, index], 1e-300))
        covariance[index] *= max(wide, 1.0)
        covariance[:, index] *= max(wide, 1.0)
        information[index], information[:, index] = 0.0, 0.0
    return information, covariance


def with_bounds(
    parameters: Mapping[str, Mapping[str, object]], limits: Mapping[str, Limits]
) -> dict[str, dict[str, object]]:
    """The parameters that are not determined with their bounds, and a note that says them."""
    told = {key: dict(entry) for key, entry in parameters.items()}
    for key, entry in told.items():
        if key not in limits or entry["determined"]:
            continue
        if note := limits[key].words(key, entry["value"], entry["unit"]):
            said = str(entry.get("note", "")).replace(SAYS_NOTHING, "")
            if bound := limits[key].bound(entry["value"]):
                entry["bound"] = bound
            entry["note"] = f"{said}; {note}".lstrip("; ")
    return told


def limits_document(limits: Mapping[str, Limits]) -> dict[str, dict[str, object]]:
    """As JSON."""
    return {key: asdict(found) for key, found in limits.items()}


def limits_from_document(document: Mapping[str, Mapping[str, object]]) -> dict[str, Limits]:
    """From such JSON, whose keys and values have been looked at."""
    names = Limits.__dataclass_fields__
    return {key: Limits(**{n: v for n, v in told.items() if n in names}) for key, told in document.items()}

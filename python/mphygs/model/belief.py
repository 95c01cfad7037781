"""What is believed of an object: its materials and effects, as named numbers with bounds and priors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mphygs.model.registry import USUAL_LAW, effect, laws

PRESTRESS_MODES = ("off", "paper", "equilibrium")


@dataclass(frozen=True)
class Parameter:
    """One number. key: "<part>.youngs_modulus" or "<effect>.<parameter>".

    value, lower, upper: in `unit`; log: fitted in its logarithm; free: fitted at all;
    prior_std: standard deviation about `prior_mean`, of the logarithm where log (inf: none);
    scale: a usual size of the change of a parameter that is not in logarithms;
    widest: the bounds before a fit narrowed them, None where none did.
    """

    key: str
    value: float
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    log: bool = False
    free: bool = True
    prior_mean: float = 0.0
    prior_std: float = math.inf
    scale: float = 1.0
    widest: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.widest is not None:
            object.__setattr__(self, "widest", tuple(self.widest))
        if not self.lower <= self.value <= self.upper:
            raise ValueError(f"{self.key} = {self.value} {self.unit}: expected {self.lower} to {self.upper}")
        if self.log and self.lower <= 0:
            raise ValueError(f"{self.key}: a parameter in logarithms needs a positive lower bound")

    @property
    def coordinate(self) -> float:
        """The number that optimisers see: ln(value), or value / scale."""
        return math.log(self.value) if self.log else self.value / self.scale

    def at(self, coordinate: float) -> Parameter:
        """This parameter moved to a coordinate, kept within its bounds."""
        value = math.exp(min(coordinate, 700.0)) if self.log else coordinate * self.scale
        return replace(self, value=float(min(max(value, self.lower), self.upper)))

    def narrowed(self, factor: float) -> Parameter:
        """This parameter kept within a factor of its value, as far as its widest bounds allow."""
        widest = self.widest or (self.lower, self.upper)
        lower, upper = max(widest[0], self.value / factor), min(widest[1], self.value * factor)
        return replace(self, lower=lower, upper=upper, widest=widest)

    def widened(self) -> Parameter:
        """This parameter with the bounds that it had before a fit narrowed them."""
        if self.widest is None:
            return self
        return replace(self, lower=self.widest[0], upper=self.widest[1], widest=None)

    def found(self, other: Parameter) -> Parameter:
        """This parameter where another fit found it: within that fit's bounds if those are about a scale of
        its own, else as near as these bounds allow."""
        if other.widest is not None:
            return replace(self, value=other.value, lower=other.lower, upper=other.upper, widest=other.widest)
        return replace(self, value=float(min(max(other.value, self.lower), self.upper)))

    @property
    def at_bound(self) -> bool:
        """Whether the value stands at one of its bounds."""
        bounds = [v for v in (self.lower, self.upper) if math.isfinite(v)]
        return any(abs(self.coordinate - replace(self, value=v).coordinate) < 1e-9 for v in bounds)

    @property
    def slope(self) -> float:
        """d value / d coordinate."""
        return self.value if self.log else self.scale

    @property
    def prior_residual(self) -> tuple[float, float]:
        """Residual of the prior and its derivative by the coordinate; (0, 0) without one."""
        if not math.isfinite(self.prior_std):
            return 0.0, 0.0
        deviation = math.log(self.value) - self.prior_mean if self.log else self.value - self.prior_mean
        return deviation / self.prior_std, (1.0 if self.log else self.scale) / self.prior_std


@dataclass(frozen=True)
class Term:
    """One effect in a model, with the constants that place or direct it.

    settings: "place" (3,) [m] for effects at a place, "part" name and "axis" (3,) for gradients, "instead_of"
    the law that another one has taken the place of.
    """

    name: str
    settings: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class LikenessPrior:
    """A prior on several parameters together: the sum of coefficients times logarithms of values is zero,
    give or take std."""

    keys: tuple[str, ...]
    coefficients: tuple[float, ...]
    std: float

    def __post_init__(self) -> None:
        if len(self.keys) != len(self.coefficients) or not self.std > 0:
            raise ValueError(
                f"likeness of {', '.join(self.keys)}: expected a coefficient each, std above zero"
            )


@dataclass(frozen=True)
class Belief:
    """Materials and effects of one object. Free parameters keep the order of `parameters`."""

    parts: tuple[str, ...]
    gravity: np.ndarray
    parameters: tuple[Parameter, ...]
    terms: tuple[Term, ...] = ()
    prestress: str = "off"
    law: str = USUAL_LAW
    known_mass: float | None = None
    likenesses: tuple[LikenessPrior, ...] = ()

    def __post_init__(self) -> None:
        if self.prestress not in PRESTRESS_MODES:
            raise ValueError(f"prestress '{self.prestress}': expected one of {', '.join(PRESTRESS_MODES)}")
        if self.law not in laws():
            raise ValueError(f"law '{self.law}': expected one of {', '.join(laws())}")
        for term in self.terms:
            if term.name in laws() and term.name != self.law:
                raise ValueError(f"law '{self.law}': expected '{term.name}', which is among the effects")
        keys = [p.key for p in self.parameters]
        if len(set(keys)) != len(keys):
            raise ValueError("parameter keys must be unique")
        positive = {p.key for p in self.parameters if p.lower > 0.0}
        for likeness in self.likenesses:
            for key in likeness.keys:
                if key not in positive:
                    raise ValueError(f"likeness: '{key}' is no parameter that is above zero")

    def __getitem__(self, key: str) -> Parameter:
        for parameter in self.parameters:
            if parameter.key == key:
                return parameter
        raise KeyError(key)

    def __contains__(self, key: str) -> bool:
        return any(parameter.key == key for parameter in self.parameters)

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are fitted, in the order of `coordinates`."""
        return tuple(p for p in self.parameters if p.free)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the model, in the order in which they were added."""
        return tuple(term.name for term in self.terms)

    @property
    def chosen_law(self) -> str | None:
        """The law where it is an effect of the model, in the place of the one that was given."""
        return self.law if self.law in self.effects else None

    @property
    def numbers(self) -> int:
        """Numbers that the data had to tell: those that are fitted, and one for a law that was chosen."""
        return len(self.free) + (self.chosen_law is not None)

    def term(self, name: str) -> Term:
        """The term of an effect. Raises KeyError where the model has none of it."""
        for term in self.terms:
            if term.name == name:
                return term
        raise KeyError(name)

    def values_of(self, name: str) -> dict[str, float]:
        """The numbers of an effect in the model, by their names. Raises KeyError where it has none of it."""
        return {p.name: self[f"{name}.{p.name}"].value for p in effect(name).parameters}

    @property
    def coordinates(self) -> np.ndarray:
        """(P,) of the free parameters."""
        return np.array([p.coordinate for p in self.free])

    def likeness_rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (L,) of the likenesses, and their derivative (L, P) by the free coordinates."""
        column = {p.key: k for k, p in enumerate(self.free)}
        residual, slope = np.zeros(len(self.likenesses)), np.zeros((len(self.likenesses), len(column)))
        by_key = {p.key: p for p in self.parameters}
        for row, likeness in enumerate(self.likenesses):
            for key, coefficient in zip(likeness.keys, likeness.coefficients, strict=True):
                residual[row] += coefficient * math.log(by_key[key].value) / likeness.std
                if key in column:
                    relative = by_key[key].slope / by_key[key].value
                    slope[row, column[key]] += coefficient * relative / likeness.std
        return residual, slope

    def at(self, coordinates: np.ndarray) -> Belief:
        """This belief with the free parameters moved to (P,) coordinates."""
        moved = iter(coordinates)
        return replace(
            self, parameters=tuple(p.at(float(next(moved))) if p.free else p for p in self.parameters)
        )

    def with_parameter(self, key: str, **changes: object) -> Belief:
        """This belief with one parameter changed. Raises KeyError when there is none of that key."""
        _ = self[key]
        return replace(
            self, parameters=tuple(replace(p, **changes) if p.key == key else p for p in self.parameters)
        )

    def with_effect(
        self,
        name: str,
        values: Mapping[str, float] | None = None,
        settings: Mapping[str, object] | None = None,
    ) -> Belief:
        """This belief with an effect added; its fitted parameters become free.

        values: starting values of any of its parameters; the rest start at their null.
        Raises KeyError for an unknown effect, ValueError when it is there already, or is a law beside which
        there is no other one.
        """
        spec = effect(name)
        if name in self.effects or name == self.law:
            raise ValueError(f"effect '{name}' is in the model already")
        if spec.site == "law":
            if self.chosen_law is not None:
                raise ValueError(f"law '{name}': '{self.law}' has been chosen; expected no other one")
            return replace(self, law=name, terms=(*self.terms, Term(name, {"instead_of": self.law})))
        if spec.carries_gravity:
            return replace(self, prestress="equilibrium")
        added = []
        for p in spec.parameters:
            value = float((values or {}).get(p.name, p.null))
            log = p.fitted and p.null != 0.0 and p.lower > 0.0
            added.append(
                Parameter(
                    f"{name}.{p.name}",
                    value,
                    p.unit,
                    p.lower,
                    p.upper,
                    log=log,
                    free=p.fitted,
                    scale=p.scale,
                    prior_mean=math.log(p.null) if log else 0.0,
                    prior_std=3.0 if log else math.inf,
                )
            )
        return replace(
            self,
            parameters=self.parameters + tuple(added),
            terms=(*self.terms, Term(name, dict(settings or {}))),
        )

    def without_effect(self, name: str) -> Belief:
        """This belief with an effect taken away."""
        term = self.term(name)
        return replace(
            self,
            law=str(term.settings["instead_of"]) if name == self.law else self.law,
            parameters=tuple(p for p in self.parameters if not p.key.startswith(f"{name}.")),
            terms=tuple(t for t in self.terms if t.name != name),
        )

"""A formula for a missing force: sparse regression on what the markers show, not on the smoothed force.

Every feature stands there as the change of the markers that it makes; beside them stand the fitted
parameters, which may give way. Terms are added one by one while each takes away a good share of the misfit;
those that blocks of frames drawn again keep choosing stay (stability selection: Meinshausen and Buehlmann,
2010) and are fitted once more, alone. Features whose changes are all but parallel are one term.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# A term must take away this share of what is to be explained, and this many units of chi^2.
SMALLEST_SHARE, SMALLEST_DROP = 0.02, 30.0
LARGEST_FORMULA = 4
RESAMPLES, STABLE = 100, 0.7
# A rival chosen as often as this in a term's stead is named beside it.
RIVAL = 0.1
# Features that differ in less than this share of their squares are not told apart.
ALIKE = 0.02
# A formula is told where it takes away this share of what is to be explained, each of its coefficients at
# least so many standard errors from zero.
MOST, SURE = 0.5, 3.0


@dataclass(frozen=True)
class FormulaTerm:
    """One term of a formula. expression: what the coefficient multiplies; unit, std: of the coefficient;
    stability: share of the resamples that choose it or one of those alike, expressions not told from it."""

    index: int
    expression: str
    unit: str
    coefficient: float
    std: float
    stability: float
    alike: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The coefficient and what it multiplies."""
        return f"{self.coefficient:.3g} {self.expression}"


@dataclass(frozen=True)
class Formula:
    """terms: kept; explained: share of chi^2 beyond noise that they take away; unstable: what was chosen and
    did not stay, with the share of the resamples that chose it, the most often chosen first; untold: why
    terms that stayed are no formula, empty where there is one or none stayed."""

    terms: tuple[FormulaTerm, ...]
    explained: float
    unstable: tuple[tuple[str, float], ...]
    untold: str = ""

    @property
    def text(self) -> str:
        """One line, in N/kg."""
        if not self.terms:
            return "no stable formula"
        line = self.terms[0].text
        for term in self.terms[1:]:
            sign = "-" if term.coefficient < 0.0 else "+"
            line += f" {sign} {abs(term.coefficient):.3g} {term.expression}"
        return line


@dataclass(frozen=True, eq=False)
class Regression:
    """Sums over blocks, (B, ...): gram (K + P, K + P) of the columns, right (K + P,) with the data, square of
    the data, rows. The first K columns are features, the others parameters that are always in."""

    gram: np.ndarray
    right: np.ndarray
    square: np.ndarray
    rows: np.ndarray
    features: int

    @classmethod
    def of(
        cls, data: np.ndarray, features: np.ndarray, parameters: np.ndarray, block: np.ndarray
    ) -> Regression:
        """data: (N,), features: (N, K), parameters: (N, P), all whitened; block: (N,) of every row."""
        columns = np.hstack([features, parameters])
        _, index = np.unique(block, return_inverse=True)
        order = np.argsort(index, kind="stable")
        pieces = np.split(order, np.cumsum(np.bincount(index))[:-1])
        gram = np.array([columns[rows].T @ columns[rows] for rows in pieces])
        right = np.array([columns[rows].T @ data[rows] for rows in pieces])
        square = np.array([data[rows] @ data[rows] for rows in pieces])
        return cls(gram, right, square, np.array([len(r) for r in pieces]), features.shape[1])

    def weighted(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, int]:
        """Gram matrix, right side, square and rows with blocks taken (B,) times."""
        return (
            np.tensordot(weight, self.gram, axes=1),
            weight @ self.right,
            float(weight @ self.square),
            int(weight @ self.rows),
        )

    def chosen(self, weight: np.ndarray) -> tuple[int, ...]:
        """Features in the order in which they are added."""
        gram, right, square, rows = self.weighted(weight)
        always = list(range(self.features, len(right)))
        inside: list[int] = []
        left = square - _drop(gram, right, always)
        # What noise leaves is not to be explained; where the misfit is less, nothing is.
        whole = left - rows
        while len(inside) < LARGEST_FORMULA and whole > 0.0:
            drops = _next_drops(gram, right, always + inside)[: self.features]
            best = int(drops.argmax())
            if drops[best] < max(SMALLEST_SHARE * whole, SMALLEST_DROP):
                break
            inside.append(best)
        return tuple(inside)

    def best(self, count: int) -> list[int]:
        """The features that explain most, each alone beside the parameters, the best first."""
        gram, right, _, _ = self.weighted(np.ones(len(self.rows)))
        drops = _next_drops(gram, right, list(range(self.features, len(right))))[: self.features]
        return [int(k) for k in np.argsort(-drops)[:count]]

    def alike(self) -> np.ndarray:
        """(K, K) bool: features that cannot be told apart once the parameters have given way."""
        gram, _, _, _ = self.weighted(np.ones(len(self.rows)))
        mine, others = slice(0, self.features), slice(self.features, len(gram))
        left = gram[mine, mine].copy()
        if len(gram) > self.features:
            solved = np.stack([_solve(gram[others, others], column) for column in gram[mine, others]], axis=1)
            left -= gram[mine, others] @ solved
        length = np.sqrt(np.maximum(np.diag(left), 1e-300))
        return (left / np.outer(length, length)) ** 2 > 1.0 - ALIKE

    def fit(self, inside: Sequence[int], weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Coefficients of the features inside, shift of the parameters, and the share of chi^2 beyond noise
        that the features explain."""
        gram, right, square, rows = self.weighted(weight)
        always = list(range(self.features, len(right)))
        used = [*inside, *always]
        solution = _solve(gram[np.ix_(used, used)], right[used])
        before = square - _drop(gram, right, always)
        after = square - _drop(gram, right, used)
        share = float((before - after) / max(before - rows, 1e-12))
        return solution[: len(inside)], solution[len(inside) :], share


def _solve(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.linalg.lstsq(gram / np.outer(scale, scale), right / scale, rcond=1e-10)[0] / scale


def _drop(gram: np.ndarray, right: np.ndarray, used: Sequence[int]) -> float:
    """By how much these columns together lower chi^2."""
    if not len(used):
        return 0.0
    return float(right[list(used)] @ _solve(gram[np.ix_(used, used)], right[list(used)]))


def _next_drops(gram: np.ndarray, right: np.ndarray, used: list[int]) -> np.ndarray:
    """By how much each column would lower chi^2 beside those used; 0 where they have it nearly all."""
    own = np.diag(gram).copy()
    if used:
        mixed = gram[np.ix_(used, range(len(right)))]
        inner = gram[np.ix_(used, used)]
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        solved = np.linalg.lstsq(inner / np.outer(scale, scale), mixed / scale[:, None], rcond=1e-10)[0]
        left = right - (mixed / scale[:, None]).T @ np.linalg.lstsq(
            inner / np.outer(scale, scale), right[used] / scale, rcond=1e-10
        )[0]
        information = own - ((mixed / scale[:, None]) * solved).sum(0)
    else:
        left, information = right, own
    acts = information > 1e-4 * np.maximum(own, 1e-300)
    return np.where(acts, left**2 / np.where(acts, information, 1.0), 0.0)


def _spokesmen(alike: np.ndarray, order: Sequence[int], simple: Sequence[bool]) -> np.ndarray:
    """(K,) of every feature the one that speaks for it: the first in order of those alike, a simple one where
    there is any."""
    spokesman = np.full(len(alike), -1)
    for k in order:
        mine = alike[k] & (spokesman < 0)
        if mine.any():
            spokesman[mine] = next((j for j in order if mine[j] and simple[j]), k)
    return spokesman


def find_formula(
    regression: Regression,
    expressions: Sequence[str],
    units: Sequence[str],
    simple: Sequence[bool],
    *,
    generator: np.random.Generator,
) -> Formula:
    """The terms that explain the data and that blocks drawn again keep choosing.

    simple: features that speak for those that cannot be told from them. A term whose coefficient is not sure
    is left out, the least sure first, and terms that leave more than they explain are no formula.
    """
    blocks = len(regression.rows)
    alike = regression.alike()
    spokesman = _spokesmen(alike, regression.best(regression.features), simple)
    full = list(dict.fromkeys(int(spokesman[k]) for k in regression.chosen(np.ones(blocks))))
    counts = np.zeros(regression.features)
    draws = [np.bincount(generator.integers(blocks, size=blocks), minlength=blocks) for _ in range(RESAMPLES)]
    for draw in draws:
        counts[list({int(spokesman[k]) for k in regression.chosen(draw.astype(float))})] += 1
    frequency = counts / RESAMPLES
    kept = [k for k in full if frequency[k] >= STABLE]
    unstable = [
        (expressions[k], float(frequency[k]))
        for k in np.argsort(-frequency)
        if k not in kept and (frequency[k] >= RIVAL or k in full)
    ]
    untold = ""
    while kept:
        coefficients, _, explained = regression.fit(kept, np.ones(blocks))
        again = np.array([regression.fit(kept, draw.astype(float))[0] for draw in draws])
        std = again.std(0)
        sure = np.abs(coefficients) / np.maximum(std, 1e-300)
        least = int(sure.argmin())
        if sure[least] >= SURE and explained >= MOST:
            break
        if sure[least] < SURE:
            left_out = [kept[least]]
            untold = untold or f"{expressions[kept[least]]} is {sure[least]:.1f} standard errors from zero"
        else:
            left_out = kept
            terms = " and ".join(expressions[k] for k in kept)
            untold = f"{terms} would explain {max(explained, 0.0):.0%} of the misfit"
        unstable += [(expressions[k], float(frequency[k])) for k in left_out]
        kept = [k for k in kept if k not in left_out]
    unstable = tuple(sorted(unstable, key=lambda pair: -pair[1]))
    if not kept:
        return Formula((), 0.0, unstable, untold)
    terms = [
        FormulaTerm(
            k, expressions[k], units[k], float(c), float(s), float(frequency[k]),
            tuple(expressions[j] for j in np.flatnonzero(spokesman == k) if j != k),
        )  # fmt: skip
        for k, c, s in zip(kept, coefficients, std, strict=True)
    ]
    return Formula(tuple(terms), float(np.clip(explained, 0.0, 1.0)), unstable)

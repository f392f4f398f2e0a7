"""Fits the decisions of `detect` by penalised logistic regression, and judges them on kinds that a fit has not seen."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from experiments.decision.table import Row

KNOTS = 5  # of each curve, at quantiles from 2 to 98 %
# weights of squared second differences and of squared values: of three each the best left out
SMOOTH, PULL = 1e-4, 1e-3
MISSED = 10.0  # things that never move are found to be none later on, who is missed is not


class Decision(NamedTuple):
    """Log odds that something is a person, a sum of piecewise linear curves, one of each feature: knots and values.
    Outside its knots a curve is level."""

    at: Float[np.ndarray, "feature knot"]
    value: Float[np.ndarray, "feature knot"]

    def odds(self, table: Float[np.ndarray, "thing feature"]) -> Float[np.ndarray, " thing"]:
        """Logarithms of the odds that each thing is a person; a feature that is NaN tells nothing."""
        told = (np.nan_to_num(np.interp(x, *curve)) for x, *curve in zip(table.T, self.at, self.value))
        return sum(told, np.zeros(len(table)))


@dataclass(frozen=True)
class Table:
    """Rows to be fitted."""

    rows: Sequence[Row]

    @cached_property
    def features(self) -> Float[np.ndarray, "row feature"]:
        return np.array([row.features for row in self.rows])

    @cached_property
    def person(self) -> Bool[np.ndarray, " row"]:
        return np.array([row.person for row in self.rows])

    @cached_property
    def kind(self) -> np.ndarray:
        return np.array([row.kind for row in self.rows])

    @cached_property
    def weight(self) -> Float[np.ndarray, " row"]:
        """In either class each kind counts the same, and each log of it; all together 1."""
        logs, weight = np.array([f"{row.kind} {row.log}" for row in self.rows]), np.zeros(len(self.rows))
        for label in (True, False):
            kinds = np.unique(self.kind[self.person == label])
            for kind in kinds:
                mine = (self.kind == kind) & (self.person == label)
                names, which, count = np.unique(logs[mine], return_inverse=True, return_counts=True)
                weight[mine] = 0.5 / count[which] / len(names) / len(kinds)
        return weight

    def only(self, some: Bool[np.ndarray, " row"]) -> "Table":
        return Table([row for row, use in zip(self.rows, some) if use])

    def left_out(self) -> Float[np.ndarray, " row"]:
        """Log odds of each row by what all other kinds have fitted."""
        odds = np.zeros(len(self.rows))
        for kind in np.unique(self.kind):
            mine = self.kind == kind
            odds[mine] = fitted(self.only(~mine)).odds(self.features[mine])
        return odds


def fitted(table: Table) -> Decision:
    """The curves that fit best, by Newton's method."""
    at = np.stack([_knots(x) for x in table.features.T])
    size, unit = len(at) * KNOTS, np.eye(KNOTS)
    hats = [np.nan_to_num(np.stack([np.interp(x, a, row) for row in unit], 1)) for x, a in zip(table.features.T, at)]
    basis, bent = np.concatenate([*hats, np.ones((len(table.rows), 1))], 1), np.diff(unit, 2, axis=0)
    penalty = np.zeros((size + 1, size + 1))
    penalty[:size, :size] = np.kron(np.eye(len(at)), SMOOTH * bent.T @ bent + PULL * unit)
    w, step = np.zeros(size + 1), np.ones(size + 1)
    while np.abs(step).max() > 1e-6:
        p = 1 / (1 + np.exp(-basis @ w))
        gradient = basis.T @ (table.weight * (p - table.person)) + penalty @ w
        hessian = (basis * (table.weight * p * (1 - p))[:, None]).T @ basis + penalty
        step = np.linalg.solve(hessian, gradient)
        w -= step * min(1.0, 2 / np.abs(step).max())
    value = w[:size].reshape(len(at), KNOTS)
    value[0] += w[size]
    return Decision(at.round(4), value.round(4))


def _knots(x: Float[np.ndarray, " row"]) -> Float[np.ndarray, " knot"]:
    """Quantiles, a fiftieth of the range apart at least where many rows are alike."""
    at = np.nanquantile(x, np.linspace(0.02, 0.98, KNOTS))
    for k in range(1, KNOTS):
        at[k] = max(at[k], at[k - 1] + 0.02 * (np.nanmax(x) - np.nanmin(x)))
    return at


def least_odds(table: Table, odds: Float[np.ndarray, " row"]) -> float:
    """The log odds above which something is best taken for a person, if to miss one costs MISSED times as much as to
    take another thing."""
    order = np.argsort(odds)
    person = table.person[order]
    missed = np.cumsum(np.where(person, table.weight[order], 0))
    false = np.cumsum(np.where(person, 0, table.weight[order])[::-1])[::-1]
    return round(float(odds[order][1:][np.argmin(MISSED * missed[:-1] + false[1:])]), 2)

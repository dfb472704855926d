"""Surrogate of the online estimator: what its estimates are worth at an operating point.

It is fitted to runs of the real estimator on simulated blocks and kept as a small file. Each row holds one
operating point: the mean error of k, c and F_c, the covariance of the error around it, the standard
deviations that the estimator reports, and what else an estimate says. An operating point that no run met
takes the errors of the nearest row in units of the reported standard deviations, moved at random by what
neighbouring rows differ by (smoothed bootstrap). The reported standard deviations and the residual follow
from a regression over all rows: between two speeds of one machine they change little.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array

from .operating_point import SCALES

FILE = Path(__file__).with_name("surrogate.json")

#: Neighbours that a row's random part is drawn from.
NEIGHBOURS = 3


@dataclass(frozen=True, slots=True)
class SurrogateRow:
    """Estimates at one operating point.

    Attributes:
        features: of the operating point, see :func:`.operating_point.features`.
        tracking: share of the estimates that track.
        bias: mean error of k and c (relative) and of F_c over the first order's inertia force, shape (3,).
        sensitivity: of that to the relative gain error between the accelerometers, shape (3,).
        covariance: of the error around it, shape (3, 3).
        reported: standard deviations that the estimator reports, in the same units, shape (3,).
        spread: relative standard deviation of the reported ones from one estimate to the next.
        residual, residual_spread: mean and standard deviation of the relative residual.
        excitation, displacement: rms of the body, over the first order's amplitude, and of the relative
            displacement, over that amplitude divided by the natural angular frequency squared.

    """

    features: Array
    tracking: float
    bias: Array
    sensitivity: Array
    covariance: Array
    reported: Array
    spread: float
    residual: float
    residual_spread: float
    excitation: float
    displacement: float

    def to_dict(self) -> dict[str, Any]:
        """Return what the file holds: numbers to five significant digits."""
        return {
            "features": _digits(self.features),
            "tracking": round(self.tracking, 3),
            "bias": _digits(self.bias),
            "sensitivity": _digits(self.sensitivity),
            "covariance": [_digits(row) for row in self.covariance],
            "reported": _digits(self.reported),
            "spread": _digits(np.array([self.spread]))[0],
            "residual": _digits(np.array([self.residual, self.residual_spread])),
            "excitation": _digits(np.array([self.excitation]))[0],
            "displacement": _digits(np.array([self.displacement]))[0],
        }

    @classmethod
    def from_dict(cls, kept: dict[str, Any]) -> SurrogateRow:
        """Return the row that the file holds."""
        return cls(
            np.array(kept["features"]), kept["tracking"], np.array(kept["bias"]),
            np.array(kept["sensitivity"]), np.array(kept["covariance"]), np.array(kept["reported"]),
            kept["spread"], kept["residual"][0], kept["residual"][1], kept["excitation"],
            kept["displacement"],
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Surrogate:
    """All rows, and how errors develop over time.

    Attributes:
        origin: command, version and numbers of the runs it was fitted to.
        correlation: of the errors of neighbouring estimates, 1 s apart.
        start: s after a start before parameters track again.
        after_start, after_change: error over its usual size at each second after a start and after a change
            of speed, shapes (n,).

    """

    origin: str
    correlation: float
    start: int
    after_start: Array
    after_change: Array
    rows: tuple[SurrogateRow, ...]

    def row(
        self, features: Array, gain_error: float, offsets: Array, draw: np.random.Generator
    ) -> SurrogateRow:
        """Return the estimates at ``features``.

        Args:
            features: of the operating point.
            gain_error: of the spool's accelerometer; the bias includes what it makes.
            offsets: standard normal numbers of the valve, shape (4,): by how much its residual and its
                reported standard deviations depart from the regression.
            draw: source of chance.
        """
        made = _regression(self)
        distance = ((made.places - features / SCALES) ** 2).sum(axis=1)
        near = np.argpartition(distance, NEIGHBOURS)[:NEIGHBOURS]
        near = near[np.argsort(distance[near])]
        first = self.rows[int(near[0])]
        # What a gain error makes depends on damping and speed.
        alike = ((made.places[:, :2] - features[:2] / SCALES[:2]) ** 2).sum(axis=1)
        sensitivity = made.sensitivities[np.argpartition(alike, NEIGHBOURS)[:NEIGHBOURS]].mean(axis=0)
        around = made.biases[near]
        chance = draw.standard_normal(NEIGHBOURS) / math.sqrt(NEIGHBOURS - 1)
        moved = (around - around.mean(axis=0)).T @ chance
        told = np.exp(_terms(features[np.newaxis])[0] @ made.weights + offsets * made.departs)
        scale = told[1:] / first.reported
        return replace(
            first,
            bias=(around[0] + moved) * told[1:] + gain_error * sensitivity,
            sensitivity=sensitivity,
            covariance=first.covariance * np.outer(scale, scale),
            reported=told[1:],
            residual=float(told[0]),
            residual_spread=first.residual_spread * float(told[0]) / first.residual,
        )

    def write(self, path: Path) -> None:
        """Write the file."""
        kept = {
            "origin": self.origin,
            "correlation": round(self.correlation, 4),
            "start": self.start,
            "after_start": _digits(self.after_start),
            "after_change": _digits(self.after_change),
            "rows": [row.to_dict() for row in self.rows],
        }
        rows = ",\n".join(json.dumps(row) for row in kept.pop("rows"))  # type: ignore[attr-defined]
        head = json.dumps(kept, indent=1)[:-2]
        path.write_text(f'{head},\n "rows": [\n{rows}\n]}}\n', encoding="utf-8")


@dataclass(frozen=True, slots=True)
class _Regression:
    """Regression over all rows: scaled features, biases over reported deviations, sensitivities, weights."""

    places: Array
    biases: Array
    sensitivities: Array
    weights: Array
    departs: Array


@cache
def _regression(surrogate: Surrogate) -> _Regression:
    features = np.array([row.features for row in surrogate.rows])
    told = np.log([[row.residual, *row.reported] for row in surrogate.rows])
    terms = _terms(features)
    weights = np.linalg.lstsq(terms, told, rcond=None)[0]
    biases = np.array([row.bias / row.reported for row in surrogate.rows])
    sensitivities = np.array([row.sensitivity for row in surrogate.rows])
    departs = (told - terms @ weights).std(axis=0)
    return _Regression(features / SCALES, biases, sensitivities, weights, departs)


def _terms(features: Array) -> Array:
    """Return the terms of the regression, shape (n, 12)."""
    a, b, c, d = (features / SCALES).T
    below = (features[:, 1] < 1.0).astype(float)
    return np.column_stack([np.ones(a.size), a, b, c, d, a * b, b**2, a**2, c**2, d * b, c * a, below])


@cache
def load_surrogate(path: Path = FILE) -> Surrogate:
    """Return the surrogate that ``path`` holds.

    Raises:
        InputError: the file is missing or damaged.

    """
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        rows = tuple(SurrogateRow.from_dict(row) for row in kept["rows"])
        return Surrogate(
            kept["origin"], kept["correlation"], kept["start"], np.array(kept["after_start"]),
            np.array(kept["after_change"]), rows,
        )  # fmt: skip
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"{path}: not a surrogate ({error}); fit one: ./spool study operation-fit --out DIR"
        ) from error


def errors(row: SurrogateRow, correlation: float, sizes: Array, draw: np.random.Generator) -> Array:
    """Return errors of successive estimates, shape (n, 3), bias included.

    Args:
        row: the operating point.
        correlation: of neighbours.
        sizes: error over its usual size at each estimate, shape (n,).
        draw: source of chance.
    """
    from scipy.signal import lfilter  # noqa: PLC0415 - slow to load

    root = np.linalg.cholesky(row.covariance + 1e-18 * np.eye(3))
    fresh = draw.standard_normal((sizes.size, 3)) * math.sqrt(1.0 - correlation**2)
    begin = draw.standard_normal(3)
    noise, _ = lfilter([1.0], [1.0, -correlation], fresh, axis=0, zi=correlation * begin[np.newaxis])
    return np.asarray(row.bias + (noise @ root.T) * sizes[:, np.newaxis])


def _digits(values: Array | Sequence[float]) -> list[float]:
    return [float(f"{value:.4e}") for value in np.asarray(values, dtype=float)]

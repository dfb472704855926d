"""Sensor effects: what the spool's channel makes of the acceleration, one class in one file of the catalogue.

Screening takes its small change of the reading through the balance of forces, a fit distorts the simulated
acceleration by it; both need no more than :meth:`SensorEffect.reading`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from spool_estimator.identification.least_squares import Unknown
from spool_estimator.identification.spectra import ZeroPhase
from spool_sim.terms import Parameter

from .effect import Array, Effect, Motion


class SensorEffect(Effect):
    """Sensor effect of the spool's channel: its law, its numbers, and what it makes of an acceleration.

    Attributes:
        parameters: 0 where the channel is right; ``start`` is a typical size.
        equation: the reading as text.
    """

    kinds = ("accelerations",)
    picture = "samples"
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    equation: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        """Fit what the class declares."""
        super().__init_subclass__(**options)
        cls.fitted = tuple(parameter.name for parameter in cls.parameters)
        cls.amplitudes = cls.fitted if cls.searched else ()

    @abstractmethod
    def reading(self, acceleration: Array, period: float, values: Mapping[str, float], time: Array) -> Array:
        """Return what the channel reads, m/s^2, shape of ``acceleration`` (..., n).

        Args:
            acceleration: of the spool, a sample every ``period`` s.
            values: its parameters.
            time: of the samples, s from where laws count it, shape of ``acceleration`` or (n,).
        """

    @property
    def law(self) -> str:
        """Its law as text."""
        return self.equation

    @property
    def numbers(self) -> tuple[Parameter, ...]:
        """Its parameters."""
        return self.parameters

    def unknowns(self, values: Mapping[str, float], seconds: float) -> list[Unknown]:  # noqa: ARG002
        """Return its parameters, with steps of their typical sizes; none of one that is always fitted."""
        own = self.parameters if self.searched else ()
        return [Unknown(p.name, p.unit, p.low, p.high, p.start, absolute=True) for p in own]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the forces that the balance seems to lack, N over each parameter's unit, shape (q, n)."""
        if not self.searched or not motion.reading.size:
            return np.empty((0, motion.displacement.size))
        none = dict.fromkeys(self.fitted, 0.0)
        errors = np.array(
            [
                (self._read(motion, {**none, p.name: p.start}) - motion.reading) / p.start
                for p in self.parameters
            ]
        )
        return in_balance(motion, errors)

    def _read(self, motion: Motion, values: Mapping[str, float]) -> Array:
        return self.reading(motion.reading, motion.period, values, motion.time)

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],  # noqa: ARG002
        motion: Motion,  # noqa: ARG002
    ) -> dict[str, float] | None:
        """Return the parameters, within their bounds."""
        if not coefficients.size:
            return None
        pairs = zip(self.parameters, coefficients.tolist(), strict=True)
        return {p.name: float(np.clip(value, p.low, p.high)) for p, value in pairs}


def in_balance(motion: Motion, errors: Array) -> Array:
    """Return the force that the balance seems to lack by ``errors`` (q, n) of the reading, m/s^2, in N."""
    band = ZeroPhase(motion.period, motion.low_cut)
    once, twice = band.apply(errors, 1), band.apply(errors, 2)
    seen = motion.mass * band.apply(errors) + motion.damping * once + motion.stiffness * twice
    return np.asarray(-seen)

"""Effect of the catalogue: what its class says about it.

Each effect is one class in a file of ``catalogue/``. Its law is that of terms of :mod:`spool_sim.terms`; the
class states how to find it: its signature at a measured motion, where a fit starts, and with what it is
confusable. An effect of the spool's channel derives from :class:`SensorEffect`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.least_squares import Unknown
from spool_sim.terms import Parameter, term

#: Shares of the force that moves the spool with which an effect is tried.
SHARES = (0.02, 0.06, 0.15, 0.4)


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion at which signatures are worked out; every array has shape (n,).

    Attributes:
        displacement, velocity, acceleration: relative to the body, m, m/s, m/s^2.
        time: s, from where laws count it.
        period: s between samples.
        velocity_noise: rms, m/s: below it the sign of the velocity is not known.
        peaks: frequencies (Hz) that stand out of the residual and are not the excitation's.
        mass, stiffness, damping: of the base as fitted, kg, N/m, N s/m.
        reading: of the spool's channel, free of noise, m/s^2; empty where the record has none.
        low_cut: Hz, below which the motion is not known.
    """

    displacement: Array
    velocity: Array
    acceleration: Array
    time: Array
    period: float
    velocity_noise: float
    mass: float
    stiffness: float
    damping: float
    peaks: tuple[float, ...] = ()
    reading: Array = field(default_factory=lambda: np.empty(0))
    low_cut: float = 0.0

    @property
    def sign(self) -> Array:
        """Direction of the velocity, soft where a reversal falls within half a sample or into the noise."""
        width = np.maximum(0.5 * self.period * np.abs(self.acceleration), 2.0 * self.velocity_noise)
        return np.asarray(np.clip(self.velocity / np.maximum(width, 1e-12), -1.0, 1.0))

    @property
    def largest_displacement(self) -> float:
        """The 99.9 % quantile of abs(z), m."""
        return float(np.quantile(np.abs(self.displacement), 0.999))

    @property
    def largest_velocity(self) -> float:
        """The 99 % quantile of abs(z'), m/s."""
        return float(np.quantile(np.abs(self.velocity), 0.99))


@dataclass(frozen=True, slots=True)
class Scale:
    """Sizes of a motion.

    Attributes:
        force: that moves the spool, rms, N.
        travel: largest displacement, m; ``speed``: that the spool hardly exceeds, m/s.
        seconds: of the record.
        peaks: frequency (Hz), amplitude (N) and phase (rad) of forces of a line in what the base leaves.
    """

    force: float
    travel: float
    speed: float
    seconds: float
    peaks: tuple[tuple[float, float, float], ...] = ()


class Effect(ABC):
    """Something that the model may lack.

    Attributes:
        id: as in the contract.
        kinds: of records that can show it.
        terms: force terms that hold its law, switched on together; none for an effect of the data channels.
        replaces: effects that it contains; none of them is added jointly with it.
        fitted: parameters that are its own, in the order of its report.
        amplitudes: those of them that are 0 where the effect is absent.
        positive: coefficients of its signature below 0 make no sense.
        meaning: on the machine.
        check: what to look at there.
        confusable_with: effects with a similar signature.
        distinguished_by: which excitation distinguishes them.
        localised: it acts in few stretches of a record only.
        local_minima: with it the motion can go several ways at one excitation, so that a fit of free runs may
            end in a wrong local minimum: random draws precede it.
        searched: it is looked for along the measured motion; else where ``meaning`` or its file says.
        load_cell_zero: force records cannot tell it from the zero of their load cell.
        scanned: numbers in which the force is not linear that are taken from a list, not refined.
        picture: what its signature is drawn over: ``velocity``, ``displacement``, ``time`` or ``samples``.
        group: what on the machine it belongs to; a maintenance engineer acts by this.
    """

    id: ClassVar[str]
    group: ClassVar[str]
    kinds: ClassVar[tuple[str, ...]] = ("accelerations", "driven", "imposed")
    terms: ClassVar[tuple[str, ...]] = ()
    replaces: ClassVar[tuple[str, ...]] = ()
    fitted: ClassVar[tuple[str, ...]] = ()
    amplitudes: ClassVar[tuple[str, ...]] = ()
    positive: ClassVar[bool] = False
    meaning: ClassVar[str] = ""
    check: ClassVar[str] = ""
    confusable_with: ClassVar[tuple[str, ...]] = ()
    distinguished_by: ClassVar[str] = ""
    localised: ClassVar[bool] = False
    local_minima: ClassVar[bool] = False
    searched: ClassVar[bool] = True
    load_cell_zero: ClassVar[bool] = False
    scanned: ClassVar[tuple[str, ...]] = ()
    picture: ClassVar[str] = "velocity"

    @property
    def on_the_machine(self) -> str:
        """What it means, from the force term where the effect states no meaning."""
        return self.meaning or term(self.terms[0]).meaning

    @property
    def to_check(self) -> str:
        """What to look at."""
        return self.check or term(self.terms[0]).check

    @property
    def law(self) -> str:
        """Its law as text."""
        return term(self.terms[0]).law if self.terms else ""

    @property
    def numbers(self) -> tuple[Parameter, ...]:
        """The parameters that are its own, in the order of its terms."""
        return tuple(p for name in self.terms for p in term(name).parameters if p.name in self.fitted)

    @property
    def is_friction(self) -> bool:
        """Whether it is a law of dry friction: one of them is enough."""
        return any(term(name).jumps for name in self.terms)

    def unknowns(self, values: Mapping[str, float], seconds: float) -> list[Unknown]:  # noqa: ARG002
        """Return what a fit finds of it, in size as the present ``values``, in records of ``seconds``."""
        return [
            Unknown(
                p.name, p.unit, p.low, p.high,
                abs(values.get(p.name, p.start)) or p.start or 1e-3 * p.high,
            )
            for p in self.numbers
        ]  # fmt: skip

    def shapes(self, motion: Motion) -> list[dict[str, float]]:  # noqa: ARG002
        """Return the choices to try of the numbers in which the force is not linear."""
        return [{}]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the forces for coefficients of 1 along ``motion``, shape (q, n); a sensor has none."""
        return np.empty((0, motion.displacement.size))

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],
        motion: Motion,  # noqa: ARG002
    ) -> dict[str, float] | None:
        """Return parameter values for the coefficients of a trial, ``None`` where those make no sense.

        By default the coefficients are the fitted numbers that are not of the shape.
        """
        if self.positive and not np.all(coefficients > 0.0):
            return None
        linear = (name for name in self.fitted if name not in shape)
        return {**shape, **dict(zip(linear, coefficients.tolist(), strict=True))}

    def guesses(self, scale: Scale) -> list[dict[str, float]]:
        """Return numbers from which fits of a motion of ``scale`` begin: sizes from slight to all that acts.

        By default each amplitude makes these shares of the force.
        """
        (own,) = self.amplitudes
        signs = (1.0,) if self.positive else (1.0, -1.0)
        return [{own: sign * share * self.unit(scale)} for share in SHARES for sign in signs]

    def unit(self, scale: Scale) -> float:
        """Return the amplitude whose force is that of ``scale``."""
        return scale.force

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why the fitted ``values`` make no sense on a machine, or an empty string."""
        for name in self.fitted:
            if name in self.amplitudes and abs(values[name]) < 3.0 * deviations.get(name, 0.0):
                return f"{name} is not significant"
        return ""


class SensorEffect(Effect):
    """Effect of the spool's channel: its numbers, and what it makes of an acceleration.

    A likelihood knows the channel by the parts of :mod:`.likelihood.structure`, a first look its rail; the
    class gives what is found there its name and what to check.

    Attributes:
        parameters: 0 where the channel is right; ``start`` is a typical size.
        equation: the reading as text.
    """

    group = "sensor"
    kinds = ("accelerations",)
    picture = "samples"
    searched = False
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    equation: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        """Name the numbers that the class declares."""
        super().__init_subclass__(**options)
        cls.fitted = tuple(parameter.name for parameter in cls.parameters)

    @abstractmethod
    def reading(self, acceleration: Array, period: float, values: Mapping[str, float]) -> Array:
        """Return what the channel reads, m/s^2, shape of ``acceleration`` (..., n).

        Args:
            acceleration: of the spool, a sample every ``period`` s.
            values: its parameters.
        """

    @property
    def law(self) -> str:
        """Its law as text."""
        return self.equation

    @property
    def numbers(self) -> tuple[Parameter, ...]:
        """Its parameters."""
        return self.parameters


def scan(low: float, high: float, count: int) -> list[float]:
    """Return ``count`` numbers from ``low`` to ``high`` in equal ratios; none where there is no room."""
    return np.geomspace(low, high, count).tolist() if 0.0 < low < high else []

"""Effect of the catalogue: one declaration of how to find it.

Its law is that of the term of :mod:`spool_sim.terms` with the effect's name, which has its numbers, meaning
and checks. The declaration adds its signature at a measured motion, where a fit starts, and with what it is
confusable. Its functions take what they use by name. An effect of the spool's channel is a
:class:`SensorEffect`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.least_squares import Unknown
from spool_sim.terms import Parameter, Term, term

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


def taking(function: Callable[..., Any], *sources: object) -> Any:
    """Return ``function`` of what it takes: of each argument the value of that name in ``sources``.

    A source is a mapping, or an object with attributes. An argument with a default may be missing.
    """
    code, found = function.__code__, dict[str, object]()
    for name in code.co_varnames[: code.co_argcount]:
        for source in sources:
            value = source.get(name, found) if isinstance(source, Mapping) else getattr(source, name, found)
            if value is not found:
                found[name] = value
                break
    return function(**found)


@dataclass(frozen=True, eq=False, kw_only=True)
class Effect:
    """Something that the model may lack.

    Attributes:
        id: as in the contract, and the name of the force term that holds its law.
        group: what on the machine it belongs to; a maintenance engineer acts by this.
        confusable_with: effects with a similar signature.
        distinguished_by: which excitation distinguishes them.
        acts: the forces for coefficients of 1, shape (n,) or q of them; takes attributes of a :class:`Motion`
            and numbers of a shape.
        solved: the numbers for ``coefficients`` of a trial (a list), ``None`` where they make no sense; takes
            the shape and the motion as well. By default coefficients are the numbers that the shape lacks.
        tried: the shapes to try, which are the numbers in which the force is not linear; takes the motion.
        begun: numbers from which fits begin, from slight to all that acts; takes attributes of a
            :class:`Scale`. By default the amplitude makes shares of the force.
        size: the amplitude whose force is that of the scale; by default it is a force itself.
        freed: what a fit finds; takes the default (``unknowns``), numbers of the structure and ``seconds``.
        refused: why fitted numbers make no sense on a machine, or empty; takes them and ``deviations``.
        kinds: of records that can show it.
        changes: number of the base (a column of :class:`ForceBalance`) that its signature is multiplied by
            where forces are balanced; it has no coefficient then.
        replaces: effects that it contains; none of them is added jointly with it.
        sized: its numbers that are 0 where it is absent, where it has more than one.
        positive: coefficients of its signature below 0 make no sense.
        localised: it acts in few stretches of a record only.
        local_minima: with it the motion can go several ways at one excitation, so that a fit of free runs may
            end in a wrong local minimum: random draws precede it.
        searched: it is looked for along the measured motion; else where ``meaning`` or its file says.
        load_cell_zero: force records cannot tell it from the zero of their load cell.
        scanned: numbers in which the force is not linear that are taken from a list, not refined.
        picture: what its signature is drawn over: ``velocity``, ``displacement``, ``time`` or ``samples``.
    """

    id: str
    group: str
    confusable_with: tuple[str, ...]
    distinguished_by: str
    acts: Callable[..., Any] | None = None
    solved: Callable[..., dict[str, float] | None] | None = None
    tried: Callable[..., list[dict[str, float]]] | None = None
    begun: Callable[..., list[dict[str, float]]] | None = None
    size: Callable[..., float] | None = None
    freed: Callable[..., list[Unknown]] | None = None
    refused: Callable[..., str] | None = None
    kinds: tuple[str, ...] = ("accelerations", "driven", "imposed")
    changes: str = ""
    replaces: tuple[str, ...] = ()
    sized: tuple[str, ...] = ()
    positive: bool = False
    localised: bool = False
    local_minima: bool = False
    searched: bool = True
    load_cell_zero: bool = False
    scanned: tuple[str, ...] = ()
    picture: str = "velocity"

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the force terms that hold its law."""
        return (self.id,)

    @property
    def _term(self) -> Term:
        return term(self.id)

    @property
    def on_the_machine(self) -> str:
        """What it means."""
        return self._term.meaning

    @property
    def to_check(self) -> str:
        """What to look at."""
        return self._term.check

    @property
    def law(self) -> str:
        """Its law as text."""
        return self._term.law

    @property
    def numbers(self) -> tuple[Parameter, ...]:
        """Its parameters: of those of its term the ones that no valve states."""
        return tuple(p for p in self._term.parameters if p.valve_attribute is None)

    @cached_property
    def fitted(self) -> tuple[str, ...]:
        """Names of its numbers, in the order of its report."""
        return tuple(number.name for number in self.numbers)

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """Names of those of them that are 0 where the effect is absent."""
        return self.sized or (self.fitted if len(self.fitted) == 1 else ())

    @property
    def is_friction(self) -> bool:
        """Whether it is a law of dry friction: one of them is enough."""
        return self._term.jumps

    def unknowns(self, values: Mapping[str, float], seconds: float) -> list[Unknown]:
        """Return what a fit finds of it, in size as the present ``values``, in records of ``seconds``."""
        found = [
            Unknown(
                p.name, p.unit, p.low, p.high,
                abs(values.get(p.name, p.start)) or p.start or 1e-3 * p.high,
            )
            for p in self.numbers
        ]  # fmt: skip
        if self.freed is None:
            return found
        return list(taking(self.freed, {"unknowns": found, "seconds": seconds}, values))

    def shapes(self, motion: Motion) -> list[dict[str, float]]:
        """Return the choices to try of the numbers in which the force is not linear."""
        return [{}] if self.tried is None else list(taking(self.tried, motion))

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return the forces for coefficients of 1 along ``motion``, shape (q, n); a sensor has none."""
        if self.acts is None:
            return np.empty((0, motion.displacement.size))
        return np.atleast_2d(taking(self.acts, shape, motion))

    def values(
        self, coefficients: Array, shape: Mapping[str, float], motion: Motion
    ) -> dict[str, float] | None:
        """Return parameter values for the coefficients of a trial, ``None`` where those make no sense."""
        if self.positive and not np.all(coefficients > 0.0):
            return None
        if self.solved is None:
            linear = (name for name in self.fitted if name not in shape)
            return {**shape, **dict(zip(linear, coefficients.tolist(), strict=True))}
        found = taking(self.solved, {"coefficients": coefficients.tolist()}, shape, motion)
        if found is None:
            return None
        return {name: value for name, value in {**shape, **found}.items() if name in self.fitted}

    def guesses(self, scale: Scale) -> list[dict[str, float]]:
        """Return numbers from which fits of a motion of ``scale`` begin."""
        if self.begun is not None:
            return list(taking(self.begun, scale))
        (own,) = self.amplitudes
        signs = (1.0,) if self.positive else (1.0, -1.0)
        return [{own: sign * share * self.unit(scale)} for share in SHARES for sign in signs]

    def unit(self, scale: Scale) -> float:
        """Return the amplitude whose force is that of ``scale``."""
        return scale.force if self.size is None else float(taking(self.size, scale))

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why the fitted ``values`` make no sense on a machine, or an empty string."""
        reason = "" if self.refused is None else str(taking(self.refused, {"deviations": deviations}, values))
        for name in self.amplitudes:
            if not reason and abs(values[name]) < 3.0 * deviations.get(name, 0.0):
                reason = f"{name} is not significant"
        return reason


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorEffect(Effect):
    """Effect of the spool's channel: its numbers, and what it makes of an acceleration.

    A likelihood knows the channel by the parts of :mod:`.likelihood.structure`, a first look its rail; the
    declaration gives what is found there its name and what to check.

    Attributes:
        parameters: 0 where the channel is right; ``start`` is a typical size.
        equation: the reading as text.
        meaning: on the machine.
        check: what to look at there.
        reads: the reading, from ``acceleration``, ``period`` and its numbers.
    """

    group: str = "sensor"
    kinds: tuple[str, ...] = ("accelerations",)
    picture: str = "samples"
    searched: bool = False
    parameters: tuple[Parameter, ...]
    equation: str
    meaning: str
    check: str
    reads: Callable[..., Array]
    terms = ()
    amplitudes = ()

    @property
    def _term(self) -> Term:
        return Term(
            name=self.id, parameters=self.parameters, law=self.equation, source="",
            meaning=self.meaning, check=self.check,
        )  # fmt: skip

    def reading(self, acceleration: Array, period: float, values: Mapping[str, float]) -> Array:
        """Return what the channel reads, m/s^2, shape of ``acceleration`` (..., n).

        Args:
            acceleration: of the spool, a sample every ``period`` s.
            values: its parameters.
        """
        return np.asarray(taking(self.reads, {"acceleration": acceleration, "period": period}, values))


def scan(low: float, high: float, count: int) -> list[float]:
    """Return ``count`` numbers from ``low`` to ``high`` in equal ratios; none where there is no room."""
    return np.geomspace(low, high, count).tolist() if 0.0 < low < high else []

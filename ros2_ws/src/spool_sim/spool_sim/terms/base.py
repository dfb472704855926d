"""Force term: what it tells about itself.

A term's file holds the class and its laws: module-level functions of numbers that the project
compiles (:mod:`spool_core.kernels.compiled`). After the arguments named here come the term's parameters,
in their order.

    force_law(z, v, t, ...) -> N                   a force that is continuous in the motion
    sliding_law(z, speed, direction, ...) -> N     dry friction while slipping: what opposes, speed >= 0
    rest_law(z, ...) -> (low, high)                N, what it takes up at rest; else sliding_law at speed 0
    memory_law(force, slip, direction, ...) -> N   friction with memory: the force after slipping on, m
    levels_law(...) -> (low, high)                 displacements (m) at which force_law has a kink

z (m) and v (m/s) are relative to the body, t (s) runs since the start, direction is +1 or -1. Forces stand
on the left side of the balance: all terms add up to zero, so friction has the sign of the velocity.
"""

from __future__ import annotations

import importlib
import inspect
from abc import ABC
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array

from spool_sim.valve import Valve

#: Arguments of each law before the parameters.
LAWS: dict[str, tuple[str, ...]] = {
    "force_law": ("z", "v", "t"),
    "sliding_law": ("z", "speed", "direction"),
    "rest_law": ("z",),
    "memory_law": ("force", "slip", "direction"),
    "levels_law": (),
}


@dataclass(frozen=True, slots=True)
class Parameter:
    """Number that a force term depends on.

    Attributes:
        name: as in YAML files, messages and reports.
        unit: SI.
        low, high: bounds, both allowed.
        start: where a fit or a simulation starts when neither valve nor user says otherwise.
        meaning: one line.
        valve_attribute: attribute of :class:`Valve` that gives the start value, if any.
        factor: the start value is ``factor`` times that attribute.
        held: a fit leaves it at its value unless it is set free.
    """

    name: str
    unit: str
    low: float
    high: float
    start: float
    meaning: str
    valve_attribute: str | None = None
    factor: float = 1.0
    held: bool = False

    def start_for(self, valve: Valve) -> float:
        """Return the start value for ``valve``, in ``unit``."""
        if self.valve_attribute is None:
            return self.start
        return self.factor * float(getattr(valve, self.valve_attribute))

    def check(self, value: float, where: str = "parameter") -> float:
        """Return ``value`` if it lies within the bounds.

        Raises:
            InputError: not a number or out of range; name, value and range are named.
        """
        if not self.low <= value <= self.high:
            raise InputError(
                f"{where}: {self.name}: {value:g} {self.unit} is out of range, "
                f"use {self.low:g} to {self.high:g} {self.unit}"
            )
        return value


class Term(ABC):
    """Force term in the balance of the spool; all terms of a model add up to zero.

    Attributes:
        name: as in model files and reports.
        parameters: what the force depends on apart from the motion.
        law: the force as text, an equation of z, z' and t with one symbol for each parameter.
        source: equation in the paper, and what was decided about the print.
        meaning: what it stands for on the machine.
        check: what to look at on the machine when a fit finds it.
        odd: the force at (-z, -v) is minus the force at (z, v).
        dissipates: the force never does work on the spool, so that force times velocity >= 0.
        dissipates_with: name of the term without which it may do work, if any.
        conserves: the force has a potential.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    law: ClassVar[str]
    source: ClassVar[str]
    meaning: ClassVar[str]
    check: ClassVar[str]
    odd: ClassVar[bool] = True
    dissipates: ClassVar[bool] = False
    dissipates_with: ClassVar[str | None] = None
    conserves: ClassVar[bool] = False

    @cached_property
    def laws(self) -> dict[str, Callable[..., Any]]:
        """The laws that the term's file defines, by name.

        Raises:
            TypeError: the arguments of a law are not those that its name asks for.
        """
        module = importlib.import_module(type(self).__module__)
        found = {name: getattr(module, name) for name in LAWS if hasattr(module, name)}
        names = tuple(parameter.name for parameter in self.parameters)
        for name, law in found.items():
            given = tuple(inspect.signature(getattr(law, "py_func", law)).parameters)
            if given != LAWS[name] + names:
                raise TypeError(f"{self.name}.{name}{given}: must take {LAWS[name] + names}")
        return found

    @property
    def slides(self) -> bool:
        """Whether it is dry friction that depends on the motion of the moment alone."""
        return "sliding_law" in self.laws

    @property
    def jumps(self) -> bool:
        """Whether it is dry friction, whose force jumps where the velocity changes its sign."""
        return self.slides or "memory_law" in self.laws

    def uncompiled(self, law: str) -> Callable[..., Any] | None:
        """Return a law uncompiled, for single values; ``None`` where the term has none of that name."""
        found = self.laws.get(law)
        return getattr(found, "py_func", found)

    def force(
        self,
        displacement: Array,
        velocity: Array,
        acceleration: Array,  # noqa: ARG002
        values: Mapping[str, float],
        time: Array | None = None,
    ) -> Array:
        """Return the force, N, shape (n,); dry friction at zero velocity counts as 0.

        Args:
            displacement: z, relative to the body, m, shape (n,).
            velocity: z', relative to the body, m/s, shape (n,).
            acceleration: of the spool itself, z'' + w'', m/s^2, shape (n,).
            values: parameter values by name, in their units.
            time: s since the start, shape (n,); without it 0 throughout.
        """
        given = [float(values[parameter.name]) for parameter in self.parameters]
        z, v = displacement.tolist(), velocity.tolist()
        total = np.zeros(displacement.size)
        smooth, sliding = self.uncompiled("force_law"), self.uncompiled("sliding_law")
        if smooth is not None:
            t = [0.0] * len(z) if time is None else time.tolist()
            total += [smooth(*point, *given) for point in zip(z, v, t, strict=True)]
        if sliding is not None:
            total += [
                0.0 if speed == 0.0 else side * sliding(place, side * speed, side, *given)
                for place, speed, side in zip(z, v, np.sign(velocity).tolist(), strict=True)
            ]
        return total

    def at_rest(self, displacement: float, values: Mapping[str, float]) -> tuple[float, float]:
        """Return the lowest and the highest force (N) that dry friction can take up at rest."""
        given = [float(values[parameter.name]) for parameter in self.parameters]
        rest, sliding = self.uncompiled("rest_law"), self.uncompiled("sliding_law")
        if rest is not None:
            low, high = rest(displacement, *given)
            return float(low), float(high)
        if sliding is None:
            return 0.0, 0.0
        return -float(sliding(displacement, 0.0, -1.0, *given)), float(
            sliding(displacement, 0.0, 1.0, *given)
        )

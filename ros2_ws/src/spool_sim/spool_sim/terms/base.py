"""Force term: one declaration of its numbers, its texts and the functions that compute its force.

A law is a function of plain numbers at the top level of a module. It takes those of the arguments listed here
that it uses, and those of the term's parameters, each by its name:

    force_law(z, v, t) -> N                    a force that is continuous in the motion
    sliding_law(z, speed, direction) -> N      dry friction while slipping: what opposes, speed >= 0
    rest_law(z) -> (low, high)                 N, what it takes up at rest; else sliding_law at speed 0
    memory_law(force, slip, direction) -> N    friction with memory: the force after slipping on, m
    levels_law() -> (low, high)                displacements (m) at which force_law has a kink
    inertia_law(acceleration) -> N             of the moving mass; steps divide by the parameter ``mass``

z (m) and v (m/s) are relative to the body, t (s) runs since the start, direction is +1 or -1. All forces add
up to zero, so friction has the sign of the velocity.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array

from spool_sim.valve import Valve

#: What a law may take besides the parameters of its term.
LAWS: dict[str, tuple[str, ...]] = {
    "force_law": ("z", "v", "t"),
    "sliding_law": ("z", "speed", "direction"),
    "rest_law": ("z",),
    "memory_law": ("force", "slip", "direction"),
    "levels_law": (),
    "inertia_law": ("acceleration",),
}
Law = Callable[..., Any]


def without(*names: str) -> dict[str, Callable[[Mapping[str, float]], dict[str, float]]]:
    """Return what ``Term.becomes`` says of a term whose force is 0 where these parameters are 0."""
    return {"": lambda _values: dict.fromkeys(names, 0.0)}


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


@dataclass(frozen=True, eq=False, kw_only=True)
class Term:
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
        becomes: name of a term that this one contains, "" for none at all, and the parameters that make it
            that one, from all values of both.
        force_law, sliding_law, rest_law, memory_law, levels_law, inertia_law: as the module describes.
    """

    name: str
    parameters: tuple[Parameter, ...]
    law: str
    source: str
    meaning: str
    check: str
    odd: bool = True
    dissipates: bool = False
    dissipates_with: str | None = None
    conserves: bool = False
    becomes: Mapping[str, Callable[[Mapping[str, float]], dict[str, float]]] = field(default_factory=dict)
    force_law: Law | None = None
    sliding_law: Law | None = None
    rest_law: Law | None = None
    memory_law: Law | None = None
    levels_law: Law | None = None
    inertia_law: Law | None = None

    def __post_init__(self) -> None:
        """Refuse a law that takes what it cannot get.

        Raises:
            TypeError: an argument is neither one that ``LAWS`` lists nor a parameter.
        """
        for name in self.laws:
            known = (*LAWS[name], *(parameter.name for parameter in self.parameters))
            wrong = [argument for argument in self.arguments(name) if argument not in known]
            if wrong:
                raise TypeError(f"{self.name}.{name}: takes {', '.join(wrong)}, known are {', '.join(known)}")

    def __init_subclass__(cls) -> None:
        """Refuse a class: a term is an object."""
        raise TypeError(f"{cls.__name__} derives from Term: declare Term(name=..., force_law=...) instead")

    def __reduce__(self) -> tuple[Any, ...]:
        """Go to another process by name, as its laws are functions; one that is not registered goes whole."""
        registered = importlib.import_module(__package__ or "")
        if registered.TERMS.get(self.name) is self:
            return registered.term, (self.name,)
        return object.__new__, (Term,), self.__dict__

    @cached_property
    def laws(self) -> dict[str, Law]:
        """The laws that the term has, by name."""
        return {name: law for name in LAWS if (law := getattr(self, name)) is not None}

    @property
    def slides(self) -> bool:
        """Whether it is dry friction that depends on the motion of the moment alone."""
        return "sliding_law" in self.laws

    @property
    def jumps(self) -> bool:
        """Whether it is dry friction, whose force jumps where the velocity changes its sign."""
        return self.slides or "memory_law" in self.laws

    def function(self, law: str) -> Any:
        """Return the Python function of a law, uncompiled."""
        return getattr(self.laws[law], "py_func", self.laws[law])

    def arguments(self, law: str) -> tuple[str, ...]:
        """Return the names of what a law takes, in its order."""
        code = self.function(law).__code__
        return tuple(code.co_varnames[: code.co_argcount])

    def imported(self, number: int, law: str) -> str:
        """Return the line of source that imports the function of a law as ``LAW_NUMBER``."""
        function = self.function(law)
        return f"from {function.__module__} import {function.__name__} as {law}_{number}"

    def call(self, number: int, places: Mapping[str, str], law: str, *motion: str) -> str:
        """Return the source of a call of ``LAW_NUMBER``.

        Args:
            number: of the term in its model.
            places: source of each parameter, by name.
            law: which one.
            motion: source of each of its arguments in ``LAWS``.
        """
        known = {**places, **dict(zip(LAWS[law], motion, strict=True))}
        return f"{law}_{number}({', '.join(known[argument] for argument in self.arguments(law))})"

    def uncompiled(self, law: str) -> Law | None:
        """Return a law for single values; ``None`` where the term has none of that name.

        It takes all of its arguments in ``LAWS``, then all parameters.
        """
        if law not in self.laws:
            return None
        known = (*LAWS[law], *(parameter.name for parameter in self.parameters))
        function, places = self.function(law), [known.index(argument) for argument in self.arguments(law)]
        return lambda *given: function(*[given[place] for place in places])

    def force(
        self,
        displacement: Array,
        velocity: Array,
        acceleration: Array,
        values: Mapping[str, float],
        time: Array | None = None,
    ) -> Array:
        """Return the force, N, shape (n,); dry friction at zero velocity counts as 0.

        Friction with memory starts from zero at the first sample; its reversals fall on samples.

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
        smooth, sliding, memory, inertia = (
            self.uncompiled(law) for law in ("force_law", "sliding_law", "memory_law", "inertia_law")
        )
        if inertia is not None:
            total += inertia(acceleration, *given)
        if smooth is not None:
            t = [0.0] * len(z) if time is None else time.tolist()
            total += [smooth(*point, *given) for point in zip(z, v, t, strict=True)]
        if sliding is not None:
            total += [
                0.0 if speed == 0.0 else side * sliding(place, side * speed, side, *given)
                for place, speed, side in zip(z, v, np.sign(velocity).tolist(), strict=True)
            ]
        if memory is not None:
            held = [0.0]
            for slip in np.diff(displacement).tolist():
                held.append(memory(held[-1], slip, math.copysign(1.0, slip), *given))
            total += held
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
        low, high = (float(sliding(displacement, 0.0, side, *given)) for side in (-1.0, 1.0))
        return -low, high

"""Hypotheses and their fits by simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_identification.least_squares.unknown import Unknown
from spool_sim.model import Model
from spool_sim.terms import Parameter, term
from spool_sim.valve.description import Valve

from spool_gap.effect import Trial
from spool_gap.registry import EFFECTS
from spool_gap.result import GapSettings
from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import Stretch
from spool_gap.simulation.simulate import Simulation

from .descent import Fitted, descend

Array = NDArray[np.float64]

GAIN, DELAY = "spool_gain_error", "spool_delay"
BASE_NUMBERS = ("spring_stiffness", "viscous_coefficient", GAIN, DELAY)
#: Factor by which the spring may be off its description: play and stops have valleys without a spring.
OFF = 5.0
WIDE = {GAIN: 0.5, DELAY: 5e-3}


@dataclass(slots=True)
class Step:
    """A hypothesis that was fitted by simulation.

    Attributes:
        effects: ids, in the order in which they were accepted.
        fitted: on the training windows.
        train, held: errors (model - measured) of each window, m/s^2, shape (1, n).
        cost: weighed sum of squares over the held-out windows; ``costs``: of each of them.
        trials: signatures of its effects by id, for the regression.
    """

    effects: tuple[str, ...]
    fitted: Fitted
    train: list[Array]
    held: list[Array]
    cost: float = math.nan
    costs: Array = field(default_factory=lambda: np.zeros(0))
    trials: Mapping[str, Trial] = field(default_factory=dict)

    def take(self, other: Step) -> None:
        """Take the numbers of ``other``, another fit of the same effects."""
        self.fitted, self.train, self.held = other.fitted, other.train, other.held
        self.cost, self.costs = other.cost, other.costs


@dataclass(slots=True)
class Fitting:
    """What is fitted, and how, over one set of stretches.

    Attributes:
        stretches: with their windows.
        simulation: of those windows.
        base: model that effects are added to.
        valve: gives what is held.
        settings: tolerances.
    """

    stretches: Sequence[Stretch]
    simulation: Simulation
    base: Model
    valve: Valve
    settings: GapSettings

    def terms_of(self, effects: Sequence[str]) -> tuple[str, ...]:
        """Return the terms that are switched on."""
        own = [name for entry in effects if entry in EFFECTS for name in EFFECTS[entry].terms]
        return tuple(dict.fromkeys([*(entry.name for entry in self.base.terms), *own]))

    def free_of(self, effects: Sequence[str], point: Point) -> list[Unknown]:
        """Return what is fitted for ``effects``."""
        found = []
        for parameter in self.base.parameters:
            given = parameter.held or parameter.valve_attribute is not None
            if not given or parameter.name in ("spring_stiffness", "viscous_coefficient"):
                start = max(abs(parameter.start_for(self.valve)), 1e-9)
                low, high = parameter.low, parameter.high
                if parameter.name == "spring_stiffness":
                    low, high = max(low, start / OFF), min(high, start * OFF)
                found.append(Unknown(parameter.name, parameter.unit, low, high, start))
        for name in effects:
            if name not in EFFECTS or not EFFECTS[name].terms:
                continue
            own = [p for entry in EFFECTS[name].terms for p in parameters_of(entry)]
            for parameter in own:
                if parameter.name not in EFFECTS[name].fitted:
                    continue
                value = abs(point.values.get(parameter.name, parameter.start))
                if parameter.name == "force_frequency":
                    seconds = max(stretch.record.duration for stretch in self.stretches)
                    found.append(
                        Unknown(
                            parameter.name, parameter.unit, 0.1, parameter.high, 0.05 / seconds, absolute=True
                        )
                    )
                elif parameter.name == "force_phase":
                    found.append(
                        Unknown(
                            parameter.name, parameter.unit, parameter.low, parameter.high, 0.5, absolute=True
                        )
                    )
                else:
                    size = value or parameter.start or 1e-3 * parameter.high
                    found.append(Unknown(parameter.name, parameter.unit, parameter.low, parameter.high, size))
        for name, tolerance in ((GAIN, self.settings.gain_tolerance), (DELAY, self.settings.delay_tolerance)):
            # Steps are bounded by the scale: what is out of tolerance has a longer way to go.
            bound, scale = (WIDE[name], tolerance) if name in effects else (tolerance, 0.2 * tolerance)
            found.append(Unknown(name, point.unit(name), -bound, bound, scale, absolute=True))
        return found

    def fit(
        self,
        effects: tuple[str, ...],
        starts: Sequence[Point],
        *,
        rounds: int = 6,
        tries: int = 1,
        enough: float = 2e-4,
    ) -> Step:
        """Return the hypothesis ``effects`` fitted from the best of ``starts``."""
        free = self.free_of(effects, starts[0])
        fitted = descend(self.simulation, starts, free, rounds=rounds, tries=tries, enough=enough)
        return self.measured(Step(effects, fitted, [], []))

    def measured(self, step: Step) -> Step:
        """Return ``step`` with its errors on all windows."""
        simulation = self.simulation
        training, held = simulation.training, simulation.held_out
        errors = simulation.errors([step.fitted.point], [*training, *held])
        step.train, step.held = errors[: len(training)], errors[len(training) :]
        self.score(step)
        return step

    def score(self, step: Step) -> None:
        """Work out the held-out cost with the present weight."""
        simulation = self.simulation
        held = simulation.held_out
        step.costs = simulation.costs(simulation.weigh(step.held, held), held)[0]
        step.cost = float(step.costs.sum())

    def nrmse(self, step: Step) -> float:
        """Held out."""
        return float(self.simulation.nrmse(step.held, self.simulation.held_out)[0])

    def take_weight(self, step: Step) -> None:
        """Weigh by what ``step`` leaves on the training windows, at least by the channels' noise."""
        self.simulation.take_weight(step.train, self.simulation.training, self.least_density)

    @property
    def least_density(self) -> list[float]:
        """Power density of what is left by which a stretch is weighed at least, (m/s^2)^2/Hz."""
        return [stretch.noise.spool * 0.5 for stretch in self.stretches]


def parameters_of(name: str) -> tuple[Parameter, ...]:
    """Return the parameters of the term called ``name``."""
    return term(name).parameters

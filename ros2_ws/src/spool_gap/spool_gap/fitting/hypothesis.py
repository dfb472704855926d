"""Hypotheses and their fits by simulation."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.least_squares import Unknown
from spool_sim.model import Model
from spool_sim.terms import Parameter, term
from spool_sim.valve import Valve

from spool_gap.effect import Trial
from spool_gap.registry import CHAIN, EFFECTS
from spool_gap.result import GapSettings
from spool_gap.simulation.point import DELAY, GAIN, Point
from spool_gap.simulation.segments import Stretch
from spool_gap.simulation.simulate import Simulation

from .descent import ENOUGH, Fitted, descend

Array = NDArray[np.float64]

BASE_NUMBERS = ("spring_stiffness", "viscous_coefficient", GAIN, DELAY)
#: Factor by which the spring may be off its description: play and stops have local minima without a spring.
OFF = 5.0
WIDE = {GAIN: 0.5, DELAY: 5e-3}


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """Hypothesis that was fitted by simulation.

    Attributes:
        effects: ids, in the order in which they were accepted.
        fitted: on the training windows.
        train, held: errors (model - measured) of each window, m/s^2, shape (1, n).
        cost: weighed sum of squares over the held-out windows; ``costs``: of each of them.
        trials: signatures of its effects by id, for the regression.
    """

    effects: tuple[str, ...]
    fitted: Fitted
    train: Sequence[Array] = ()
    held: Sequence[Array] = ()
    cost: float = math.nan
    costs: Array = field(default_factory=lambda: np.zeros(0))
    trials: Mapping[str, Trial] = field(default_factory=dict)

    @property
    def point(self) -> Point:
        """Its numbers."""
        return self.fitted.point

    @property
    def newest(self) -> str:
        """The effect that was added last."""
        return self.effects[-1]

    @property
    def own_values(self) -> dict[str, float]:
        """Numbers of its newest effect, SI."""
        return {name: self.point.get(name) for name in EFFECTS[self.newest].fitted}

    @property
    def free_values(self) -> dict[str, float]:
        """Fitted numbers, SI."""
        return {free.name: self.point.get(free.name) for free in self.fitted.free}

    @property
    def has_jumps(self) -> bool:
        """Whether its force jumps where the velocity changes its sign."""
        return any(term(name).jumps for name in self.point.terms)

    @property
    def has_kinks(self) -> bool:
        """Whether its force jumps, or its slope over the displacement does."""
        return self.has_jumps or any("levels_law" in term(name).laws for name in self.point.terms)

    def at(self, point: Point) -> Hypothesis:
        """Return this with the numbers of ``point``, from which it is not fitted yet."""
        return replace(self, fitted=replace(self.fitted, point=point, settled=None))


@dataclass(frozen=True, slots=True)
class Fitting:
    """Least-squares problem of hypotheses: windows with a weight, and what is fitted to them.

    Attributes:
        simulation: of the windows.
        base: model that effects are added to.
        valve: gives what is held.
        settings: tolerances.
    """

    simulation: Simulation
    base: Model
    valve: Valve
    settings: GapSettings

    @property
    def stretches(self) -> Sequence[Stretch]:
        """The stretches with their windows."""
        return self.simulation.stretches

    def over(self, simulation: Simulation) -> Fitting:
        """Return the same problem over the windows, or with the weight, of ``simulation``."""
        return replace(self, simulation=simulation)

    def terms_of(self, effects: Sequence[str]) -> tuple[str, ...]:
        """Return the terms that are switched on, and the sensor effects."""
        own = [name for entry in effects if entry in EFFECTS for name in EFFECTS[entry].terms or (entry,)]
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
        seconds = max(stretch.record.duration for stretch in self.stretches)
        for name in effects:
            if name in EFFECTS:
                found += EFFECTS[name].unknowns(point.values, seconds)
        for name, tolerance in ((GAIN, self.settings.gain_tolerance), (DELAY, self.settings.delay_tolerance)):
            # Steps are bounded by the scale: what is out of tolerance has a longer way to go.
            wide = name in effects or (name == GAIN and _frees_gain(effects))
            bound, scale = (WIDE[name], tolerance) if wide else (tolerance, 0.2 * tolerance)
            found.append(Unknown(name, point.unit(name), -bound, bound, scale, absolute=True))
        return found

    def fit(
        self,
        effects: tuple[str, ...],
        starts: Sequence[Point],
        *,
        rounds: int = 6,
        tries: int = 1,
        enough: float = ENOUGH,
        trials: Mapping[str, Trial] | None = None,
    ) -> Hypothesis:
        """Return the hypothesis ``effects`` with their ``trials``, fitted from the best of ``starts``."""
        free = self.free_of(effects, starts[0])
        fitted = descend(self.simulation, starts, free, rounds=rounds, tries=tries, enough=enough)
        return self.measured(Hypothesis(effects, fitted, trials=trials or {}))

    def polished(self, hypothesis: Hypothesis, rounds: int = 7) -> Hypothesis:
        """Return ``hypothesis`` fitted on from its own numbers, ``rounds`` at most, or settled as it is."""
        if hypothesis.fitted.settled is self.simulation.weighing:
            return hypothesis
        return self.fit(hypothesis.effects, [hypothesis.point], rounds=rounds, trials=hypothesis.trials)

    def without(self, hypothesis: Hypothesis, names: Collection[str]) -> Hypothesis:
        """Return ``hypothesis`` without the effects ``names``, fitted."""
        effects = tuple(entry for entry in hypothesis.effects if entry not in names)
        trials = {e: t for e, t in hypothesis.trials.items() if e not in names}
        return self.fit(effects, [replace(hypothesis.point, active=self.terms_of(effects))], trials=trials)

    def measured(self, hypothesis: Hypothesis) -> Hypothesis:
        """Return ``hypothesis`` with its errors on all windows."""
        training, held = self.simulation.training, self.simulation.held_out
        errors = self.simulation.errors([hypothesis.point], [*training, *held])
        train, held_errors = errors[: len(training)], errors[len(training) :]
        return self.scored(replace(hypothesis, train=train, held=held_errors))

    def scored(self, hypothesis: Hypothesis) -> Hypothesis:
        """Return ``hypothesis`` with its held-out cost by the present weight."""
        held = self.simulation.held_out
        costs = self.simulation.costs(self.simulation.weigh(hypothesis.held, held), held)[0]
        return replace(hypothesis, costs=costs, cost=float(costs.sum()))

    def nrmse(self, hypothesis: Hypothesis) -> float:
        """Return rms(model - measured) / rms(measured), held out."""
        return float(self.simulation.nrmse(hypothesis.held, self.simulation.held_out)[0])

    def weighed_by(self, hypothesis: Hypothesis) -> Fitting:
        """Return this weighing by what ``hypothesis`` leaves on the training windows."""
        return self.over(self.simulation.weighed_by(hypothesis.train))


def _frees_gain(effects: Sequence[str]) -> bool:
    return any(CHAIN[name].frees_gain for name in effects if name in CHAIN)


def parameters_of(name: str) -> tuple[Parameter, ...]:
    """Return the parameters of the term called ``name``."""
    return term(name).parameters

"""Names what is missing: forward and backward over the catalogue, every step decided on held-out data."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from spool_sim.model import Model
from spool_sim.terms import Parameter, term
from spool_sim.valve import Valve

from .balance import Balance, Screened
from .descent import Fitted, Free, descend
from .effect import Effect, Trial
from .peaks import lines_beside_the_drive
from .registry import EFFECTS
from .result import GapSettings, Hypothesis
from .simulate import Point, Simulation
from .start_from_rest import asymmetry
from .stretches import Stretch

Array = NDArray[np.float64]

#: Twice the log likelihood ratio on held-out data, less the price of the parameters, that an effect needs.
EVIDENCE = 40.0
#: Share of the weighed sum of squares that it must take away at least.
RELATIVE = 4e-3
#: Share of the measured acceleration, rms, that it must explain: less is within what any simulation errs.
SMALLEST = 1e-3
#: Evidence by which a richer effect must beat a simpler one that it contains.
RICHER = 16.0
#: The same by the regression, from which an effect is simulated.
SCREENED = 25.0
#: Hypotheses that are simulated in each step.
SIMULATED = 7
#: Of them are refined with the weight of the best one.
REFINED = 3
GAIN, DELAY = "spool_gain_error", "spool_delay"
BASE_NUMBERS = ("spring_stiffness", "viscous_coefficient", GAIN, DELAY)
WIDE = {GAIN: 0.5, DELAY: 5e-3}


@dataclass(slots=True)
class Step:
    """A hypothesis that was fitted by simulation.

    Attributes:
        effects: ids, in the order in which they were accepted.
        fitted: on the training windows.
        train, held: errors (model - measured) of each window, m/s^2, shape (1, n).
        cost: weighed sum of squares over the held-out windows.
        trials: signatures of its effects, for the regression.
    """

    effects: tuple[str, ...]
    fitted: Fitted
    train: list[Array]
    held: list[Array]
    cost: float = math.nan
    trials: tuple[Trial, ...] = ()


@dataclass(slots=True)
class Search:
    """One search over one set of stretches.

    Attributes:
        ranking: every hypothesis that was simulated.
        steps: base first, then each accepted one.
    """

    stretches: Sequence[Stretch]
    simulation: Simulation
    base: Model
    valve: Valve
    settings: GapSettings
    report: Callable[[str, float], None]
    catalogue: Sequence[Effect] = ()
    ranking: list[Hypothesis] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    excluded: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.catalogue:
            self.catalogue = [
                entry for entry in EFFECTS.values() if "accelerations" in entry.kinds and entry.terms
            ]
        base_terms = {entry.name for entry in self.base.terms}
        self.catalogue = [entry for entry in self.catalogue if not base_terms & set(entry.terms)]

    # What is fitted -------------------------------------------------------------------------------------

    def terms_of(self, effects: Sequence[str]) -> tuple[str, ...]:
        """Return the terms that are switched on."""
        own = [name for entry in effects if entry in EFFECTS for name in EFFECTS[entry].terms]
        return tuple(dict.fromkeys([*(entry.name for entry in self.base.terms), *own]))

    def free_of(self, effects: Sequence[str], point: Point) -> list[Free]:
        """Return what is fitted for ``effects``."""
        found = []
        for parameter in self.base.parameters:
            if parameter.valve_attribute is None or parameter.name in (
                "spring_stiffness",
                "viscous_coefficient",
            ):
                start = max(abs(parameter.start_for(self.valve)), 1e-9)
                found.append(Free(parameter.name, parameter.low, parameter.high, start))
        for name in effects:
            if name not in EFFECTS or not EFFECTS[name].terms:
                continue
            own = [p for entry in EFFECTS[name].terms for p in _parameters(entry)]
            for parameter in own:
                if parameter.name not in EFFECTS[name].fitted:
                    continue
                value = abs(point.values.get(parameter.name, parameter.start))
                if parameter.name == "force_frequency":
                    seconds = max(stretch.record.duration for stretch in self.stretches)
                    found.append(Free(parameter.name, 0.1, parameter.high, 0.05 / seconds, absolute=True))
                elif parameter.name == "force_phase":
                    found.append(Free(parameter.name, parameter.low, parameter.high, 0.5, absolute=True))
                else:
                    found.append(
                        Free(parameter.name, parameter.low, parameter.high, value or parameter.start)
                    )
        for name, tolerance in ((GAIN, self.settings.gain_tolerance), (DELAY, self.settings.delay_tolerance)):
            bound = WIDE[name] if name in effects else tolerance
            found.append(Free(name, -bound, bound, 0.2 * tolerance, absolute=True))
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
        step.cost = float(np.sum(simulation.weigh(step.held, simulation.held_out) ** 2))

    def nrmse(self, step: Step) -> float:
        """Held out."""
        return float(self.simulation.nrmse(step.held, self.simulation.held_out)[0])

    # The search -----------------------------------------------------------------------------------------

    def take_weight(self, step: Step) -> None:
        """Weigh by what ``step`` leaves on the training windows, at least by the channels' noise."""
        floor = [s.noise.spool * 0.5 for s in self.stretches]
        self.simulation.take_weight(step.train, self.simulation.training, floor)

    def run(self, start: Point) -> Step:
        """Return the accepted hypothesis."""
        self.report("fitting the base", 0.15)
        step = self.fit((), [start], rounds=10)
        self.take_weight(step)
        step = self.fit((), [step.fitted.point], rounds=6)
        self.steps = [step]
        while len(step.effects) < self.settings.most_effects:
            self.report(f"trying effects beside {' + '.join(step.effects) or 'the base'}", 0.25)
            better = self._forward(step)
            if better is None:
                break
            step = self._backward(better)
            if step.effects in [entry.effects for entry in self.steps]:
                break
            self.steps.append(step)
        return self._by_direction(step)

    def _by_direction(self, step: Step) -> Step:
        """Return ``step`` with one friction force for each direction where its start shows that."""
        if "coulomb_friction" not in step.effects or "asymmetric_friction" in self.excluded:
            return step
        for stretch in self.stretches:
            found = asymmetry(self.simulation, stretch, step.fitted.point, self.base, self.valve)
            if found is None or found.evidence < EVIDENCE or abs(found.ratio) < 3.0 * found.deviation:
                continue
            effects = tuple("asymmetric_friction" if e == "coulomb_friction" else e for e in step.effects)
            old = step.fitted
            mean, spread = old.point.values["coulomb_force"], old.deviations["coulomb_force"]
            forces = {
                "forward_force": (1.0 + found.ratio) * mean,
                "backward_force": (1.0 - found.ratio) * mean,
            }
            deviation = math.hypot(spread, mean * found.deviation)
            free = tuple(f for f in old.free if f.name != "coulomb_force")
            free += tuple(replace(f, name=n) for n in forces for f in old.free if f.name == "coulomb_force")
            fitted = replace(
                old,
                point=replace(
                    old.point, active=self.terms_of(effects), values={**old.point.values, **forces}
                ),
                free=free,
                deviations={**old.deviations, **dict.fromkeys(forces, deviation)},
            )
            better = self.measured(replace(step, effects=effects, fitted=fitted, train=[], held=[]))
            self.ranking.append(
                Hypothesis(
                    "asymmetric_friction", step.effects[: step.effects.index("coulomb_friction")],
                    self.nrmse(better), found.evidence, forces, True,
                )
            )  # fmt: skip
            self.steps.append(better)
            return better
        return step

    def candidates(self, step: Step) -> list[Screened]:
        """Return what the regression would add to ``step``, best first."""
        values = step.fitted.point.values
        balance = Balance(
            self.stretches, values["mass"], values["spring_stiffness"], values["viscous_coefficient"]
        )
        balance.prepare(step.trials)
        contained = {name for entry in step.effects for name in (entry, *EFFECTS[entry].replaces)}
        effects = [entry for entry in self.catalogue if entry.id not in contained | set(self.excluded)]
        peaks = lines_beside_the_drive(self.stretches, values)
        balance.screen(effects, peaks)
        rough = balance.screen(effects, peaks)
        if not rough:
            return []
        balance.prepare([*step.trials, rough[0].trial])
        balance.reweigh()
        balance.prepare(step.trials)
        return balance.screen(effects, peaks)

    def _forward(self, step: Step) -> Step | None:
        screened = self.candidates(step)
        chosen = self._promising(screened)
        price = self._price
        tried = [self._try(step, entry, rounds=3) for entry in chosen]
        for name in (GAIN, DELAY):
            if name in step.fitted.at_bound and name not in step.effects:
                tried.append(self.fit((*step.effects, name), [step.fitted.point]))
        if not tried:
            return None
        # One weight for all: what the best of them leaves.
        best = min(tried, key=lambda entry: entry.cost)
        if self.has_jumps(best):
            self.simulation.choose_sampling(best.fitted.point)
            for entry in (step, *tried):
                self.measured(entry)
        self.take_weight(best)
        tried.sort(key=lambda entry: entry.cost)
        again = [self._refit(entry) for entry in tried[:REFINED]] + tried[REFINED:]
        self.score(step)
        for entry in again:
            self.score(entry)
        ranked = []
        for entry in again:
            evidence = step.cost - entry.cost - price * (len(entry.fitted.free) - len(step.fitted.free))
            ranked.append((evidence, entry))
        ranked.sort(key=lambda pair: -pair[0])
        winner: Step | None = None
        best_evidence = -math.inf
        for evidence, entry in ranked:
            reason = self._refusal(step, entry, evidence)
            name = entry.effects[-1]
            self.ranking.append(
                Hypothesis(
                    name, step.effects, self.nrmse(entry), evidence,
                    {f.name: entry.fitted.point.get(f.name) for f in entry.fitted.free}, False, reason,
                )
            )  # fmt: skip
            if reason:
                continue
            # The simpler one stays unless the richer one is clearly better.
            simpler = winner is not None and name in EFFECTS[winner.effects[-1]].replaces
            if winner is None or (simpler and best_evidence - evidence < RICHER):
                winner, best_evidence = entry, evidence
        if winner is not None:
            place = max(
                n
                for n, h in enumerate(self.ranking)
                if h.id == winner.effects[-1] and h.beside == step.effects
            )
            self.ranking[place] = replace(self.ranking[place], accepted=True)
        return winner

    @property
    def _price(self) -> float:
        sizes = [window.stop - window.start for _, window, training in self.simulation.places if not training]
        return math.log(max(10, sum(sizes)))

    @staticmethod
    def _promising(screened: Sequence[Screened]) -> list[Screened]:
        """Return what is worth simulating: near the best by the regression, or confused with it."""
        if not screened or screened[0].gain < SCREENED:
            return []
        best = screened[0]
        found = []
        for entry in screened:
            near = (
                entry.effect.id in best.effect.confused_with or best.effect.id in entry.effect.confused_with
            )
            if entry.gain >= max(SCREENED, (0.05 if near else 0.25) * best.gain):
                found.append(entry)
        return found[:SIMULATED]

    @staticmethod
    def has_jumps(step: Step) -> bool:
        """Whether the force of ``step`` jumps where the velocity changes its sign."""
        laws = {law for name in step.fitted.point.active for law in term(name).laws}
        return bool(laws & {"sliding_law", "memory_law"})

    def _refusal(self, step: Step, entry: Step, evidence: float) -> str:
        if evidence < EVIDENCE or evidence < RELATIVE * step.cost:
            return "it does not close the gap significantly"
        before, after = self.nrmse(step), self.nrmse(entry)
        if before**2 - after**2 < SMALLEST**2:
            return "it is too small to be told from errors of the simulation"
        name = entry.effects[-1]
        values = {f.name: entry.fitted.point.get(f.name) for f in entry.fitted.free}
        if name in (GAIN, DELAY):
            tolerance = self.settings.gain_tolerance if name == GAIN else self.settings.delay_tolerance
            if abs(values[name]) < tolerance + 2.0 * entry.fitted.deviations[name]:
                return "it is not significantly beyond its tolerance"
            return ""
        own = [bound for bound in entry.fitted.at_bound if bound in EFFECTS[name].fitted]
        own = [bound for bound in own if bound not in FREE_TO_VANISH]
        if own:
            return f"{', '.join(own)} stopped at a bound"
        return EFFECTS[name].sensible(values, entry.fitted.deviations)

    def _try(self, step: Step, entry: Screened, rounds: int) -> Step:
        effects = (*step.effects, entry.effect.id)
        effects = tuple(e for e in effects if e not in entry.effect.replaces)
        known = replace(step.fitted.point, active=self.terms_of(effects))
        joint = known.moved(BASE_NUMBERS, self._joint(entry.base, known))
        starts = []
        for values in entry.effect.starts(entry.values):
            bounded = {}
            for name, value in values.items():
                parameter = next(p for t in entry.effect.terms for p in _parameters(t) if p.name == name)
                bounded[name] = float(np.clip(value, parameter.low, parameter.high))
            starts += [replace(point, values={**point.values, **bounded}) for point in (joint, known)]
        found = self.fit(effects, starts, rounds=rounds, tries=2 if len(starts) > 4 else 1, enough=5e-3)
        found.trials = (*step.trials, entry.trial)
        return found

    def _joint(self, base: Array, point: Point) -> list[float]:
        """Return the base's numbers from the regression with the effect, kept to what is physical."""
        stiffness, damping, gain, delay = base.tolist()
        known = [point.get(name) for name in BASE_NUMBERS]
        return [
            float(np.clip(stiffness, 0.5 * known[0], 2.0 * known[0])),
            max(damping, 0.02 * known[1]),
            gain,
            delay,
        ]

    def _refit(self, step: Step) -> Step:
        found = self.fit(step.effects, [step.fitted.point], rounds=6)
        found.trials = step.trials
        return found

    def _backward(self, step: Step) -> Step:
        """Return ``step`` without the effects that it no longer needs."""
        for name in step.effects[:-1]:
            effects = tuple(entry for entry in step.effects if entry != name)
            less = self.fit(effects, [replace(step.fitted.point, active=self.terms_of(effects))])
            less.trials = tuple(t for e, t in zip(step.effects, step.trials, strict=False) if e != name)
            gain = less.cost - step.cost - self._price * (len(step.fitted.free) - len(less.fitted.free))
            if gain < EVIDENCE or gain < RELATIVE * step.cost:
                return less
        return step


#: Numbers that may end at a bound without harm: contact parts that vanish.
FREE_TO_VANISH = (
    "mixed_root_coefficient",
    "coulomb_force",
    "preload_travel",
    "stop_dissipation",
    "mixed_velocity",
)


def _parameters(name: str) -> tuple[Parameter, ...]:
    return term(name).parameters

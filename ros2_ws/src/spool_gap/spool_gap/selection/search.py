"""Names what is missing: forward and backward over the catalogue, every step decided on held-out data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from spool_identification.least_squares.parallel import in_parallel

from spool_gap.effect import Effect
from spool_gap.fitting.by_direction import by_direction
from spool_gap.fitting.descent import Fitted
from spool_gap.fitting.hypothesis import BASE_NUMBERS, DELAY, GAIN, Step
from spool_gap.fitting.synchronised import DAMPING_RATIO, coupled_simulation, holds_damper
from spool_gap.registry import EFFECTS
from spool_gap.result import Hypothesis
from spool_gap.screening.remainder import OF_GAP, remainder
from spool_gap.screening.screening import balance_of, candidates, overlooked
from spool_gap.simulation.noise_floor import noise_floor
from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import Stretch
from spool_gap.simulation.simulate import Simulation

from .confusable import LookAlikes
from .joint_fit import joint_numbers, tried_beside
from .median_window import usual_excess
from .other_laws import swapped
from .pairwise import coupled_fit, winner_of_duels
from .rules import AT_FLOOR, CLEARLY, CLOSED, EVIDENCE
from .small_effects import beyond_noise, small_effect

Progress = Callable[[str, float], None]

#: Error over the noise floor up to which nothing more is looked for beside forces without kinks, which
#: simulate without error; beside others ``AT_FLOOR``, and from the start ``CLOSED``.
SMOOTH = 1.08
#: Share of the evidence of the first effect from which its look-alike is followed, too.
NEARLY = 0.5
#: Hypotheses that are refined with the weight of the best one.
REFINED = 3


@dataclass(frozen=True, slots=True)
class _Left:
    """What a fit leaves over whole windows.

    Attributes:
        fitted: the fit.
        floor: what noise leaves, over the measured acceleration.
        excess: error over that, in all or usually.
        counts: whether it is some of the gap.
        tells: whether it can be foretold, as noise cannot.
    """

    fitted: Fitted
    floor: float
    excess: float
    counts: bool
    tells: bool


@dataclass(slots=True)
class Search(LookAlikes):
    """One search over one set of stretches.

    Attributes:
        longer: as many of those as are judged by.
        regressed: as many of those as the regression takes.
        report: takes what is done and the share of the work.
        catalogue: effects that are tried; all by default.
        ranking: every hypothesis that was simulated.
        tried: its fit, by effect and effects beside it.
        steps: base first, then each accepted one.
        overruled: laws of friction that were ahead alone and lost beside other effects, with the evidence.
        coupled: by what hypotheses are judged where the motion can go several ways, ``None`` where it cannot.
    """

    longer: Simulation
    regressed: Sequence[Stretch]
    report: Progress
    catalogue: Sequence[Effect] = ()
    ranking: list[Hypothesis] = field(default_factory=list)
    tried: dict[tuple[str, tuple[str, ...]], Step] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)
    overruled: dict[str, float] = field(default_factory=dict)
    coupled: Simulation | None = None
    _judged: _Left | None = None

    def __post_init__(self) -> None:
        if not self.catalogue:
            self.catalogue = [
                entry
                for entry in EFFECTS.values()
                # Friction that differs by direction shows only at the start from rest, see _by_direction.
                if "accelerations" in entry.kinds and entry.terms and entry.id != "asymmetric_friction"
            ]
        base_terms = {entry.name for entry in self.base.terms}
        self.catalogue = [entry for entry in self.catalogue if not base_terms & set(entry.terms)]

    # The search -----------------------------------------------------------------------------------------

    def run(self, start: Point) -> Step:
        """Return the accepted hypothesis."""
        self.report("fitting the base", 0.15)
        step = self.base_fit(start)
        self.take_weight(step)
        step = self.fit((), [step.fitted.point], rounds=6)
        self.steps = [step]
        self.simulation.forget_weight()
        self.longer.robust = True
        base = self.base_fit(step.fitted.point, rounds=6)
        step = self._grown(base)
        if not step.effects:
            return (small_effect(self, base) if self.small else None) or self.steps[0]
        step = self._another_way(base, step) or step
        self.take_weight(step)
        self.score(step)
        step = min(step, self.polished(step), key=lambda entry: entry.cost)
        self.steps[-1] = step
        directed = by_direction(self, step)
        if directed is None:
            return step
        better, row = directed
        one = next(
            (own.evidence for own in self.ranking if own.accepted and own.id in EFFECTS[row.id].replaces), 0.0
        )
        self.steps.append(better)
        self.ranking.append(replace(row, evidence=one + row.evidence))
        return better

    def _grown(self, step: Step) -> Step:
        """Return ``step`` with what is found beside it, effect by effect, down to the noise floor."""
        while len(step.effects) < self.settings.most_effects:
            self.report(f"trying effects beside {' + '.join(step.effects) or 'the base'}", 0.25)
            better = self._forward(step)
            if better is None:
                break
            if self.coupled is None and holds_damper(self) and self._several_ways(better):
                better = self._couple(better)
            step = self.without_needless(better)
            if self.coupled is None:  # else by free runs in the end, which tell laws of friction apart better
                step = swapped(self, step)
            if step.effects in [entry.effects for entry in self.steps]:
                break
            self.steps.append(step)
            if self._complete(step):
                break
        return step

    def _several_ways(self, step: Step) -> bool:
        """Whether the motion can go several ways with ``step``: free runs do not tell what it leaves."""
        if any(EFFECTS[name].valleys for name in step.effects):
            return True
        return any(EFFECTS[name].rare for name in step.effects) and not self._complete(step, CLOSED)

    def _couple(self, step: Step) -> Step:
        """Return ``step`` fitted with its runs coupled to the measured motion, as all are from now on."""
        point = coupled_fit(self, step)
        step.fitted = replace(step.fitted, point=point, settled=None)
        self.simulation = coupled_simulation(self, self.whole, DAMPING_RATIO, self.settings.longest)
        self.stretches = self.simulation.stretches
        self.coupled = Simulation(self.stretches, self.simulation.motions, self.simulation.damper)
        self._judged = None
        for simulation in (self.simulation, self.coupled):
            simulation.robust = True
        for known in self.steps:
            self.measured(known)
        return self._settled(step)

    def _settled(self, step: Step) -> Step:
        """Return ``step`` fitted with the weight of what it leaves."""
        step = self.polished(step)
        self.take_weight(step)
        for known in self.steps:
            self.score(known)
        return self.polished(step)

    def _complete(self, step: Step, most: float | None = None) -> bool:
        """Whether what ``step`` leaves is noise, up to ``most`` times the floor, in all or usually."""
        most = most or (AT_FLOOR if self.has_kinks(step) else SMOOTH)
        if self._judged is None or self._judged.fitted is not step.fitted:
            self._judged = self._left_by(step)
        self.floor = self._judged.floor
        if self._judged.excess > most and self._judged.counts:
            return False
        return not self._judged.tells

    def _left_by(self, step: Step) -> _Left:
        longer, point = self.coupled or self.longer, step.fitted.point
        if self.has_jumps(step):
            longer.choose_sampling(point)
        training, held = longer.training, longer.held_out
        errors = longer.errors([point], [*training, *held])
        train, other = errors[: len(training)], errors[len(training) :]
        left, before = float(longer.nrmse(other, held)[0]), self.nrmse(self.steps[0])
        floor = noise_floor(longer, point, other)
        excess = min(left / floor.nrmse, usual_excess(other, floor.errors))
        counts = left**2 - floor.nrmse**2 > (OF_GAP * before) ** 2
        tells = counts and excess > CLOSED  # so much is no noise
        if not tells:
            longer.take_weight(train, training, self.least_density)
            rest = remainder(longer, point, train, other)
            tells = rest.tells(left, before, kinks=self.has_kinks(step))
        return _Left(step.fitted, floor.nrmse, excess, counts=counts, tells=tells)

    def _another_way(self, base: Step, found: Step) -> Step | None:
        """Return what grows from the look-alike of the first effect, if ``found`` leaves a gap and it less.

        A first effect, alone, takes what belongs to two; beside the second, its look-alike may fit better.
        """
        if self._complete(found, CLOSED):
            return None
        first = next((row for row in self.ranking if row.accepted and not row.beside), None)
        if first is None or first.id not in EFFECTS:
            return None
        alike = {*EFFECTS[first.id].confused_with, *EFFECTS[first.id].replaces}
        rows = [row for row in self.ranking if not (row.beside or row.accepted or row.reason)]
        rows = [row for row in rows if row.id in alike and row.evidence > NEARLY * first.evidence]
        if not rows:
            return None
        second = max(rows, key=lambda row: row.evidence)
        kept = self.steps, self.ranking, self.catalogue, self.simulation, self.stretches, self.coupled
        start = self.polished(self.tried[second.id, ()])
        ranking = [replace(row, accepted=row is second) for row in self.ranking if not row.beside]
        self.steps, self.ranking = [*self.steps[:1], start], ranking
        self.catalogue = [entry for entry in self.catalogue if entry.id != first.id]
        other = self._grown(start)
        least = min((found, other), key=self.nrmse)
        if self.has_jumps(least):
            self.simulation.choose_sampling(least.fitted.point)
        for step in (base, found, other):
            self.measured(step)
        self.take_weight(least)
        self.score(found)
        self.score(other)
        numbers = len(other.fitted.free) - len(found.fitted.free)
        evidence = found.cost - other.cost - self.price * numbers
        if evidence > max(EVIDENCE, CLEARLY * other.cost):
            self.overruled[first.id] = evidence
            return other
        self.steps, self.ranking, self.catalogue, self.simulation, self.stretches, self.coupled = kept
        self._judged = None
        for step in self.steps:
            self.measured(step)
        return None

    def base_fit(self, start: Point, rounds: int = 10) -> Step:
        """Return the base fitted from ``start`` and from what the regression says."""
        values = start.values
        balance = balance_of(self.regressed, values)
        balance.prepare()
        numbers = joint_numbers(balance.coefficients()[:4], start)
        ring = (values["mass"], *numbers[:2])
        self.simulation.let_start_ring(*ring)
        step = self.fit((), [start, start.moved(BASE_NUMBERS, numbers)], rounds=rounds, tries=2)
        found = step.fitted.point
        self.simulation.let_start_ring(
            found.values["mass"], found.values["spring_stiffness"], found.values["viscous_coefficient"]
        )
        return step

    def _forward(self, step: Step) -> Step | None:
        chosen = candidates(self.simulation, self.regressed, self.catalogue, step)
        tried = self.contained(in_parallel(lambda entry: tried_beside(self, step, entry), chosen))
        for name in (GAIN, DELAY):
            if name in step.fitted.at_bound and name not in step.effects:
                sensor = self.fit((*step.effects, name), [step.fitted.point])
                sensor.trials = step.trials
                tried.append(sensor)
        ranked, sensible = self._sensible(step, tried)
        duels = self.coupled is None and holds_damper(self)
        if not (sensible or step.effects) and duels and not self._complete(step, CLOSED):
            more = overlooked(self.regressed, self.catalogue, step, chosen)
            ranked, sensible = self._sensible(
                step, [*ranked, *(tried_beside(self, step, own) for own in more)]
            )
        if not ranked:
            return None
        for entry in ranked:
            self._note(step, entry)
        ahead = step
        if sensible:
            closest = self.closest(step, self.polished(sensible[0]), sensible[1:])
            ahead = self.simplest(step, closest, ranked)
        least, winner = self.evidence(step, ahead), ahead
        if duels and not self._complete(ahead, CLOSED):
            winner = winner_of_duels(self, step, ahead, ranked)
        if winner is not ahead:
            least += EVIDENCE  # by which a duel is won at least
        elif winner is step:
            return None
        else:
            winner = self._sensor_alone(step, winner) or winner
            if step.effects and not self.still_better(step, winner):
                return None
        name = winner.effects[-1]
        own = [n for n, row in enumerate(self.ranking) if (row.id, row.beside) == (name, step.effects)]
        if not step.effects and self._complete(step, CLOSED) and not beyond_noise(self, step, winner):
            reason = "noise that the base rings with may leave as much"
            self.ranking[own[-1]] = replace(self.ranking[own[-1]], reason=reason)
            return None
        known = max(self.ranking[own[-1]].evidence, self.evidence(step, winner), least)
        self.ranking[own[-1]] = replace(self.ranking[own[-1]], evidence=known, accepted=True, reason="")
        self.tried[name, step.effects] = winner
        return winner

    def _sensible(self, step: Step, tried: list[Step]) -> tuple[list[Step], list[Step]]:
        """Return ``tried``, the best first, and those of them that are not refused."""
        ranked = self._ranked(step, tried) if tried else []
        return ranked, [own for own in ranked if not self.refusal(step, own, self.evidence(step, own))]

    def _ranked(self, step: Step, tried: list[Step]) -> list[Step]:
        """Return ``tried``, the best of them refined, with one weight for all: what the best leaves.

        ``step`` is fitted on with that, too: what it still gains on its own is no evidence for an effect.
        """
        best = min(tried, key=lambda entry: entry.cost)
        if self.has_jumps(best):
            self.simulation.choose_sampling(best.fitted.point)
            for entry in (step, *tried):
                self.measured(entry)
        self.take_weight(best)
        tried.sort(key=lambda entry: entry.cost)
        again = in_parallel(lambda entry: self.polished(entry, rounds=5), tried[:REFINED]) + tried[REFINED:]
        self.score(step)
        closer = self.polished(step, rounds=5)
        if closer.cost < step.cost:
            step.take(closer)
        for entry in again:
            self.score(entry)
        return sorted(again, key=lambda entry: -self.evidence(step, entry))

    def _note(self, step: Step, entry: Step) -> None:
        """Keep ``entry`` in the ranking."""
        evidence = self.evidence(step, entry)
        values = {f.name: entry.fitted.point.get(f.name) for f in entry.fitted.free}
        reason = self.refusal(step, entry, evidence)
        name = entry.effects[-1]
        self.tried[name, step.effects] = entry
        self.ranking.append(
            Hypothesis(name, step.effects, self.nrmse(entry), evidence, values, reason=reason)
        )

    def _sensor_alone(self, step: Step, winner: Step) -> Step | None:
        """Return gain or delay alone where ``winner`` let it free and adds nothing that counts beside it."""
        name = winner.effects[-1]
        freed = tuple(e for e in winner.effects if e in (GAIN, DELAY) and e not in step.effects and e != name)
        if not freed:
            return None
        effects = (*step.effects, *freed)
        point = replace(winner.fitted.point, active=self.terms_of(effects))
        alone = self.polished(self.fit(effects, [point]))
        alone.trials = step.trials
        if self.refusal(step, alone, self.evidence(step, alone)):
            return None
        if not self.refusal(alone, winner, self.evidence(alone, winner)):
            return None
        here = [row for row in self.ranking if row.beside == step.effects]
        self.ranking = [row for row in self.ranking if row not in here]
        for row in here:
            within = set(freed) <= set(self.tried[row.id, row.beside].effects)
            reason = f"beside {' and '.join(freed)} it adds nothing that counts" if within else row.reason
            if row.id != freed[-1]:
                self.ranking.append(replace(row, reason=reason))
        self._note(step, alone)
        return alone

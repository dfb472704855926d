"""Search for the most likely structures: a list of moves over a table of finished fits.

In excerpts of the record a structure is simulated from all guesses of its effects and fitted briefly from
the best ones; the likeliest of a move are fitted to the whole record. Only finished fits are compared, and
all stay in the table, for the decision.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from spool_core.numbers import Array
from spool_core.record_limits import LIMITS
from spool_estimator.identification.chain import CHAIN_PARTS
from spool_estimator.identification.least_squares import in_parallel
from spool_estimator.identification.spectra import ZeroPhase
from spool_sim.observation import CAUSAL, INSTANTS, LINEAR, MEAN, Observation

from spool_gap.catalogue import EFFECTS
from spool_gap.effect import Scale
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.remainder import patterns_of
from spool_gap.likelihood.rest import Rest, rest_of
from spool_gap.likelihood.structure import Limits, Structure
from spool_gap.likelihood.structure_fit import DECISIVE, ENOUGH, Beside, StructureFit, fit_structure

Key = tuple[frozenset[str], frozenset[str]]

#: Guesses from which a brief fit begins, steps of such a fit, and of a finished one at most.
STARTS, QUICK, STEPS = 3, 8, 20
#: Draws around a guess where the likelihood has many maxima, groups of them, and the relative spreads of the
#: first one: of the effect's numbers, and of the base's.
DRAWS, GROUPS, SPREADS = 40, 10, (0.2, 0.03)
#: Fits of a move whose low-pass is looked for.
SETTLED = 2
#: Rise of the log likelihood that ends a fit while structures are only compared.
ROUGH = 3.0
#: Fits of a move that are made on the whole record.
FINALISTS = 2
#: What a fit leaves over what the best one does up to which it is fitted to its end.
NEAR = 1.02
#: Evidence by which a fit is behind that is not worth its last digits.
HOPELESS = 300.0
#: Components of a structure at most: effects, and parts of the chain.
MOST_EFFECTS, MOST_PARTS = 3, 4
#: Share of the rest (rms) that a component takes away at least: laws near rest and low-passes of loggers
#: are described to about that.
LEAST_FALL = 0.01
#: Low-passes of loggers that are tried where a force jumps, each with its corner free; steps of these fits.
OBSERVATIONS = (
    Observation(LINEAR, 4.0, 0.42),
    *(Observation(CAUSAL, order, 0.36, shape=0.0) for order in (2.0, 4.0, 6.0)),
    Observation(MEAN),
    Observation(INSTANTS),
)
OBSERVED = 5
#: Hz, and shares of the reading, of modes of a mounting that are tried; sizes of other parts over their
#: typical one.
MODES, MODE_SHARES, SIZES = (30.0, 60.0, 110.0, 180.0, 300.0, 500.0), (0.05, 0.3), (1.0, 3.0)
#: Share of the motion's reversals that are slower than those that limit what a record resolves.
SLOWEST = 0.1
#: Quantile of the motion that it reaches, force over that of spring and drag there, share of the reach, and
#: samples from which the spool may hit something.
REACH, HARD, ENDS, FEWEST_HARD = 0.995, 1.4, 0.7, 2
#: Share of the force that moves the spool which friction has where another law's guesses begin around it.
ALIKE = 0.15
#: Lines of what the base leaves that may be a force, and how far they must stand out of the median, in power.
PEAKS, STANDS_OUT = 3, 30.0


@dataclass(frozen=True, slots=True)
class Trial:
    """Guesses of one structure, which differ in numbers.

    Attributes:
        guesses: where fits may begin.
        zoom: its likelihood has many maxima.
        shape: names of numbers that say where the force acts, not how much: each value may have a maximum.
    """

    guesses: Sequence[Structure]
    zoom: bool = False
    shape: tuple[str, ...] = ()

    def firsts(self, ranked: Iterable[Guess]) -> list[Guess]:
        """Return the first of ``ranked`` guesses of each shape, of a first effect as it stands and moved.

        Numbers of a base without the effect may be far off, and their slopes lead astray.
        """
        found: dict[tuple[float, ...], Guess] = {}
        for one in ranked:
            bare = len(one.structure.effects) < 2 and not one.structure.parts
            shape = (one.structure.values[name] for name in self.shape)
            found.setdefault((bare and one.moved, *shape), one)
        return list(found.values())


@dataclass(frozen=True, slots=True)
class Guess:
    """A structure with its log likelihood in the excerpts; ``moved``: not as it was guessed."""

    likely: float
    structure: Structure
    moved: bool = False


class Search:
    """Search over structures of one valve and record.

    Attributes:
        fits: the most likely fit of each structure that was fitted to the whole record.
        base: nothing but the base.
        hit: whether the spool may hit something.
    """

    def __init__(
        self,
        predictions: Predictions,
        base: Structure,
        names: Sequence[str],
        tell: Callable[[str, float], None] = lambda _what, _share: None,
        allowed: float = math.inf,
        least_share: float = 0.0,
    ) -> None:
        """Fit the base.

        Args:
            predictions: of the record.
            base: with the numbers of the valve's description.
            names: of the effects that may be missing.
            tell: takes what is done and the share of the work.
            allowed: steps of integration, after which nothing further is tried.
            least_share: of the spool's acceleration, rms, that a component must explain.
        """
        self._least_share = least_share
        self._predictions, self._names, self._tell = predictions, tuple(names), tell
        self._allowed = allowed
        self.fits: dict[Key, StructureFit] = {}
        tell("fitting the base", 0.1)
        self._brief = predictions.excerpt()
        for part in self._brief.parts:
            part.plain = True
        longest = max(predictions.parts, key=lambda one: one.seconds)
        base = replace(base, limits=_resolved_by(longest))
        self._kinds: Sequence[Observation] = OBSERVATIONS
        if predictions.parts[0].readings.means:
            self._kinds = (Observation(MEAN),)
            base = base.read_by(self._kinds[0])
        self._described = {one.name: base.values[one.name] for one in base.unknowns(predictions.seconds)}
        rough = fit_structure(self._brief, base)
        self.base = self.finish(rough.structure)
        self._scale = _scale_of(predictions, self.base.structure)
        self.hit = _hit(longest, self.base.structure)

    @property
    def late(self) -> bool:
        """Whether no further structure is tried."""
        return self._predictions.work + self._brief.work > self._allowed

    @property
    def best(self) -> StructureFit:
        """The structure with the most evidence among those that make sense on a machine."""
        return max(self._sensible(), key=lambda one: one.evidence)

    def _sensible(self) -> list[StructureFit]:
        return [one for one in self.fits.values() if not senseless(one)] or [self.base]

    @property
    def of_each_set(self) -> dict[frozenset[str], StructureFit]:
        """The likeliest fit with each set of effects, whatever its measuring chain."""
        return of_sets(self.fits.values())

    @property
    def simplest(self) -> StructureFit:
        """The structure with the fewest numbers of those that nothing beats by evidence and by its share."""
        best = self.best
        near = [
            one
            for one in self._sensible()
            if one.evidence >= best.evidence - DECISIVE
            or best.beyond(one) < self._least_share
            or best.ratio(one) > 1.0 - LEAST_FALL
        ]
        return min(near, key=lambda one: (one.count, -one.evidence))

    def without(self, fit: StructureFit, name: str) -> StructureFit | None:
        """Return the fit of ``fit`` without the effect ``name``, if there is one."""
        return self.fits.get(fit.structure.without(name).key)

    # Moves ----------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Make the moves by turns while the structure grows, then take each component away."""
        made: set[tuple[str, Key]] = set()
        for number in range(2 * (MOST_EFFECTS + MOST_PARTS)):
            name, move = (("one component more", self._one_more), ("laws that act alike", self._alike))[
                number % 2
            ]
            own = self.simplest.structure
            if (name, own.key) in made or (self.late and number > 0):
                break
            if move == self._one_more and not self._open(self.simplest):
                break
            self._tell(name, 0.15 + 0.3 * number / (MOST_EFFECTS + MOST_PARTS))
            made.add((name, own.key))
            move(own)
        self._tell("one component less", 0.8)
        self._one_less()
        best = self.simplest.structure
        if best.sharp:
            settled = self.finish(self._observed(best)).structure
            if settled.observation != best.observation:
                self._alike(settled)
        if self._predictions.clipped:
            # What the base bridged is far off where much is clipped.
            self._predictions.bridge(self.simplest.structure)
            for key, fit in self.fits.items():
                self.fits[key] = fit_structure(self._predictions, fit.structure, steps=QUICK, enough=ROUGH)
        # Those that come near the best one are fitted to their end.
        most, least = self.best.evidence, NEAR * min(one.left for one in self.fits.values())
        near = [one for one in self._sensible() if one.left <= least or one.evidence >= most - HOPELESS]
        ended = partial(fit_structure, self._predictions, steps=STEPS, enough=ENOUGH)
        for fit in in_parallel(lambda one: ended(one.structure), near):
            self.fits[fit.structure.key] = fit
        self.base = self.fits[self.base.structure.key]

    def _open(self, fit: StructureFit) -> bool:
        """Whether what ``fit`` leaves follows something that a further component may explain."""
        blows = self.hit and not any(EFFECTS[name].localised for name in fit.structure.effects)
        # Blows are in few samples, and no pattern repeats; nor does one beside a motion that is all wrong.
        if blows or fit.left > LIMITS.explains_nothing:
            return True
        patterns = patterns_of(self._predictions, fit)

        def told(one: Rest) -> bool:
            return one.gain > DECISIVE and one.share >= self._least_share

        # Without any the body's motion is known in too few windows to look for one.
        return not patterns or any(map(told, patterns)) or told(rest_of(self._predictions, fit))

    def _one_more(self, own: Structure) -> None:
        """Each effect and each part of the measuring chain beside ``own``."""
        # However late it is, every effect is tried alone.
        late = self.late
        names = () if late and own.effects else self._names
        parts = () if late or len(own.parts) >= MOST_PARTS else CHAIN_PARTS
        rows = self._compared(own, [
            *(self._trial(own, name) for name in names if self._may_add(own, name)),
            *(
                Trial([own.having(own.effects, (*own.parts, key), one) for one in guesses_of_part(key)])
                for key in parts
                if key not in own.parts
            ),
        ])  # fmt: skip
        jumping = [one for one in rows if one.structure.sharp and not own.sharp]
        if jumping:
            # Forces that jump or bend show the logger's low-pass, once the fit is near.
            ranked = sorted(jumping, key=lambda one: -one.evidence)[:SETTLED]
            ended = in_parallel(lambda one: self._roughly(one.structure, STEPS), ranked)
            settled = self._settled(max(ended, key=lambda one: one.evidence))
            seen, goal = settled.structure.observation, settled.log_likelihood - HOPELESS
            others = [one.structure for one in jumping if one.structure.key != settled.structure.key]
            again = in_parallel(lambda one: self._roughly(one.read_by(seen), goal=goal), others)
            rows = [*(one for one in rows if one not in jumping), *again, settled]
        self._finish_best(rows)

    def _alike(self, own: Structure) -> None:
        """Laws of friction in place of that of ``own``, from its force."""
        for name in [one for one in own.effects if EFFECTS[one].is_friction]:
            bare = own.without(name)
            part = self._predictions.parts[0]
            force = float(np.mean(np.abs(part.force_of(own, EFFECTS[name].terms))))
            scale = replace(self._scale, force=force / ALIKE)
            others = [other for other in self._names if other != name and EFFECTS[other].is_friction]
            known = self._roughly(own)
            trials = [self._trial(bare, other, scale) for other in others if not self.late]
            rows = self._compared(own, trials, known.log_likelihood - HOPELESS)
            rows.sort(key=lambda one: -one.evidence)
            least = known.evidence - HOPELESS
            if rows and rows[0].evidence > least:
                rows[0] = self._settled(self._roughly(rows[0].structure, STEPS))
            self._finish_best(rows, least)

    def _one_less(self) -> None:
        """The best structure without each of its components."""
        for _ in range(MOST_EFFECTS):
            own = self.simplest.structure
            fewer = [own.without(name) for name in (*own.effects, *own.parts)]
            self._keep(in_parallel(self._whole, [one for one in fewer if one.key not in self.fits]))
            if self.simplest.structure.key == own.key:
                return

    # Fits -----------------------------------------------------------------------------------------------

    def _trial(self, own: Structure, name: str, scale: Scale | None = None) -> Trial:
        """Return guesses of ``own`` with the effect ``name``."""
        scale = scale or self._scale
        guesses = EFFECTS[name].guesses(scale)
        stronger = EFFECTS[name].guesses(replace(scale, force=2.0 * scale.force))
        fitted = [key for key in EFFECTS[name].fitted if key not in EFFECTS[name].amplitudes]
        shape = [
            key for key in fitted
            if all(a.get(key) == b.get(key) for a, b in zip(guesses, stronger, strict=True))
        ]  # fmt: skip
        wider = own.having((*own.effects, name), own.parts, guesses[0] if guesses else None)
        # Numbers of a base without a stop or friction may be far off: those of the description, too.
        besides = ({}, self._described) if not own.effects else ({},)
        starts = [wider.moved({**beside, **one}) for beside in besides for one in guesses]
        zoom = EFFECTS[name].localised or EFFECTS[name].local_minima
        return Trial(starts or [wider], zoom, () if zoom else tuple(shape))

    def _compared(
        self, own: Structure, trials: Sequence[Trial], goal: float = -math.inf
    ) -> list[StructureFit]:
        """Return the best brief fit of each of ``trials``; those that stay far below ``goal`` end early.

        Each guess is taken as it stands, and with the numbers of ``own`` that meet the record beside it.

        The one with the likeliest guess goes first, and those that cost most last: each group shows what the
        next one has to come near.
        """
        beside = Beside(self._brief, own)
        ranked = in_parallel(lambda one: self._likeliest(one.guesses, beside), trials)
        order = sorted(range(len(trials)), key=lambda place: -ranked[place][0].likely)
        plain = [place for place in order if not trials[place].zoom]
        zoomed = [place for place in order if trials[place].zoom]
        found: dict[int, StructureFit] = {}
        for group in (plain[:1], plain[1:], zoomed):
            work = partial(self._best_of, goal=goal)
            rows = in_parallel(work, [(trials[place], ranked[place]) for place in group])
            found |= dict(zip(group, rows, strict=True))
            goal = max([goal, *(one.log_likelihood - HOPELESS for one in rows)])
        return [found[place] for place in range(len(trials))]

    def _best_of(self, trial_and_ranked: tuple[Trial, Sequence[Guess]], goal: float) -> StructureFit:
        """Return the best brief fit from the likeliest guess of each shape, or from draws around the best."""
        trial, ranked = trial_and_ranked
        found: list[StructureFit] = []
        for start in trial.firsts(ranked)[:STARTS]:
            one = self._zoomed(start, goal) if trial.zoom else start.structure
            found.append(self._roughly(one, goal=goal))
            goal = max(goal, found[-1].log_likelihood)
        return max(found, key=lambda one: one.evidence)

    def _likeliest(self, trials: Sequence[Structure], beside: Beside | None = None) -> list[Guess]:
        """Return ``trials`` by their log likelihood in the excerpts, as they stand, the likeliest first.

        ``beside``: what also moves the numbers that are known.
        """
        bounded = [one.bounded(self._predictions.seconds) for one in trials]
        bounded = [one for one in bounded if not _senseless(one)] or bounded
        errors, as_they_stand = self._brief.errors(bounded), len(bounded)
        if beside is not None:
            met = [beside.met(*each) for each in zip(bounded, errors, strict=True)]
            bounded, errors = bounded + met, errors + self._brief.errors(met)
        likely = [self._brief.log_likelihood(lines) for lines in errors]
        moved = [place >= as_they_stand for place in range(len(bounded))]
        rows = map(Guess, likely, bounded, moved)
        return sorted(rows, key=lambda one: -one.likely)

    def _zoomed(self, start: Guess, goal: float) -> Structure:
        """Return the likeliest of draws around ``start``, each group around the best of the one before.

        The likelihood has many maxima there. Source: Rubinstein, The cross-entropy method, 1999.
        """
        known, one = start.likely, start.structure
        generator = np.random.default_rng(0)
        rises: list[float] = []
        own = [number for name in one.effects for number in EFFECTS[name].fitted]
        names = [*own, *(unknown.name for unknown in one.base_unknowns)]
        spread = np.where(np.arange(len(names)) < len(own), *SPREADS)
        centre = np.array([one.values[name] for name in names])
        for left in reversed(range(GROUPS)):
            draws = centre * np.exp(spread * generator.standard_normal((DRAWS, len(names))))
            trials = [one.moved(dict(zip(names, row, strict=True))) for row in draws.tolist()]
            trials = [each for each in trials if not _senseless(each)]
            first, *others = self._likeliest([one, *trials])[: DRAWS // 4]
            value, one = first.likely, first.structure
            rises.append(value - known)
            if len(rises) > 1 and value + left * max(rises) < goal:
                break
            known = value
            kept = [one, *(each.structure for each in others)]
            best = np.array([[abs(each.values[name]) + 1e-12 for name in names] for each in kept])
            centre = best.mean(axis=0)
            spread = np.log(best).std(axis=0) + 1e-4
        return one

    def _roughly(self, one: Structure, steps: int = QUICK, goal: float = -math.inf) -> StructureFit:
        """Return a brief fit of ``one`` in the excerpts."""
        return fit_structure(self._brief, one, steps=steps, enough=ROUGH, goal=goal)

    def _settled(self, near: StructureFit) -> StructureFit:
        """Return the brief fit ``near`` with the low-pass that it shows at its end."""
        seen = self._observed(near.structure)
        return near if seen.observation == near.structure.observation else self._roughly(seen, STEPS)

    def _observed(self, own: Structure) -> Structure:
        """Return ``own`` with the logger's low-pass that is likeliest beside it."""
        for part in self._brief.parts:
            part.beside = True
        known = self._roughly(own, OBSERVED)
        read = partial(self._roughly, steps=OBSERVED, goal=known.log_likelihood)
        # Of a low-pass without phase the order is fitted, so that one start will do.
        kinds = [one for one in self._kinds if {one.kind, own.observation.kind} != {LINEAR}]
        others = in_parallel(read, [own.read_by(one) for one in kinds])
        for part in self._brief.parts:
            part.beside = False
        return max([known, *others], key=lambda one: one.evidence).structure

    def _finish_best(self, rows: Sequence[StructureFit], least: float = -math.inf) -> None:
        """Fit the best of ``rows`` to the whole record, those with an evidence of ``least`` or more."""
        ranked = sorted(rows, key=lambda one: (bool(senseless(one)), -one.evidence))
        best = [] if self.late else ranked[:FINALISTS]
        # Others are shown, and not worth their last digits.
        near = [one for one in best if one.evidence >= max(least, best[0].evidence - HOPELESS)]
        self._keep(in_parallel(lambda one: self._whole(one.structure, STEPS * (one in near)), ranked))

    def _whole(self, one: Structure, steps: int = STEPS) -> StructureFit:
        """Return a fit of ``one`` to the whole record."""
        return fit_structure(self._predictions, one, steps=steps, enough=ROUGH)

    def _keep(self, fits: Sequence[StructureFit]) -> None:
        """Keep each of ``fits`` that is likelier than what is known of its structure."""
        for fit in fits:
            known = self.fits.get(fit.structure.key)
            # Numbers that make no sense on a machine never hide others that do.
            if known is None or (not senseless(fit), fit.evidence) > (not senseless(known), known.evidence):
                self.fits[fit.structure.key] = fit

    def finish(self, one: Structure) -> StructureFit:
        """Fit ``one`` to the whole record; keep it where it is likelier than what is known."""
        self._keep([self._whole(one)])
        return self.fits[one.key]

    def _may_add(self, own: Structure, name: str) -> bool:
        if len(own.effects) >= MOST_EFFECTS or set(EFFECTS[name].terms) & set(own.terms):
            return False
        if EFFECTS[name].is_friction and any(EFFECTS[one].is_friction for one in own.effects):
            return False
        return bool(EFFECTS[name].guesses(self._scale))


def of_sets(fits: Iterable[StructureFit]) -> dict[frozenset[str], StructureFit]:
    """Return the likeliest of ``fits`` with each set of effects."""
    rising = sorted(fits, key=lambda one: one.evidence)
    return {frozenset(one.structure.effects): one for one in rising}


def guesses_of_part(key: str) -> list[dict[str, float]]:
    """Return numbers of the part ``key`` of the chain from which fits begin."""
    size, *others = CHAIN_PARTS[key].parameters
    if CHAIN_PARTS[key].id == "extra_mode":
        damping = {others[1].name: others[1].start}
        return [
            {size.name: share, others[0].name: frequency, **damping}
            for frequency in MODES
            for share in MODE_SHARES
        ]
    signs = (1.0, -1.0) if size.low < 0.0 else (1.0,)
    rest = {one.name: 0.0 for one in others}
    return [{size.name: sign * one * size.start, **rest} for one in SIZES for sign in signs]


def senseless(fit: StructureFit) -> str:
    """Return which numbers of the effects make no sense on a machine and why, "" where all do."""
    return _senseless(fit.structure)


def _senseless(one: Structure) -> str:
    reasons = (EFFECTS[name].sensible(one.values, {}) for name in one.effects)
    return next((reason for reason in reasons if reason), "")


def _scale_of(predictions: Predictions, base: Structure) -> Scale:
    """Return the sizes of the measured motion; ``base``: as fitted."""
    rows = [_measured(part) for part in predictions.parts]
    z, v = (np.abs(np.concatenate(row)) for row in zip(*rows, strict=True))
    force = base.values["mass"] * float(np.std(np.concatenate([part.spool for part in predictions.parts])))
    peaks = [peak for part in predictions.parts[:1] for peak in _peaks(part, base)]
    return Scale(
        force,
        max(float(np.quantile(z, 0.999)), 1e-9),
        max(float(np.quantile(v, 0.99)), 1e-9),
        predictions.seconds,
        tuple(peaks),
    )


def _peaks(part: Prediction, base: Structure) -> list[tuple[float, float, float]]:
    """Return frequency (Hz), amplitude (N), phase of forces whose lines stand out of what ``base`` leaves."""
    error = (part.spool - part.responses([base]).acceleration[0]) * part.counted
    taper = np.hanning(error.size)
    length = 8 * error.size
    lines = np.fft.rfft(error * taper, length)
    frequency = np.fft.rfftfreq(length, part.period)
    power = np.where((frequency > part.lines[0]) & (frequency < part.lines[-1]), np.abs(lines) ** 2, 0.0)
    level = float(np.median(power[power > 0.0])) if np.any(power > 0.0) else math.inf
    found = []
    for _ in range(PEAKS):
        place = int(np.argmax(power))
        if power[place] < STANDS_OUT * level:
            break
        own = float(frequency[place])
        turn = 2j * np.pi * own
        mass, stiffness = base.values["mass"], base.values["spring_stiffness"]
        moved = turn**2 / (mass * turn**2 + base.values.get("viscous_coefficient", 0.0) * turn + stiffness)
        # A term takes amplitude * sin(2 pi f t + phase) off the spool's force.
        size = 2.0 * lines[place] * np.exp(-turn * part.time) / taper.sum() / moved
        found.append((own, abs(size), float(np.angle(size) + 0.5 * np.pi)))
        power[np.abs(frequency - own) < 4.0 / (error.size * part.period)] = 0.0
    return found


def _measured(part: Prediction) -> tuple[Array, Array]:
    """Return displacement (m) and velocity (m/s) that the accelerometers of ``part`` show."""
    band, relative = ZeroPhase(part.period, part.readings.low_cut), part.spool - part.body
    return band.apply(relative, 2), band.apply(relative, 1)


def _resolved_by(part: Prediction) -> Limits:
    """Return what ``part`` resolves of laws of friction, by the measured motion."""
    displacement, velocity = _measured(part)
    turns = np.abs((part.spool - part.body)[:-1][np.diff(np.sign(velocity)) != 0.0])
    slowest = part.period * float(np.quantile(turns, SLOWEST)) if turns.size else 0.0
    return Limits(slowest, float(np.abs(displacement).max()))


def _hit(part: Prediction, base: Structure) -> bool:
    """Whether the spool may hit something: springs and drag of ``base`` do not make its largest forces."""
    displacement, velocity = (np.abs(row) for row in _measured(part))
    reach, fastest = (float(np.quantile(row, REACH)) for row in (displacement, velocity))
    largest = base.values["spring_stiffness"] * reach + base.values.get("viscous_coefficient", 0.0) * fastest
    strong = part.valve.moving_mass * np.abs(part.spool) * part.counted > HARD * largest
    # A spike of a sensor is as strong, and anywhere in the stroke.
    outside = displacement > ENDS * reach
    return int((strong & outside).sum()) >= max(FEWEST_HARD, int((strong & ~outside).sum()))

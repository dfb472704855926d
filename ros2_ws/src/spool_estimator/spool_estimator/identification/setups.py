"""Joint fit of several set-ups of one valve.

Set-ups differ in what is known: springs, oil, an added mass. A parameter that set-ups share is one unknown,
each other one is a set-up's own. One record determines mass, stiffness and drag only together; a mass that is
added in one of two set-ups with the same springs separates them.

Each set-up is first fitted by itself (:func:`.fit.follow`), which gives its weights and its start. The
weighted residuals of all set-ups then are one least-squares problem. A change of a set-up's own point, as by
the noise of its excitation, moves the joint point by the least-squares solution for the residual it makes.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import Quantity, Validity
from spool_sim.model import Model
from spool_sim.valve import Valve

from spool_estimator.identification import least_squares
from spool_estimator.identification.determination import (
    TOGETHER,
    Determination,
    by_information,
    hidden_by_name,
    refuted,
)
from spool_estimator.identification.equation_error import NoiseEffect, input_noise_effect
from spool_estimator.identification.fit import (
    ENOUGH,
    REWEIGHED,
    ROUNDS,
    UNTOLD,
    Ended,
    family_of,
    follow,
    free_run_agreement,
    inside,
    likeliest_reading,
    refine,
    unknowns_of,
)
from spool_estimator.identification.fit_check import at_result
from spool_estimator.identification.fit_result import MASS, SPOOL_DELAY, SPOOL_GAIN, Fit, FitSettings
from spool_estimator.identification.record import Record
from spool_estimator.identification.residuals import (
    Residuals,
    Weighted,
    fit_covariance,
    information_criterion,
    standard_deviations,
)

#: The parameter that follows the viscosity of the oil.
DRAG = "viscous_coefficient"
#: The one by which set-ups that share springs show their mass, and masses at which that is looked for.
STIFFNESS, FINE = "spring_stiffness", 20_001
#: A set-up does not agree where its error in the joint fit is over so many times that of its separate fit
#: and a share of the measured motion.
AGREES, LEAST_SHARE = 1.5, 0.005
#: Factors on the mass from which a joint fit of the mass starts, and how many of these are followed.
MASSES, FOLLOWED = tuple(2.0 ** (0.25 * step) for step in range(-4, 5)), 3


@dataclass(frozen=True, slots=True)
class SetUp:
    """Records of one valve in one known state.

    Attributes:
        name: for messages and results.
        records: stretches without gaps.
        valve: description with what is known here: springs, oil, the added mass in ``moving_mass``.
        held: parameters that are known here, with their values.
        added_mass: kg, of ``valve`` over the valve that all set-ups share.
        drag_ratio: of the oil's viscosity here to that at which a shared drag holds.
    """

    name: str
    records: tuple[Record, ...]
    valve: Valve
    held: Mapping[str, float] = field(default_factory=dict)
    added_mass: float = 0.0
    drag_ratio: float = 1.0


@dataclass(frozen=True, slots=True)
class JointFit:
    """A model fitted to several set-ups together.

    An unknown of all set-ups has the parameter's name; for others the set-ups follow in brackets:
    ``spring_stiffness[soft, loaded]``.

    Attributes:
        model: what was fitted.
        reason: why there is no result, ``None`` where there is one.
        converged: the descent ended at a minimum.
        parameters: all unknowns with their standard deviations; value NaN where the records do not tell it.
        not_observable: names of those.
        combinations: what the records tell of them instead.
        determinations: judgement of each unknown from all set-ups together.
        alone: judgement of each parameter from each set-up by itself, by its name.
        correlation: of ``observable``, shape (p, p).
        observable: names of its rows.
        fits: what the joint fit says of each set-up, in the order of the set-ups.
        stopped_early: as of a :class:`.Fit`.
    """

    model: Model
    reason: str | None = None
    converged: bool = False
    parameters: tuple[Quantity, ...] = ()
    not_observable: tuple[str, ...] = ()
    combinations: tuple[Quantity, ...] = ()
    determinations: tuple[Determination, ...] = ()
    alone: Mapping[str, tuple[Determination, ...]] = field(default_factory=dict)
    correlation: Array = field(default_factory=lambda: np.empty((0, 0)))
    observable: tuple[str, ...] = ()
    fits: tuple[Fit, ...] = ()
    stopped_early: bool = False


@dataclass(frozen=True, slots=True)
class _Part:
    """A set-up in the joint fit.

    Its unknowns are ``scales`` times the joint ones called ``names``, plus ``offsets``. ``residuals`` has all
    of them, and ``seen`` marks those that its fit by itself found.
    """

    setup: SetUp
    settings: FitSettings
    ended: Ended
    residuals: Residuals
    names: tuple[str, ...]
    scales: Array
    offsets: Array
    seen: NDArray[np.bool_]

    @property
    def unknowns(self) -> tuple[least_squares.Unknown, ...]:
        return self.residuals.unknowns


class _Joint(Weighted):
    """Weighted residuals of all set-ups, one behind the other."""

    def __init__(self, parts: Sequence[_Part], unknowns: Sequence[least_squares.Unknown]) -> None:
        self.parts = tuple(parts)
        self.unknowns = tuple(unknowns)
        self.values: dict[str, float] = {}

    @property
    def work(self) -> least_squares.Work:
        return self.parts[0].residuals.work

    @property
    def steps(self) -> float:
        return sum(part.residuals.steps for part in self.parts)

    def own(self, part: _Part, points: Array) -> Array:
        """Return the points of ``part`` that belong to the joint ``points`` (s, u)."""
        place = {unknown.name: n for n, unknown in enumerate(self.unknowns)}
        columns = [
            points[:, place[name]] if name in place else np.full(len(points), self.values[name])
            for name in part.names
        ]
        return np.asarray(np.array(columns).T * part.scales + part.offsets)

    def map(self, part: _Part) -> Array:
        """Return the slopes of a part's unknowns in the joint ones, shape (own, u)."""
        place = {unknown.name: n for n, unknown in enumerate(self.unknowns)}
        slopes = np.zeros((len(part.names), len(self.unknowns)))
        for row, name in enumerate(part.names):
            if name in place:
                slopes[row, place[name]] = part.scales[row]
        return slopes

    def residuals(self, points: Array) -> Array:
        rows = [part.residuals.residuals(self.own(part, points)) for part in self.parts]
        return np.concatenate(rows, axis=1)

    def central_slopes(self, point: Array) -> Array:
        """Return the Jacobian: each set-up depends on its own unknowns only."""
        rows = [
            part.residuals.central_slopes(self.own(part, point[np.newaxis])[0]) @ self.map(part)
            for part in self.parts
        ]
        return np.concatenate(rows)

    def late(self, point: Array, samples: float) -> Array:
        rows = [part.residuals.late(self.own(part, point[np.newaxis])[0], samples) for part in self.parts]
        return np.concatenate(rows)

    def delay_by(self, samples: float) -> None:
        for part in self.parts:
            part.residuals.delay_by(samples)

    def reweigh(self, point: Array) -> None:
        for part in self.parts:
            part.residuals.reweigh(self.own(part, point[np.newaxis])[0])

    @property
    def blocks(self) -> list[slice]:
        found: list[slice] = []
        for part in self.parts:
            offset = found[-1].stop if found else 0
            found += [slice(one.start + offset, one.stop + offset) for one in part.residuals.blocks]
        return found


def fit_setups(
    setups: Sequence[SetUp], model: Model, shared: Mapping[str, Sequence[Sequence[str]]],
    settings: FitSettings | None = None, tell: Callable[[float], None] = lambda _steps: None
) -> JointFit:  # fmt: skip
    """Return ``model`` fitted to all ``setups`` together; bad data make a result with a reason.

    Args:
        setups: two or more, of one valve.
        model: any composition of force terms.
        shared: groups of set-ups that share a parameter, by its name (of the model, or ``spool_gain`` or
            ``spool_delay``).
        settings: as of a fit, for every set-up.
        tell: takes the simulated steps since it was last called, of ``settings.allowed`` for each set-up at
            most.

    Raises:
        InputError: settings or ``shared`` name parameters that the model does not have.
    """
    chosen = settings or FitSettings()
    work = least_squares.Work(len(setups) * chosen.allowed, tell)
    alone, early = list[tuple[SetUp, FitSettings, tuple[least_squares.Unknown, ...], Ended]](), False
    for place, setup in enumerate(setups):
        work.take(1.0 / (len(setups) + 1 - place))
        own = _settings_of(setup, model, shared, chosen)
        unknowns = unknowns_of(model, setup.valve, own)
        try:
            values = model.values_for(setup.valve, {**own.start, **own.held})
            ended = follow(setup.records, model, setup.valve, own, unknowns, values, work)
            early |= work.cut
            alone.append((setup, own, unknowns, ended))
        except InputError as error:
            return JointFit(model, reason=f"set-up '{setup.name}': {error}")
        except (np.linalg.LinAlgError, FloatingPointError, OverflowError, ValueError) as error:
            return JointFit(model, reason=f"set-up '{setup.name}': the numbers broke down: {error}")
    work.take(1.0)
    # One logger reads all alike, and one set-up may show its low-pass better than another.
    seen = {family_of(one.residuals.observation): one.residuals.observation for *_, one in alone}
    parts = [
        _part(setup, shared, own, likeliest_reading(ended, seen.values()), unknowns, len(setups))
        for setup, own, unknowns, ended in alone
    ]
    try:
        found = _joined(parts, model, shared, chosen)
        early |= found.stopped_early
        fits = tuple(replace(one, stopped_early=early) for one in found.fits)
        found = replace(found, stopped_early=early, fits=fits)
    except (np.linalg.LinAlgError, FloatingPointError, OverflowError, ValueError) as error:
        return JointFit(model, reason=f"the numbers broke down: {error}")
    if found.reason is not None:
        return found
    weightless = tuple(name for name in found.not_observable if _parameter(name) == MASS)
    if not weightless or chosen.force_free:
        return found
    # All other numbers are known over the mass: a fit as if it had not been freed.
    again = fit_setups(
        setups, model, {name: groups for name, groups in shared.items() if name != MASS},
        replace(
            chosen,
            free=tuple(name for name in chosen.free if name != MASS),
            start={name: value for name, value in chosen.start.items() if name != MASS},
        ),
        tell,
    )  # fmt: skip
    if again.reason is not None:
        return again
    lost = tuple(
        replace(one, held_at=parts[0].setup.valve.moving_mass - parts[0].setup.added_mass)
        for one in found.determinations
        if one.name in weightless
    )
    return replace(
        again,
        parameters=(*(Quantity(name, "kg") for name in weightless), *again.parameters),
        not_observable=(*weightless, *again.not_observable),
        determinations=(*lost, *again.determinations),
        alone=found.alone,
        stopped_early=found.stopped_early or again.stopped_early,
    )


def _parameter(name: str) -> str:
    return name.partition("[")[0]


def _group(name: str, setup: SetUp, shared: Mapping[str, Sequence[Sequence[str]]]) -> tuple[str, ...]:
    """Return the set-ups that share parameter ``name`` with ``setup``, itself included."""
    for group in shared.get(name, ()):
        if setup.name in group:
            return tuple(group)
    return (setup.name,)


def _settings_of(
    setup: SetUp, model: Model, shared: Mapping[str, Sequence[Sequence[str]]], settings: FitSettings
) -> FitSettings:
    here = [name for name, groups in shared.items() if any(setup.name in group for group in groups)]
    free = [name for name in here if name not in (SPOOL_GAIN, SPOOL_DELAY)]
    for name in free:
        model.parameter(name, "shared")
    start = {name: value for name, value in settings.start.items() if name not in setup.held}
    if MASS in start:
        start[MASS] += setup.added_mass
    if DRAG in start and len(_group(DRAG, setup, shared)) > 1:
        start[DRAG] *= setup.drag_ratio
    return replace(
        settings,
        held={**settings.held, **setup.held},
        free=tuple(dict.fromkeys((*(n for n in settings.free if n not in setup.held), *free))),
        start=start,
        fit_gain=settings.fit_gain or SPOOL_GAIN in here,
        fit_delay=settings.fit_delay or SPOOL_DELAY in here,
        check=False,
    )


def _part(
    setup: SetUp, shared: Mapping[str, Sequence[Sequence[str]]], settings: FitSettings, ended: Ended,
    unknowns: tuple[least_squares.Unknown, ...], count: int
) -> _Part:  # fmt: skip
    names, scales, offsets = [], [], []
    for unknown in unknowns:
        group = _group(unknown.name, setup, shared)
        names.append(unknown.name if len(group) == count else f"{unknown.name}[{', '.join(group)}]")
        scales.append(setup.drag_ratio if unknown.name == DRAG and len(group) > 1 else 1.0)
        offsets.append(setup.added_mass if unknown.name == MASS else 0.0)
    fitted = {unknown.name for unknown in ended.residuals.unknowns}
    residuals = ended.residuals
    seen = np.array([unknown.name in fitted for unknown in unknowns])
    whole = Residuals(residuals.run, unknowns, residuals.values, residuals.band)
    whole.observation, whole.spectrum, whole.kept = residuals.observation, residuals.spectrum, residuals.kept
    return _Part(
        setup, settings, ended, whole, tuple(names), np.array(scales), np.array(offsets), seen
    )  # fmt: skip


def _unknowns(parts: Sequence[_Part]) -> tuple[list[least_squares.Unknown], Array]:
    """Return the joint unknowns within the bounds of all set-ups, and where to start."""
    found: dict[str, list[least_squares.Unknown]] = {}
    starts: dict[str, list[tuple[bool, float]]] = {}
    for part in parts:
        ended = dict(
            zip((u.name for u in part.ended.residuals.unknowns), part.ended.best.point.tolist(), strict=True)
        )
        for place, unknown in enumerate(part.unknowns):
            scale, offset = float(part.scales[place]), float(part.offsets[place])
            value = ended.get(unknown.name, part.residuals.values.get(unknown.name, 0.0))
            name = part.names[place]
            low = (unknown.low - offset) / scale
            found.setdefault(name, []).append(
                replace(
                    unknown, name=name, low=max(low, unknown.low), high=(unknown.high - offset) / scale,
                    scale=unknown.scale / scale,
                )
            )  # fmt: skip
            starts.setdefault(name, []).append((unknown.name in ended, (value - offset) / scale))
    unknowns = [
        replace(own[0], low=max(one.low for one in own), high=min(one.high for one in own))
        for own in found.values()
    ]
    point = []
    for every in starts.values():
        fitted = [value for was_fitted, value in every if was_fitted]
        point.append(float(np.median(fitted or [value for _, value in every])))
    return unknowns, inside(np.array(point), unknowns)


def _joined(
    parts: Sequence[_Part], model: Model, shared: Mapping[str, Sequence[Sequence[str]]], settings: FitSettings
) -> JointFit:
    unknowns, start = _unknowns(parts)
    whole = _Joint(parts, unknowns)
    names = [unknown.name for unknown in unknowns]
    unseen = least_squares.unseen_directions(_law(whole, start), least_squares.sizes_of(unknowns, start))
    given = {name for name in shared if any(p.name == name and p.valve_attribute for p in model.parameters)}
    order = sorted(range(len(unknowns)), key=lambda n: _parameter(names[n]) in (*given, *settings.free))
    gauge = () if settings.force_free else least_squares.to_hold(
        unseen[:, order], [names[n] for n in order]
    )  # fmt: skip
    free = [n for n, name in enumerate(names) if name not in gauge]
    joint = _Joint(parts, [unknowns[n] for n in free])
    joint.values = dict(zip(names, start.tolist(), strict=True))
    first = by_information(
        joint.unknowns, start[free], joint.central_slopes(start[free]),
        hidden_by_name(unseen[:, free], [names[n] for n in free]),
    )  # fmt: skip
    starts = _mass_starts(parts, names, start)[:, free] if MASS in names else start[free][np.newaxis]
    best = joint.descend(starts, ROUNDS, ENOUGH, min(FOLLOWED, len(starts)))
    apart = _apart(joint, best.point)
    if apart:
        return JointFit(model, reason=apart)
    best = refine(joint, best, REWEIGHED)
    moves = _moves(joint, best.point, joint.central_slopes(best.point))
    ended, covariance = fit_covariance(
        joint, best.point, least_squares.sizes_of(joint.unknowns, best.point), settings,
        max(entry.rate_std for part in parts for entry in part.setup.records),
    )  # fmt: skip
    best = replace(best, point=inside(ended, joint.unknowns))
    seconds, here = settings.noise_seconds, best.point[np.newaxis]
    effects = [
        input_noise_effect(part.residuals, joint.own(part, here)[0], part.seen, seconds)
        for part in joint.parts
    ]
    effect = _together(effects, moves)
    shown = np.isfinite(np.diag(covariance))
    if effect is not None and shown.all():
        moved, covariance = effect.taken_off(best.point, covariance)
        best = replace(best, point=inside(moved, joint.unknowns))
    values = dict(joint.values)
    values.update(zip((u.name for u in joint.unknowns), best.point.tolist(), strict=True))
    ends = np.array([values[name] for name in names])
    unseen = least_squares.unseen_directions(_law(whole, ends), least_squares.sizes_of(unknowns, ends))
    lost, told = least_squares.combinations(
        unseen, names, [u.unit for u in unknowns], values, least_squares.sizes_of(unknowns, ends)
    )
    hidden = hidden_by_name(unseen, names)
    judged = at_result(joint, joint.unknowns, ended, covariance, hidden, first)
    lost += tuple(
        unknown.name
        for unknown, one, value, deviation in zip(
            joint.unknowns, judged, ended, standard_deviations(covariance), strict=True
        )
        if refuted(one, unknown, float(value), float(deviation))
    )
    judged += [
        Determination(name, unknowns[names.index(name)].unit, TOGETHER, together_with=hidden.get(name, ()))
        for name in gauge
    ]
    wide = np.full((len(names), len(names)), 0.0)
    wide[np.ix_(free, free)] = covariance
    wide[[n for n in range(len(names)) if n not in free]] = math.nan
    parameters = tuple(
        _quantity(unknown, values[unknown.name], wide[n, n], unknown.name in lost)
        for n, unknown in enumerate(unknowns)
    )
    unclear = tuple(one.name for one in parameters if not math.isfinite(one.value))
    observable = [n for n in free if names[n] not in unclear]
    spread = np.sqrt(np.diag(wide)[observable])
    return JointFit(
        model,
        converged=best.converged,
        parameters=parameters,
        not_observable=unclear,
        combinations=tuple(_combined(one, covariance, free) for one in told),
        determinations=tuple(judged),
        alone={
            part.setup.name: _alone(whole, part, ends, settings, effect)
            for part, effect in zip(parts, effects, strict=True)
        },
        correlation=wide[np.ix_(observable, observable)] / np.outer(spread, spread),
        observable=tuple(names[n] for n in observable),
        fits=tuple(
            _fit_of(whole, part, ends, wide, unclear, {one.name: one for one in judged}, best.converged)
            for part in parts
        ),
        stopped_early=joint.work.cut,
    )


def _mass_starts(parts: Sequence[_Part], names: Sequence[str], start: Array) -> Array:
    """Return starts with other masses than those of the valve's description, shape (s, u).

    A set-up by itself shows forces over its mass: with another mass all its forces are as much larger. With
    the right one the stiffness of springs that set-ups share, which resonances show best, is the same in all.
    """
    place = {name: n for n, name in enumerate(names)}
    usual = parts[0].residuals.values[MASS] - parts[0].setup.added_mass
    over_mass: dict[str, list[float]] = {}
    added: dict[str, list[float]] = {}
    for part in parts:
        fitted = (unknown.name for unknown in part.ended.residuals.unknowns)
        # A set-up's own fit may have held another number in place of the mass.
        own = {**part.residuals.values, **dict(zip(fitted, part.ended.best.point.tolist(), strict=True))}
        for unknown, name, scale in zip(part.unknowns, part.names, part.scales, strict=True):
            if unknown.unit.startswith("N"):
                over_mass.setdefault(name, []).append(own[unknown.name] / own[MASS] / float(scale))
                added.setdefault(name, []).append(part.setup.added_mass)

    def forces(name: str, masses: Array) -> Array:
        return np.asarray(np.array(over_mass[name]) * (masses[:, np.newaxis] + np.array(added[name])))

    masses = usual * np.array(MASSES)
    springs = [name for name, known in added.items() if _parameter(name) == STIFFNESS and len(set(known)) > 1]
    fine = usual * np.geomspace(MASSES[0], MASSES[-1], FINE)
    for name in springs:
        rows = forces(name, fine)
        masses = np.append(masses, fine[np.argmin(rows.std(axis=1) / rows.mean(axis=1))])
    found = [start]
    for mass in masses:
        row = start.copy()
        row[place[MASS]] = mass
        for name in over_mass:
            row[place[name]] = np.median(forces(name, masses[masses == mass]))
        found.append(row)
    return np.array(found)


def _apart(joint: _Joint, point: Array) -> str:
    """Return why the set-ups do not agree at the joint ``point`` (u,), empty where they do."""
    for part in joint.parts:
        alone = _error(part.ended.residuals, part.ended.best.point)
        together = _error(part.residuals, joint.own(part, point[np.newaxis])[0])
        rows = [window.measured for window in part.residuals.run.windows]
        motion = math.sqrt(float(np.mean(np.concatenate(rows) ** 2)))
        if together > AGREES * alone + LEAST_SHARE * motion:
            return (
                f"the set-ups do not agree: together they leave {100.0 * together / motion:.3g} % of the "
                f"spool's acceleration of set-up '{part.setup.name}', its own fit leaves "
                f"{100.0 * alone / motion:.3g} %; check springs, oil and added masses, or share less"
            )
    return ""


def _error(residuals: Residuals, point: Array) -> float:
    """Return model - measured at ``point`` (u,), rms, m/s^2."""
    rows = [columns[0] for columns in residuals.differences(residuals.respond(point[np.newaxis]))]
    return math.sqrt(float(np.mean(np.concatenate(rows) ** 2)))


def _law(joint: _Joint, point: Array) -> Array:
    """Return the slopes of the forces of all set-ups in the joint unknowns at ``point`` (u,)."""
    return np.concatenate(
        [
            part.ended.law.force_slopes(inside(joint.own(part, point[np.newaxis])[0], part.unknowns))
            @ joint.map(part)
            for part in joint.parts
        ]
    )


def _moves(joint: _Joint, point: Array, slopes: Array) -> list[Array]:
    """Return by how much a change of what each set-up's own fit found moves the joint point, (u, seen)."""
    sizes = least_squares.sizes_of(joint.unknowns, point)
    found, offset = [], 0
    for part in joint.parts:
        own = part.residuals.central_slopes(joint.own(part, point[np.newaxis])[0])[:, part.seen]
        # Rows of the other set-ups are 0: only this one's slopes meet it.
        here = slopes[offset : offset + len(own)] * sizes
        offset += len(own)
        found.append(
            sizes[:, np.newaxis] * (np.linalg.pinv((slopes * sizes).T @ (slopes * sizes)) @ here.T @ own)
        )
    return found


def _together(effects: Sequence[NoiseEffect | None], moves: Sequence[Array]) -> NoiseEffect | None:
    """Return the effect of the noise of all excitations on the joint point; ``None`` without noise."""
    known = [(one, move) for one, move in zip(effects, moves, strict=True) if one is not None]
    if not known:
        return None
    return NoiseEffect(
        np.sum([move @ one.bias for one, move in known], axis=0),
        np.sum([move @ one.covariance @ move.T for one, move in known], axis=0),
        np.sqrt(np.sum([move**2 @ one.uncertainty**2 for one, move in known], axis=0)),
    )


def _alone(
    joint: _Joint, part: _Part, point: Array, settings: FitSettings, effect: NoiseEffect | None
) -> tuple[Determination, ...]:
    """Return what one set-up by itself determines at the joint ``point`` (u,)."""
    own = joint.own(part, point[np.newaxis])[0]
    sizes = least_squares.sizes_of(part.unknowns, own)
    unseen = least_squares.unseen_directions(part.ended.law.force_slopes(inside(own, part.unknowns)), sizes)
    hidden = hidden_by_name(unseen, [unknown.name for unknown in part.unknowns])
    fitted = copy.copy(part.residuals)
    fitted.unknowns = tuple(one for one, seen in zip(part.unknowns, part.seen, strict=True) if seen)
    fitted.values = {
        **fitted.values,
        **{one.name: float(value) for one, value in zip(part.unknowns, own, strict=True)},
    }
    _, covariance = fit_covariance(fitted, own[part.seen], sizes[part.seen], settings)
    if effect is not None and np.isfinite(covariance).all():
        _, covariance = effect.taken_off(own[part.seen], covariance)
    wide = np.full((own.size, own.size), math.inf)
    wide[np.ix_(part.seen, part.seen)] = covariance
    return tuple(by_information(part.unknowns, own, part.residuals.central_slopes(own), hidden, wide))


def _quantity(unknown: least_squares.Unknown, value: float, variance: float, lost: bool) -> Quantity:
    deviation = math.sqrt(variance) if variance >= 0.0 else math.nan
    untold = unknown.low > 0.0 and not deviation < UNTOLD * abs(value)
    if lost or untold or not math.isfinite(deviation):
        return Quantity(unknown.name, unknown.unit)
    return Quantity(unknown.name, unknown.unit, value, deviation, Validity.VALID)


def _combined(one: least_squares.Combination, covariance: Array, free: Sequence[int]) -> Quantity:
    gradient = one.gradient[list(free)]
    return Quantity(
        one.name, one.unit, one.value, math.sqrt(max(0.0, float(gradient @ covariance @ gradient))),
        Validity.VALID,
    )  # fmt: skip


def _fit_of(
    joint: _Joint, part: _Part, point: Array, covariance: Array, unclear: Sequence[str],
    judged: Mapping[str, Determination], converged: bool
) -> Fit:  # fmt: skip
    """Return what the joint ``point`` (u,) says of one set-up."""
    own = joint.own(part, point[np.newaxis])[0]
    slopes = joint.map(part)
    spread = slopes @ np.nan_to_num(covariance) @ slopes.T
    parameters, determinations = [], []
    for place, unknown in enumerate(part.unknowns):
        name = part.names[place]
        parameters.append(_quantity(unknown, float(own[place]), float(spread[place, place]), name in unclear))
        if name in judged:
            one, scale, offset = judged[name], float(part.scales[place]), float(part.offsets[place])
            determinations.append(
                replace(
                    one, name=unknown.name,
                    low=None if one.low is None else scale * one.low + offset,
                    high=None if one.high is None else scale * one.high + offset,
                )
            )  # fmt: skip
    lost = tuple(one.name for one in parameters if not math.isfinite(one.value))
    observable = [n for n, unknown in enumerate(part.unknowns) if unknown.name not in lost]
    deviations = standard_deviations(spread)[observable]
    named = {unknown.name: float(value) for unknown, value in zip(part.unknowns, own, strict=True)}
    values = {name: named.get(name, value) for name, value in part.residuals.values.items()}
    sensor = {name: named[name] for name in (SPOOL_GAIN, SPOOL_DELAY) if name in named}
    criterion, samples = information_criterion(part.residuals, own, len(observable))
    return Fit(
        model=part.residuals.run.model,
        valve=part.setup.valve.id,
        converged=converged,
        parameters=tuple(parameters),
        not_observable=lost,
        held={name: value for name, value in values.items() if name not in named},
        values=values,
        sensor=sensor,
        observation=part.residuals.observation,
        correlation=spread[np.ix_(observable, observable)] / np.outer(deviations, deviations),
        observable=tuple(part.unknowns[n].name for n in observable),
        at_bound=tuple(
            unknown.name
            for unknown, value in zip(part.unknowns, own.tolist(), strict=True)
            if min(value - unknown.low, unknown.high - value) <= 1e-6 * unknown.scale
        ),
        agreement=free_run_agreement(
            part.setup.records, part.residuals.run.model, part.setup.valve, values, sensor=sensor,
            observation=part.residuals.observation, run_in=part.settings.run_in,
            low_cut=part.settings.low_cut,
        ),
        information_criterion=criterion,
        effective_samples=samples,
        determinations=tuple(determinations),
    )  # fmt: skip

"""Motion as evidence: free runs of models, force loops and transmissibility beside what was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import Z_95, number, percent
from spool_estimator.identification.free_run import USUAL, FreeRun, Reading, excitation_limit
from spool_estimator.identification.record import Record, first_seconds
from spool_estimator.identification.spectra import ZeroPhase, delayed, relative_motion
from spool_report.evidence import exhibit
from spool_report.evidence.spectra import CrossSpectra, cross_spectra
from spool_report.terminal import captions
from spool_sim.integration.composed_motion import ComposedMotion
from spool_sim.model import Model
from spool_sim.observation import Observation
from spool_sim.valve import Valve

#: s of data that are simulated at most, of a window, and Hz of the conditioning, as in the pictures of fits.
LONGEST, WINDOW, LOW_CUT = 60.0, 8.0, 3.0

#: Periods of the loop that is drawn, bins of displacement and velocity, and samples in a bin at least.
PERIODS, BINS, LEAST = 3.0, 25, 12

LOOPS_TITLE = "Force loops"
LOOKS = ((exhibit.BEFORE, exhibit.DASHED, "s"), (exhibit.AFTER, "-", "o"))
#: Share of the missing force's size that a step or a slope must make to be said.
WORTH_SAYING = 0.15

TRANSMISSIBILITY_TITLE = "Transmissibility body to spool"
#: Lower edge of a band over the magnitude at least, so that a logarithmic axis is not stretched by it.
LEAST_BAND = 0.1
#: Coherence from which a deviation is held against the model.
TOLD = 0.8


@dataclass(frozen=True, slots=True)
class Numbers:
    """A model with its numbers, as one of the sides of a comparison.

    Attributes:
        name: how the reader knows it, e.g. ``base model``.
        model: the composition.
        values: a full set of its parameters.
        gain: relative gain error of the spool's channel, 1.
        delay: of the spool's channel behind the body's, s.
        observation: of both channels.
    """

    name: str
    model: Model
    values: Mapping[str, float] = field(default_factory=dict)
    gain: float = 0.0
    delay: float = 0.0
    observation: Observation = USUAL

    @property
    def natural_frequency(self) -> float:
        """Of mass and spring, Hz; NaN without both."""
        mass, stiffness = self.values.get("mass", np.nan), self.values.get("spring_stiffness", np.nan)
        return float(np.sqrt(stiffness / mass) / (2.0 * np.pi)) if mass > 0.0 and stiffness > 0.0 else np.nan


@dataclass(frozen=True, slots=True)
class Runs:
    """Rows of samples without gaps, ``period`` s apart.

    Attributes:
        period: s.
        body: acceleration of the body, m/s^2.
        measured: of the spool, m/s^2.
        simulated: by the name of the numbers, m/s^2.
    """

    period: float
    body: tuple[Array, ...]
    measured: tuple[Array, ...]
    simulated: Mapping[str, tuple[Array, ...]]

    def residuals(self, name: str) -> tuple[Array, ...]:
        """Return measured - model of each window, m/s^2."""
        pairs = zip(self.measured, self.simulated[name], strict=True)
        return tuple(measured - simulated for measured, simulated in pairs)


def of_one_rate(records: Sequence[Record]) -> tuple[Record, ...]:
    """Return those of ``records`` that share the sample period of most of the data.

    Raises:
        InputError: there is none.
    """
    if not records:
        raise InputError("the record has no stretch without gaps")
    seconds: dict[float, float] = {}
    for entry in records:
        seconds[entry.sample_period] = seconds.get(entry.sample_period, 0.0) + entry.duration
    period = max(seconds, key=lambda one: seconds[one])
    return tuple(entry for entry in records if entry.sample_period == period)


def runs_of(records: Sequence[Record], valve: Valve, sides: Sequence[Numbers]) -> Runs:
    """Return the free runs of ``sides`` over ``records``, driven by the measured body alone.

    Raises:
        InputError: no record is long enough, or a model broke down.
    """
    rows = of_one_rate(records)
    simulated: dict[str, tuple[Array, ...]] = {}
    body: tuple[Array, ...] = ()
    measured: tuple[Array, ...] = ()
    for side in sides:
        run = FreeRun(rows, side.model, valve, window=WINDOW, low_cut=LOW_CUT, longest=LONGEST)
        run.choose_substeps(side.values)
        found = run.responses(run.sets(side.values), [Reading(side.gain, side.delay, side.observation)])
        # The numbers of windows in groups that follow one another without a gap.
        joined: list[list[int]] = []
        for place, window in enumerate(run.windows):
            before = run.windows[place - 1] if place else None
            if before is not None and before.record == window.record and before.stop == window.start:
                joined[-1].append(place)
            else:
                joined.append([place])
        simulated[side.name] = tuple(
            np.concatenate([found[place].acceleration[0] for place in group]) for group in joined
        )
        if not all(np.isfinite(row).all() for row in simulated[side.name]):
            raise InputError(f"the free run of the {side.name} diverges")
        pieces = [(run.windows[group[0]], run.windows[group[-1]]) for group in joined]
        body, measured = (
            tuple(getattr(rows[first.record], name)[first.start : last.stop] for first, last in pieces)
            for name in ("body", "spool")
        )
    return Runs(rows[0].sample_period, body, measured, simulated)


@dataclass(frozen=True, slots=True)
class Profile:
    """Median of a force over a quantity: ``centres`` of its bins, and ``force`` (N) there, shape (b,)."""

    centres: Array
    force: Array


@dataclass(frozen=True, slots=True)
class Loops:
    """Forces at the measured motion.

    Attributes:
        displacement, velocity: of the excerpt, m and m/s, shape (n,).
        measured: force that springs, oil and friction took there, N, shape (n,).
        models: what each model says of it, N, shape (n,), by name.
        over_displacement, over_velocity: median of the missing force over the whole record, by name.
        missing: rms of the missing force over the whole record, N, by name.
        force: rms of the measured force over the whole record, N.
        start: s, of the excerpt.
    """

    displacement: Array
    velocity: Array
    measured: Array
    models: Mapping[str, Array]
    over_displacement: Mapping[str, Profile]
    over_velocity: Mapping[str, Profile]
    missing: Mapping[str, float]
    force: float
    start: float


def loops_of(records: Sequence[Record], sides: Sequence[Numbers]) -> Loops:
    """Return the forces of ``sides`` beside the measured one, at the motion of both accelerometers.

    Measured: - m a of the spool. All rows passed the same filter, so that like is compared with like. The
    channel is that of the last of ``sides``, whose gain and delay are taken out.

    Raises:
        InputError: the records are too short, or the spool does not move.
    """
    rows = of_one_rate(records)
    last = sides[-1]
    mass = last.values.get("mass", np.nan)
    if not mass > 0.0:
        raise InputError("the model has no mass, so accelerations give no forces")
    motions = {side.name: ComposedMotion(side.model.terms) for side in sides}
    parts: list[tuple[float, Array, Array, Array, dict[str, Array]]] = []
    period = rows[0].sample_period
    for part, some in first_seconds(rows, LONGEST, shortest=6.0 / LOW_CUT):
        both = ZeroPhase(period, LOW_CUT, 1.5 * max(excitation_limit(rows[part]), 30.0))
        spool = (delayed(some.spool, -last.delay, period) if last.delay else some.spool) / (1.0 + last.gain)
        motion = relative_motion(some.body, spool, ZeroPhase(period, LOW_CUT))
        inside = slice(2 * both.settling, some.body.size - 2 * both.settling)
        models = {}
        for side in sides:
            table = np.array([[float(side.values[name]) for name in motions[side.name].names]])
            force = motions[side.name].forces(
                motion.displacement, motion.velocity, table, sample_period=period,
                first_sample=some.first_sample,
            )[0]  # fmt: skip
            models[side.name] = both.apply(force)[inside]
        begin = (some.start - rows[0].start) * 1e-9 + inside.start * period
        measured = (-mass * both.apply(motion.spool))[inside]
        parts.append((begin, motion.displacement[inside], motion.velocity[inside], measured, models))
    if not parts:
        raise InputError("no stretch is long enough for the motion of both accelerometers to settle")
    return loops_from(parts, period)


def loops_from(
    parts: Sequence[tuple[float, Array, Array, Array, Mapping[str, Array]]], period: float
) -> Loops:
    """Return the loops of ``parts``: start (s), displacement, velocity, measured force and the models'.

    Raises:
        InputError: nothing moves.
    """
    z, v, measured = (np.concatenate([part[place] for part in parts]) for place in (1, 2, 3))
    models = {name: np.concatenate([part[4][name] for part in parts]) for name in parts[0][4]}
    if not (float(np.ptp(z)) > 0.0 and float(np.ptp(v)) > 0.0):
        raise InputError("the spool does not move in its body")
    # A few periods around the largest motion. A sine of amplitude Z has velocity 2 pi f Z: what the motion
    # repeats at, about.
    chosen = max(parts, key=lambda part: float(np.abs(part[1]).max()))
    begin, displacement, velocity = chosen[:3]
    centre, size = int(np.argmax(np.abs(displacement))), displacement.size
    near = slice(*_around(centre, round(0.5 / period), size))
    rms = [float(np.sqrt(np.mean(row[near] ** 2))) for row in (displacement, velocity)]
    frequency = max(rms[1] / max(2.0 * np.pi * rms[0], 1e-12), 1.0)
    first, stop = _around(centre, round(PERIODS / frequency / period), size)
    excerpt = slice(first, stop)
    missing = {name: measured - force for name, force in models.items()}
    return Loops(
        chosen[1][excerpt],
        chosen[2][excerpt],
        chosen[3][excerpt],
        {name: row[excerpt] for name, row in chosen[4].items()},
        {name: _profile(z, row) for name, row in missing.items()},
        {name: _profile(v, row) for name, row in missing.items()},
        {name: float(np.sqrt(np.mean(row**2))) for name, row in missing.items()},
        float(np.sqrt(np.mean(measured**2))),
        begin + first * period,
    )


def force_loops(loops: Loops) -> exhibit.Exhibit:
    """Return the picture of ``loops``."""
    figure, axes = exhibit.subplots(6.4, 2, 2, sharex="col", sharey="row")
    looks = dict(zip(loops.models, LOOKS[-len(loops.models) :], strict=True))
    for column, (across, label, profiles) in enumerate(
        (
            (1e3 * loops.displacement, "relative displacement, mm", loops.over_displacement),
            (loops.velocity, "relative velocity, m/s", loops.over_velocity),
        )
    ):
        upper, lower = axes[0, column], axes[1, column]
        upper.plot(across, loops.measured, color=exhibit.MEASURED, lw=3.0, alpha=0.7, label="measured")
        for name, force in loops.models.items():
            colour, dash, marker = looks[name]
            upper.plot(across, force, color=colour, ls=dash, lw=1.1, label=name)
            lower.plot(across, loops.measured - force, color=colour, ls=dash, lw=0.5, alpha=0.6)
            profile = profiles[name]
            factor = 1e3 if column == 0 else 1.0
            lower.plot(factor * profile.centres, profile.force, color=colour, marker=marker, ms=3.5, lw=1.6)
        lower.axhline(0.0, color=exhibit.MEASURED, lw=0.6)
        exhibit.plain(upper, "", "force, N" if column == 0 else "")
        exhibit.plain(lower, label, "missing force, N" if column == 0 else "")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=3)
    parts = []
    for name, missing in loops.missing.items():
        # What the medians of the missing force look like, empty where they are flat.
        over_z = loops.over_displacement[name]
        over_v = loops.over_velocity[name]
        found = []
        if over_v.centres.size >= 6:
            step = step_at_zero(over_v)
            if abs(step) > WORTH_SAYING * missing:
                found.append(f"a step of {number(step, 2)} N at velocity 0")
        if over_z.centres.size >= 6:
            slope = float(np.polyfit(over_z.centres, over_z.force, 1)[0])
            reach = float(np.abs(over_z.centres).max())
            if abs(slope) * reach > WORTH_SAYING * missing:
                found.append(f"a slope of {number(slope, 2)} N/m over displacement")
        shape = f", with {exhibit.listed(found)}" if found else ""
        share = percent(missing / max(loops.force, 1e-30))
        parts.append(f"{name} {share} ({number(missing, 2)} N rms){shape}")
    text = "; ".join(parts)
    return exhibit.Exhibit(
        LOOPS_TITLE,
        figure,
        captions("evidence")["loops"],
        f"Missing force at the same motion, of {number(loops.force, 3)} N rms in total: {text}.",
    )


def step_at_zero(profile: Profile) -> float:
    """Return the step of a force at velocity 0, N: mean of the bins on both sides, the slope taken off."""
    right, left = profile.centres > 0.0, profile.centres < 0.0
    if right.sum() < 2 or left.sum() < 2:
        return 0.0
    columns = np.array([np.ones(profile.centres.size), profile.centres, np.sign(profile.centres)]).T
    return 2.0 * float(np.linalg.lstsq(columns, profile.force, rcond=None)[0][2])


def transmissibility(runs: Runs) -> exhibit.Exhibit:
    """Return magnitude, phase and coherence of ``runs``.

    Raises:
        InputError: the runs are too short.
    """
    measured = cross_spectra(runs.body, runs.measured, runs.period)
    models = {name: cross_spectra(runs.body, rows, runs.period) for name, rows in runs.simulated.items()}
    excited = measured.excited
    known = np.flatnonzero(excited)
    if not known.size:
        raise InputError("the body is hardly shaken at any frequency")
    # From the first line that the body shakes to the last one; lines between that it does not stay empty.
    shown = slice(int(known[0]), int(known[-1]) + 1)
    empty = np.where(excited, 1.0, np.nan)[shown]
    frequency = measured.frequency[shown]
    size, error = np.abs(measured.response), measured.relative_error
    low, high = (size * np.maximum(1.0 + sign * Z_95 * error, LEAST_BAND) for sign in (-1.0, 1.0))
    phase, spread = empty * _degrees(measured, shown), np.degrees(Z_95 * np.minimum(error, np.pi))[shown]
    own = exhibit.Line(
        "measured, with 95 % band", empty * size[shown], exhibit.MEASURED, (), empty * low[shown],
        empty * high[shown], 2.5,
    )  # fmt: skip
    looks = exhibit.MODEL_LOOKS[-len(models) :]

    def of_models(take: Callable[[CrossSpectra], Array]) -> list[exhibit.Line]:
        pairs = zip(models.items(), looks, strict=True)
        return [exhibit.Line(name, empty * take(one), *look, width=1.2) for (name, one), look in pairs]

    panels = (
        exhibit.Panel(
            "frequency, Hz", "magnitude, spool over body, 1", frequency,
            (own, *of_models(lambda one: np.abs(one.response)[shown])), log_x=True, log_y=True,
        ),
        exhibit.Panel(
            "frequency, Hz", "phase, degrees", frequency,
            (
                replace(own, values=phase, low=phase - spread, high=phase + spread),
                *of_models(lambda one: _degrees(one, shown)),
            ),
            log_x=True,
        ),
        exhibit.Panel(
            "frequency, Hz", "coherence, 1", frequency,
            (
                replace(own, values=empty * measured.coherence[shown], low=None, high=None),
                *of_models(lambda one: one.coherence[shown]),
            ),
            log_x=True, span=(0.0, 1.05),
        ),
    )  # fmt: skip
    figure = exhibit.drawn(panels, (3, 2, 1.3), 7.0)
    figure.axes[0].axhline(1.0, color=exhibit.DARK, lw=0.6)
    return exhibit.Exhibit(
        TRANSMISSIBILITY_TITLE,
        figure,
        captions("evidence")["transmissibility"],
        _transmissibility_seen(measured, models, excited),
        panels,
    )


def within(measured: CrossSpectra, model: CrossSpectra, places: Sequence[int] | NDArray[np.intp]) -> float:
    """Return the share of ``places`` at which ``model`` keeps to the measured 95 % band; NaN of none."""
    chosen = np.asarray(places, dtype=np.intp)
    if not chosen.size:
        return float("nan")
    apart = np.abs(np.abs(model.response[chosen]) - np.abs(measured.response[chosen]))
    width = Z_95 * measured.relative_error[chosen] * np.abs(measured.response[chosen])
    return float(np.mean(apart <= width))


def _around(centre: int, length: int, size: int) -> tuple[int, int]:
    length = min(size, max(16, length))
    first = min(max(0, centre - length // 2), size - length)
    return first, first + length


def _profile(over: Array, force: Array) -> Profile:
    reach = float(np.quantile(np.abs(over), 0.998))
    edges = np.linspace(-reach, reach, BINS + 1)
    place = np.digitize(over, edges) - 1
    rows = [
        (0.5 * (edges[number] + edges[number + 1]), float(np.median(force[place == number])))
        for number in range(BINS)
        if np.count_nonzero(place == number) >= LEAST
    ]
    table = np.array(rows).reshape(-1, 2)
    return Profile(table[:, 0], table[:, 1])


def _degrees(spectra: CrossSpectra, shown: slice) -> Array:
    """Return the phase, degrees, from -270 to 90: a spool lags behind its body."""
    angle = np.degrees(np.angle(spectra.response[shown]))
    return np.asarray(np.where(angle > 90.0, angle - 360.0, angle))


def _transmissibility_seen(
    measured: CrossSpectra, models: dict[str, CrossSpectra], shown: NDArray[np.bool_]
) -> str:
    """Return peak, coherence there, and how much of the band each model keeps to."""
    places = np.flatnonzero(shown)
    told = places[measured.coherence[places] > TOLD]
    # Where the coherence is low a peak may be noise over little drive.
    places = told if told.size else places
    peak = places[int(np.argmax(np.abs(measured.response)[places]))]
    parts = [
        f"measured peak {number(float(np.abs(measured.response[peak])), 3)} at "
        f"{number(float(measured.frequency[peak]), 3)} Hz, coherence {measured.coherence[peak]:.2f} there"
    ]
    for name, found in models.items():
        inside = within(measured, found, told)
        own = places[int(np.argmax(np.abs(found.response)[places]))]
        parts.append(
            f"{name}: peak {number(float(np.abs(found.response[own])), 3)} at "
            f"{number(float(found.frequency[own]), 3)} Hz"
            + (
                f", within the band at {100.0 * inside:.0f} % of the lines with a coherence above {TOLD:g}"
                if told.size
                else ""
            )
        )
    if not told.size:
        parts.append(f"the coherence nowhere exceeds {TOLD:g}, so no line is compared with a model")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."

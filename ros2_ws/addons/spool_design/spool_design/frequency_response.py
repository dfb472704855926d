"""Response of a valve on its mount to sines of a machine: curves over frequency and speed, and resonances."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.numbers import Array, Complex
from spool_core.uncertainty import LEFT_OUT, named
from spool_monitor.channels import transfer
from spool_monitor.detectors.resonance import AMPLIFICATION_ON
from spool_sim.excitation import SteadySine
from spool_sim.integration import composed_motion
from spool_sim.integration.composed_motion import ComposedMotion

#: Samples of a period: the reading of a peak between two of them is at most 0.12 % low.
SAMPLES = 64
#: Periods of one look.
LOOK = 4
#: Relative change by which twice the time may move a settled response. What decays to this over the first
#: half decays to its square over both.
TOLERANCE = 1e-3
#: m, below which two strokes are equal: a thousandth of what roughness of a bore measures.
SAME_STROKE = 1e-9
#: Frequencies of the first look, and how often the neighbourhood of a peak is halved: a peak of 1 % of
#: critical damping is read within 0.1 %.
POINTS, HALVINGS = 60, 4
#: Times the natural frequencies that are shown around them.
REACH = 4.0
#: Depth of the valley, relative to the peak, from which a peak is one: ten times what settling leaves.
LEAST_PEAK = 10.0 * TOLERANCE
#: Fall beside a peak, relative to it, from which the peak is the edge of a jump: halved spacings are finer.
CLIFF = 0.1
#: Spool over machine acceleration from which a speed is to be avoided: the monitor's limit for a resonance.
LIMIT = AMPLIFICATION_ON.default


@dataclass(frozen=True, slots=True)
class Drive:
    """Sines of the machine.

    Attributes:
        frequencies: Hz, shape (f,); ``None``: chosen around the natural frequencies.
        fixed: no frequencies may be added to them.
        speeds: lowest and highest, rev/min; ``None`` without a shaft.
        orders: with the amplitude of each, m/s^2; empty without a shaft.
        amplitude: of the curve over frequency, m/s^2: the largest.
        note: what of an excitation is left out, empty for nothing.
    """

    frequencies: Array | None
    fixed: bool
    speeds: tuple[float, float] | None
    orders: tuple[tuple[float, float], ...]
    amplitude: float
    note: str = ""


@dataclass(frozen=True, slots=True)
class Condition:
    """A valve on its mount.

    Attributes:
        values: of the model's parameters.
        sets: draws of them, shape (draws, p); none where the uncertainty is not known.
        mount: natural frequency (Hz) and damping ratio, ``None`` without one.
    """

    values: Mapping[str, float]
    sets: Array
    mount: tuple[float, float] | None = None

    def passed(self, frequency: float) -> complex:
        """Return the acceleration of the valve's body over the machine's at ``frequency`` (Hz).

        The mount is a separate base-excited oscillator; the spool is too light to act back on it.
        """
        if self.mount is None:
            return 1.0 + 0.0j
        natural = 2.0 * math.pi * self.mount[0]
        return complex(transfer(frequency, natural**2, 2.0 * self.mount[1] * natural))


@dataclass(frozen=True, slots=True)
class Curve:
    """Response over frequency at one amplitude; the first row of both tables is that of the best values.

    Attributes:
        frequency: Hz, shape (f,), rising.
        ratios: spool acceleration over the machine's, shape (1 + draws, f); NaN where it is not periodic.
        strokes: largest distance of the spool from the centre, m, same shape.
    """

    frequency: Array
    ratios: Array
    strokes: Array

    def peaks(self) -> list[int]:
        """Return the places of the resonances: above 1 and above the valleys on both sides."""
        row = self.ratios[0]
        found: list[int] = []
        for place in range(1, row.size - 1):
            top = row[place]
            if not (top > 1.0 and top >= row[place - 1] and top > row[place + 1]):
                continue
            sides = (row[:place][::-1], row[place + 1 :])
            if all(_valley(side, top) < (1.0 - LEAST_PEAK) * top for side in sides):
                found.append(place)
        return found

    def tops(self, place: int) -> tuple[Array, Array]:
        """Return frequency (Hz) and ratio of the peak around ``place`` of each row, shape (1 + draws,)."""
        low = place - int(np.argmax(np.diff(self.ratios[0, place::-1], append=np.inf) > 0.0))
        high = place + int(np.argmax(np.diff(self.ratios[0, place:], append=np.inf) > 0.0))
        part = self.ratios[:, low : high + 1]
        across, known = np.log(self.frequency[low : high + 1]), np.isfinite(part).all(axis=1)
        found = np.full((2, len(part)), math.nan)
        for row in np.flatnonzero(known):
            found[:, row] = _top(across, part[row])
        return np.exp(found[0]), found[1]


@dataclass(frozen=True, slots=True)
class Resonance:
    """Resonance, and the speed at which an order meets it.

    Attributes:
        frequency, low, high: Hz, with its 95 % interval.
        ratio: amplitude ratio there.
        order, speed: of the shaft, 1 and rev/min; ``None`` without a shaft.
        margin: distance of that speed from the nearest one of the range, over the latter (as API 617 defines
            the separation margin); 0 within the range.
        margin_low: the least margin within the 95 % interval.
    """

    frequency: float = field(metadata=named("frequency_Hz"))
    low: float = field(metadata=named("low_Hz"))
    high: float = field(metadata=named("high_Hz"))
    ratio: float = field(metadata=named("amplitude_ratio"))
    order: float | None = None
    speed: float | None = field(default=None, metadata=named("speed_rpm"))
    margin: float | None = None
    margin_low: float | None = None


@dataclass(frozen=True, slots=True)
class Span:
    """Span of speeds (rev/min) of an order, or of frequencies (Hz), whose upper bound passes ``LIMIT``."""

    low: float
    high: float
    unit: str
    order: float | None = None


@dataclass(frozen=True, slots=True)
class OrderResponse:
    """Response to one order over the speed, acting alone; bounds are of 95 %."""

    order: float
    amplitude: float = field(metadata=named("amplitude_m_s2"))
    speed: Array = field(metadata=named("speed_rpm"))
    amplitude_ratio: Array
    low: Array
    high: Array
    stroke: Array = field(metadata=named("stroke_m"))


@dataclass(frozen=True, slots=True)
class Response:
    """Response of one condition; bounds are of 95 %, NaN where they are not known.

    ``curves`` are what the machine excites: each order within its speeds, else the curve over frequency.
    """

    curves: tuple[Curve, ...] = field(metadata=LEFT_OUT)
    amplitude: float = field(metadata=named("amplitude_m_s2"))
    frequency: Array = field(metadata=named("frequency_Hz"))
    amplitude_ratio: Array
    low: Array
    high: Array
    stroke: Array = field(metadata=named("stroke_m"))
    stroke_low: Array = field(metadata=named("stroke_low_m"))
    stroke_high: Array = field(metadata=named("stroke_high_m"))
    resonances: tuple[Resonance, ...]
    avoid: tuple[Span, ...]
    orders: tuple[OrderResponse, ...]


@dataclass(frozen=True, slots=True)
class Change:
    """Quantity before and after; ``factor`` is after over before, with its 95 % interval (paired draws)."""

    quantity: str
    unit: str
    before: float
    after: float
    factor: float
    low: float
    high: float


def bounds(rows: Array) -> tuple[Array, Array]:
    """Return the 95 % interval of draws, shape (draws, f), as two arrays of shape (f,).

    A draw without a number may lie on either side; bounds that this leaves open are NaN. Without draws all
    are.
    """
    if not len(rows):
        nothing = np.full(rows.shape[1], math.nan)
        return nothing, nothing
    ends = [
        np.quantile(np.where(np.isnan(rows), other, rows), share, axis=0, method="weibull")
        for share, other in ((0.025, -np.inf), (0.975, np.inf))
    ]
    low, high = (np.where(np.isfinite(end), end, math.nan) for end in ends)
    return low, high


def grid(drive: Drive, conditions: Sequence[Condition]) -> Array:
    """Return the frequencies of the first look: around natural frequencies, and where the orders are."""
    natural = [
        math.sqrt(one.values["spring_stiffness"] / one.values["mass"]) / (2.0 * math.pi) for one in conditions
    ]
    natural += [one.mount[0] for one in conditions if one.mount is not None]
    ends = [min(natural) / REACH, max(natural) * REACH]
    if drive.speeds is not None:
        met = [order * speed / 60.0 for order, _ in drive.orders for speed in drive.speeds]
        ends = [min(*met, *ends), max(*met, *ends)]
    octaves = math.log2(ends[1] / ends[0]) / math.log2(REACH**2)
    return spaced(ends[0], ends[1], max(POINTS, math.ceil(POINTS * octaves)))


def spaced(start: float, stop: float, count: int = POINTS) -> Array:
    """Return frequencies in equal ratios, Hz."""
    return np.asarray(np.geomspace(start, stop, count), dtype=np.float64)


def curve_of(
    motion: ComposedMotion,
    condition: Condition,
    frequencies: Array,
    amplitude: float,
    *,
    best: bool = False,
    displaced: float = 0.0,
    advance: Callable[[float], None] = lambda _done: None,
) -> Curve:
    """Return the response at a machine's ``amplitude`` (m/s^2); with ``best`` without draws.

    It starts with the spool ``displaced`` by so many m.
    """
    first = np.array([[condition.values[name] for name in motion.names]])
    sets = first if best else np.vstack([first, condition.sets])
    ratios, strokes = np.empty((2, len(sets), frequencies.size))
    for place, frequency in enumerate(frequencies.tolist()):
        passed = abs(condition.passed(frequency))
        found = sine_response(motion, condition.values, sets, frequency, amplitude * passed, displaced)
        ratios[:, place], strokes[:, place] = passed * np.abs(found.ratio), found.stroke
        advance(1.0)
    return Curve(frequencies, ratios, strokes)


def refined(motion: ComposedMotion, frequencies: Array, pairs: Sequence[tuple[Condition, float]]) -> Array:
    """Return ``frequencies`` (Hz) with finer ones around every peak, of each condition at its amplitude."""
    for _ in range(HALVINGS):
        looks = [curve_of(motion, one, frequencies, size, best=True) for one, size in pairs]
        places = {side for curve in looks for peak in curve.peaks() for side in (peak - 1, peak)}
        middles = [math.sqrt(frequencies[place] * frequencies[place + 1]) for place in places]
        frequencies = np.sort(np.append(frequencies, middles))
    return frequencies


def _valley(side: Array, top: float) -> float:
    """Return the lowest value of ``side``, walking away from a peak until something exceeds ``top``."""
    higher = np.flatnonzero(side > top)
    return float(np.nanmin(side[: int(higher[0]) if higher.size else side.size], initial=math.inf))


def _top(across: Array, row: Array) -> tuple[float, float]:
    """Return place and height of the largest value of ``row``, between samples by a parabola."""
    place = int(np.argmax(row))
    near = slice(place - 1, place + 2)
    if not 0 < place < row.size - 1 or row[near].min() < (1.0 - CLIFF) * row[place]:
        return float(across[place]), float(row[place])
    a, b, c = np.polyfit(across[near] - across[place], row[near], 2).tolist()
    if not a < 0.0:
        return float(across[place]), float(row[place])
    shift = -b / (2.0 * a)
    return float(across[place] + shift), float(c + 0.5 * b * shift)


def response_of(curves: Mapping[float, Curve], drive: Drive) -> Response:
    """Return the response to ``drive`` from the curves of its amplitudes (m/s^2)."""
    curve = curves[drive.amplitude]
    excited = [_within(curves[size], order, drive) for order, size in drive.orders] or [curve]
    low, high = bounds(curve.ratios[1:])
    stroke_low, stroke_high = bounds(curve.strokes[1:])
    orders = []
    for (order, size), one in zip(drive.orders, excited, strict=False):
        speed = 60.0 * one.frequency / order
        orders.append(
            OrderResponse(order, size, speed, one.ratios[0], *bounds(one.ratios[1:]), one.strokes[0])
        )
    resonances = [
        one
        for order, size in drive.orders or ((None, drive.amplitude),)
        for one in _resonances(curves[size], order, drive.speeds)
    ]
    avoid = [] if orders else _spans(curve.frequency, curve.ratios[0], high, "Hz", None)
    for row in orders:
        avoid += _spans(row.speed, row.amplitude_ratio, row.high, "rev/min", row.order)
    return Response(
        tuple(excited), drive.amplitude, curve.frequency, curve.ratios[0], low, high,
        curve.strokes[0], stroke_low, stroke_high, tuple(resonances), tuple(avoid), tuple(orders),
    )  # fmt: skip


def _within(curve: Curve, order: float, drive: Drive) -> Curve:
    """Return the part of ``curve`` that an order passes over the speeds."""
    assert drive.speeds is not None
    low, high = (order * speed / 60.0 for speed in drive.speeds)
    inside = curve.frequency[(curve.frequency > low) & (curve.frequency < high)]
    frequency = np.array([low, *inside, high])
    across, known = np.log(frequency), np.log(curve.frequency)
    ratios, strokes = (
        np.array([np.interp(across, known, row) for row in rows]) for rows in (curve.ratios, curve.strokes)
    )
    return Curve(frequency, ratios, strokes)


def _resonances(curve: Curve, order: float | None, speeds: tuple[float, float] | None) -> list[Resonance]:
    found = []
    for place in curve.peaks():
        frequency, ratio = curve.tops(place)
        low, high = (float(end[0]) for end in bounds(frequency[1:, np.newaxis]))
        one = Resonance(float(frequency[0]), low, high, float(ratio[0]))
        if order is not None and speeds is not None:
            met = 60.0 / order * np.array([one.frequency, low, high])
            nearest = np.clip(met, *speeds)
            margins = (np.abs(met - nearest) / nearest).tolist()
            # Inside the interval the speed may lie within the range though both ends lie beyond it.
            across = 60.0 * low / order < speeds[0] and 60.0 * high / order > speeds[1]
            least = math.nan if math.isnan(low) else 0.0 if across else min(margins[1:])
            one = replace(
                one, order=order, speed=60.0 * one.frequency / order, margin=margins[0], margin_low=least
            )
        found.append(one)
    return found


def _spans(across: Array, best: Array, high: Array, unit: str, order: float | None) -> list[Span]:
    """Return where the upper bound, or the best value where there is none, passes ``LIMIT``."""
    rows = np.where(np.isnan(high), best, high)
    inside = rows >= LIMIT
    edges = np.flatnonzero(np.diff(np.concatenate(([False], inside, [False]))))
    found = []
    for first, stop in edges.reshape(-1, 2).tolist():
        ends = []
        for inner, outer in ((first, first - 1), (stop - 1, stop)):
            if 0 <= outer < rows.size and math.isfinite(rows[outer]):
                share = (rows[inner] - LIMIT) / (rows[inner] - rows[outer])
                ends.append(float(across[inner] + share * (across[outer] - across[inner])))
            else:
                ends.append(float(across[inner]))
        found.append(Span(ends[0], ends[1], unit, order))
    return found


def changes_of(before: Response, after: Response) -> tuple[Change, ...]:
    """Return the largest ratio, its frequency and the largest stroke, before and after."""
    rows = []
    for name, unit, pick in (
        ("largest amplitude ratio", "", lambda many: _largest([one.ratios for one in many])),
        ("its frequency", "Hz", _where_largest),
        ("largest stroke", "mm", lambda many: 1e3 * _largest([one.strokes for one in many])),
    ):
        pair = pick(before.curves), pick(after.curves)
        factors = pair[1] / pair[0]
        low, high = (float(end[0]) for end in bounds(factors[1:, np.newaxis]))
        rows.append(Change(name, unit, float(pair[0][0]), float(pair[1][0]), float(factors[0]), low, high))
    return tuple(rows)


def _largest(tables: Sequence[Array]) -> Array:
    """Return the largest value of each row over all ``tables``."""
    return np.asarray(np.max([table.max(axis=1) for table in tables], axis=0), dtype=np.float64)


def _where_largest(curves: Sequence[Curve]) -> Array:
    """Return the frequency (Hz) of the largest ratio of each row."""
    one = max(curves, key=lambda curve: float(curve.ratios[0].max()))
    return one.tops(int(np.argmax(one.ratios[0])))[0]


@dataclass(frozen=True, slots=True)
class SineResponse:
    """Response of s parameter sets to a sine of the body.

    Attributes:
        ratio: first harmonic of the spool's acceleration over the body's, shape (s,).
        stroke: largest distance of the spool from the centre, m, shape (s,).
        settled: False where the motion is not periodic within ``LATEST_TIME``; ratio and stroke are NaN then.
    """

    ratio: Complex
    stroke: Array
    settled: NDArray[np.bool_]


def sine_response(
    motion: ComposedMotion,
    values: Mapping[str, float],
    sets: Array,
    frequency: float,
    amplitude: float,
    displaced: float = 0.0,
) -> SineResponse:
    """Return the response to a sine of the body that rises from zero, until the motion repeats itself.

    Subharmonics of a half and a quarter of the frequency count as periodic. Where several motions are
    possible, as with a hardening spring, it is the one that the valve reaches from its start.

    Args:
        motion: the composition.
        values: parameters by name, for which the step is chosen.
        sets: parameters as columns of ``motion.names``, shape (s, p).
        frequency: of the body, Hz.
        amplitude: of the body's acceleration, peak, m/s^2.
        displaced: displacement of the spool at the start, m; where it is not 0 the sine begins at once.

    Raises:
        InputError: the parameters are too stiff for any step.
    """
    rising = SteadySine(frequency=frequency, amplitude=amplitude)
    excitation = rising.model_copy(update={"soft_start": 0.0})
    rate = SAMPLES * frequency
    substeps, _ = composed_motion.checked_substeps(
        motion, values, excitation.acceleration,
        seconds=2 * LOOK / frequency, sample_rate=rate, highest_frequency=frequency,
    )  # fmt: skip
    # Every period is the first one: the forcing repeats, and no law depends on time.
    one = excitation.acceleration(composed_motion.half_step_times(0, SAMPLES, rate, substeps))[:-1]
    look = np.append(np.tile(one, LOOK), one[0])[np.newaxis]
    wave = np.exp(-2j * np.pi * np.arange(SAMPLES * LOOK) / SAMPLES) * 2.0 / (SAMPLES * LOOK)
    count = len(sets)
    ratio = np.full(count, complex(math.nan, math.nan))
    stroke, settled = np.full(count, math.nan), np.zeros(count, dtype=np.bool_)
    states = [composed_motion.MotionState(displaced)] * count
    if displaced == 0.0:
        samples = SAMPLES * LOOK * math.ceil(rising.soft_start * frequency / LOOK)
        forcing = rising.acceleration(composed_motion.half_step_times(0, samples, rate, substeps))[np.newaxis]
        _, states = motion.advance_batch(
            states, forcing, sets[:, np.newaxis, :], sample_period=1.0 / rate, substeps=substeps
        )
    left = np.arange(count)
    before = np.full(count, np.inf, dtype=np.complex128), np.full(count, np.inf)
    pieces, done = 1, 0
    while left.size and done * LOOK < composed_motion.LATEST_TIME * frequency:
        for _ in range(pieces):
            trajectory, states = motion.advance_batch(
                states, look, sets[left][:, np.newaxis, :], sample_period=1.0 / rate, substeps=substeps
            )
        done += pieces
        pieces = done  # the next look is at twice the time
        # z is smooth where the acceleration jumps; z'' = -w^2 z for the first harmonic of a periodic motion.
        relative = -((2.0 * np.pi * frequency) ** 2) * (trajectory.displacement @ wave)
        body = -1j * amplitude
        now = 1.0 + relative / body, np.abs(trajectory.displacement).max(axis=1)
        same = np.abs(now[0] - before[0]) <= TOLERANCE * np.abs(now[0])
        same &= np.abs(now[1] - before[1]) <= TOLERANCE * now[1] + SAME_STROKE
        ratio[left[same]], stroke[left[same]], settled[left[same]] = now[0][same], now[1][same], True
        before = now[0][~same], now[1][~same]
        states = [state for state, kept in zip(states, ~same, strict=True) if kept]
        left = left[~same]
    return SineResponse(ratio, stroke, settled)

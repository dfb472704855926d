"""First look at records: what can be analysed, which samples count, and what each channel shows by itself."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.optimize import minimize
from spool_core.numbers import Array
from spool_core.record_limits import LIMITS
from spool_estimator import record_judgement
from spool_estimator.identification.nuisances import Nuisance, frequencies_of_hum
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import cross_spectrum, noise_of
from spool_sim.valve import Valve

from spool_gap.catalogue import RECORD_NUISANCES
from spool_gap.likelihood.prediction import Prediction
from spool_gap.likelihood.readings import Readings, readings_of
from spool_gap.report import CHECK_CLIPPING
from spool_gap.result import GapResult

Mask = NDArray[np.bool_]

#: s of records that are analysed at most, spread over the time: their noise allows for no more.
LONGEST = 60.0
#: s of a stuck spool's record that are looked at: its picture needs no more.
STUCK_LONGEST = 8.0
#: s of a part of a longer record.
PART = 12.0


#: Lower end of the band over the excitation's upper end and over the sample rate; upper end over that rate.
ABOVE, LOWER, UPPER = 2.0, 0.1, 0.45
#: Share of that band in all frequencies below which nothing shows.
NARROWEST = 0.15
#: Twice the log likelihood ratio, and share of the noise that grows with the slope, from which there is
#: jitter: chosen on blind cases other than the published ones.
EVIDENCE, SHARE = 60.0, 0.2
CHECK = "sampling clock: use a separate timer instead of a program's loop"
#: Share of the body's rms that noise is given in a record whose channels read the same numbers: so little
#: moves no number of the fit.
DITHER = 1e-4
#: Confidence of the verdict on a stuck spool: as others which one clear fact decides.
CONFIDENCE = 0.99


@dataclass(frozen=True, slots=True)
class Look:
    """What a first look shows.

    Attributes:
        readings: of each stretch, those to hold out last.
        held: how many of them are held out as a whole.
        limits: m/s^2, of each channel that clips, by its name.
        nuisances: that the channels show without any model.
        warnings: one line each.
        trusted: both channels are of one valve.
        stuck: the spool moves with its body.
    """

    readings: tuple[Readings, ...]
    held: int
    limits: Mapping[str, float]
    nuisances: tuple[Nuisance, ...]
    warnings: tuple[str, ...]
    trusted: bool
    stuck: bool


def look_at(records: Sequence[Record], holdout: Sequence[Record], valve: Valve) -> Look:
    """Return what a first look at ``records`` of ``valve`` shows.

    Raises:
        InputError: the records cannot be analysed; what is wrong is named.
    """
    usable, warnings = record_judgement.usable(records)
    held = list(record_judgement.usable(holdout)[0]) if holdout else []
    stuck = all(is_stuck(record, valve) for record in usable)
    longest = STUCK_LONGEST if stuck else LONGEST
    usable, held = _parts(usable, longest), _parts(held, longest)
    if stuck:
        usable, held = list(dithered(usable)), list(dithered(held))
    everything = [*usable, *held]
    whole, spiked, hums, found = _by_themselves(everything, valve)
    readings = tuple(
        readings_of(record, missing=missing, hum=hum)
        for record, missing, hum in zip(everything, spiked, hums, strict=True)
    )
    limits = {
        name: limit
        for name in ("spool", "body")
        if (limit := next(filter(None, (getattr(one, f"{name}_limit") for one in readings)), 0.0)) > 0.0
    }
    warnings += record_judgement.clipping(everything)
    trusted = True
    for record in whole[:3]:
        told, good = record_judgement.judge(record, valve)
        # Flat tops spoil the coherence of channels that belong together; they have a warning themselves.
        told = told if good or not limits else []
        warnings += [line for line in told if line not in warnings]
        trusted = trusted and (good or bool(limits))
    clipping = [
        Nuisance("clipping", name, limit, 0.01 * limit, "m/s^2", corrected=False, check=CHECK_CLIPPING)
        for name, limit in sorted(limits.items())
    ]
    kept = [one for one in found if one.channel not in limits or one.id == "spikes"]
    nuisances = () if stuck else (*kept, *clipping)
    return Look(readings, len(held), limits, nuisances, tuple(warnings), trusted, stuck)


def dithered(records: Sequence[Record]) -> tuple[Record, ...]:
    """Return ``records`` with a little noise on the spool's channel, without which nothing can be fitted."""
    generator = np.random.default_rng(0)
    return tuple(
        replace(one, spool=one.spool + DITHER * one.body.std() * generator.standard_normal(one.spool.size))
        for one in records
    )


def as_stuck(result: GapResult) -> GapResult:
    """Return ``result`` with the verdict on a stuck spool."""
    return replace(
        result,
        verdict="unexplained",
        confidence=CONFIDENCE,
        effects=(),
        alternatives=(),
        candidates=(),
        nuisances=(),
        remainder=None,
        sentence=(
            "The spool is stuck: it moves with its body, so this record contains no information on its "
            "spring and friction. Check for silting, dirt, a bent spool, a deformed bore or a solenoid that "
            "holds the spool. Also check whether both sensors sit on the body."
        ),
        advice="a stronger excitation near the natural frequency, or moving the spool by its solenoid",
    )


def jitter_of(parts: Sequence[Prediction], rows: Sequence[Array]) -> Nuisance | None:
    """Return the scatter of the sampling instants of the spool's channel, ``None`` where there is none.

    A reading taken too early or too late is off by slope times time. That is noise to any model; what shows
    it is that it comes and goes with the slope, above the band of the excitation.

    Args:
        parts: the records.
        rows: measured and predicted acceleration of each, m/s^2, shape (2 or more, n).
    """
    squares, slopes, shares = [], [], []
    for part, row in zip(parts, rows, strict=True):
        rate, error = 1.0 / part.period, row[0] - row[1]
        lines = fft.rfftfreq(error.size, part.period)
        band = (lines > max(ABOVE * part.readings.noise.high, LOWER * rate)) & (lines < UPPER * rate)
        if band.mean() < NARROWEST:
            continue
        left = fft.irfft(fft.rfft(error) * band, error.size)
        inside = part.counted > 0.5
        inside[: inside.size // 20] = inside[-(inside.size // 20) :] = False
        squares.append(left[inside] ** 2 / band.mean())
        slopes.append((np.gradient(row[1]) * rate)[inside] ** 2)
        shares.append(float(band.mean()))
    if not squares:
        return None
    square, slope = np.concatenate(squares), np.concatenate(slopes)
    whole, steepest = float(square.mean()), float(slope.mean())
    if whole <= 0.0 or steepest <= 0.0:
        return None
    square, slope = square / whole, slope / steepest

    def unlikely(powers: Array) -> float:
        power = np.exp(powers[0]) + np.exp(powers[1]) * slope
        return float(np.sum(np.log(power) + square / power))

    found = minimize(unlikely, np.log([0.5, 0.5]), method="Nelder-Mead")
    constant, growing = np.exp(found.x).tolist()
    # Samples of a band that is a part of all frequencies count as that part of them.
    evidence = float(np.mean(shares)) * (square.size - float(found.fun))
    if evidence < EVIDENCE or growing < SHARE * (constant + growing):
        return None
    averaged = math.sqrt(parts[0].period / parts[0].readings.period)
    size = averaged * math.sqrt(growing * whole / steepest)
    return Nuisance("jitter", "spool", size, math.nan, "s", corrected=False, check=CHECK)


def sentence(found: Nuisance) -> str:
    """Return what the jitter ``found`` is on the machine."""
    return (
        "the noise of the spool's channel grows with the slope of the reading, as with a sampling jitter of "
        f"{1e3 * found.size:.2g} ms (rms): check the sampling clock"
    )


def _by_themselves(
    records: Sequence[Record], valve: Valve
) -> tuple[list[Record], list[tuple[Mask, Mask]], list[tuple[float, ...]], list[Nuisance]]:
    """Return the records without spikes, hum and drift, where spikes were, lines of hum, what was found."""
    whole = list(records)
    hums: list[tuple[float, ...]] = [()] * len(whole)
    missing: list[tuple[Mask, Mask]] = [
        (np.zeros(one.body.size, np.bool_), np.zeros(one.body.size, np.bool_)) for one in records
    ]
    found: list[Nuisance] = []
    for nuisance in RECORD_NUISANCES:
        cleaned = nuisance.clean(whole, valve)
        if nuisance.id == "spikes":
            missing = [
                (after.body != before.body, after.spool != before.spool)
                for before, after in zip(whole, cleaned.records, strict=True)
            ]
        if nuisance.id == "hum" and cleaned.found:
            hums = [frequencies_of_hum(record, valve) for record in whole]
        whole = list(cleaned.records)
        found += cleaned.found
    return whole, missing, hums, found


def _parts(records: Sequence[Record], longest: float) -> list[Record]:
    """Return parts of ``records`` that together hold at most ``longest`` s, spread over the time.

    Parts with more motion are preferred within each piece of the time.
    """
    total = sum(record.duration for record in records)
    if total <= longest:
        return list(records)
    found: list[Record] = []
    for record in records:
        count = max(1, int(longest * record.duration / total / PART))
        length = round(min(PART, longest) / record.sample_period)
        if record.body.size <= 2 * length:
            found.append(record.part(0, min(record.body.size, round(longest / record.sample_period))))
            continue
        edges = np.linspace(0, record.body.size, count + 1).astype(int).tolist()
        for begin, end in pairwise(edges):
            starts = range(begin, max(begin + 1, end - length), max(1, length // 2))
            first = max(starts, key=lambda start: float(record.body[start : start + length].std()))
            found.append(record.part(first, min(first + length, record.body.size)))
    return found


def is_stuck(record: Record, valve: Valve) -> bool:
    """Whether the spool of ``valve`` moves with its body throughout ``record``."""
    rate = record.sample_rate
    noise = noise_of(record.body, record.spool, rate)
    piece = int(min(record.body.size, max(256, 2 ** round(np.log2(rate)))))
    both = cross_spectrum(record.body, record.spool - record.body, rate, piece)
    frequency, body, moved = both.frequency, both.body, both.spool
    driven = (frequency >= noise.low) & (frequency <= noise.high) & (frequency > 0.0)
    if not driven.any():
        return False
    expected = np.abs(record_judgement.expected_transfer(frequency[driven], valve) - 1.0) ** 2 * body[driven]
    shown = np.maximum(moved[driven] - noise.body - noise.spool, 0.0)
    return float(shown.sum()) < LIMITS.stuck**2 * float(expected.sum())

"""Whether a record can be analysed at all: what is wrong with it, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import ChannelNoise, noise_of
from spool_sim.valve import Valve

from spool_gap.thresholds import THRESHOLDS

from .units import ANY_SPRING, difference, expected_transfer, like_no_valve, opposite, wrong_unit

Array = NDArray[np.float64]

#: s without any change from which a channel is dead: noise alone changes a reading within a few samples.
STILL = 0.5


def usable(records: Sequence[Record]) -> tuple[list[Record], list[str]]:
    """Return the stretches that are long enough, and warnings about the others.

    Raises:
        InputError: there is none, or a channel is dead.
    """
    warnings = []
    kept = [record for record in records if record.duration >= THRESHOLDS.shortest_stretch]
    if sum(record.duration for record in kept) < THRESHOLDS.shortest:
        longest = max((record.duration for record in records), default=0.0)
        raise InputError(
            f"{records[0].name if records else 'record'}: too short: its longest stretch without gaps has "
            f"{longest:.1f} s, an analysis needs {THRESHOLDS.shortest:g} s or more in all: record longer"
        )
    gaps = sum(not record.cut for record in records) - 1
    if gaps > 0:
        lost = sum(record.duration for record in records) - sum(record.duration for record in kept)
        warnings.append(f"the record has {gaps} gaps; {len(kept)} stretches are used, {lost:.1f} s left out")
    for record in kept:
        for name, row in (("body", record.body), ("spool", record.spool)):
            if not float(np.ptp(row)) > 0.0:
                raise InputError(
                    f"{record.name}: {name} reads {row[0]:g} m/s^2 throughout: check sensor and cable"
                )
            still = longest_still(row) * record.sample_period
            if still > STILL:
                warnings.append(f"{name} does not change for {still:.1f} s: check sensor and cable")
    return [part for record in kept for part in _changing(record)] or kept, warnings


def _changing(record: Record) -> list[Record]:
    """Return the parts of ``record`` that are long enough and in which both channels change."""
    found = [record]
    for name in ("body", "spool"):
        found = [part for one in found for part in _without_still(one, getattr(one, name))]
    return [part for part in found if part.duration >= THRESHOLDS.shortest_stretch]


def _without_still(record: Record, row: Array) -> list[Record]:
    edges = np.flatnonzero(np.concatenate([[True], np.diff(row) != 0.0, [True]]))
    still = np.flatnonzero(np.diff(edges) * record.sample_period > STILL)
    if not still.size:
        return [record]
    firsts = [0, *edges[still + 1].tolist()]
    stops = [*edges[still].tolist(), row.size]
    return [record.part(first, stop) for first, stop in zip(firsts, stops, strict=True) if stop - first > 1]


def longest_still(row: Array) -> int:
    """Return the largest number of equal samples in a row."""
    edges = np.flatnonzero(np.concatenate([[True], np.diff(row) != 0.0, [True]]))
    return int(np.diff(edges).max())


def judge(record: Record, valve: Valve) -> tuple[list[str], bool]:
    """Return what is doubtful about ``record``, one line each, and whether a verdict may still be trusted.

    Raises:
        InputError: the record cannot be analysed: no excitation, a channel dead, sampled too slowly,
            channels exchanged, or a unit that is off by 9.81.
    """
    noise = noise_of(record.body, record.spool, record.sample_rate)
    natural = valve.natural_frequency
    body, spool = float(record.body.std()), float(record.spool.std())
    needed = THRESHOLDS.samples_per_period * natural
    # First of all: what is sampled too slowly folds back and looks like noise.
    if record.sample_rate < needed:
        raise InputError(
            f"{record.name}: {record.sample_rate:g} Hz is too slow for a natural frequency of "
            f"{natural:.1f} Hz: sample at {needed:.0f} Hz or more"
        )
    if body < THRESHOLDS.excited * noise.body_rms or noise.high <= noise.low:
        if spool > THRESHOLDS.excited * max(noise.spool_rms, noise.body_rms):
            raise InputError(
                f"{record.name}: body shows only noise ({body:.3g} m/s^2) while spool moves: "
                "is its sensor dead, or not mounted?"
            )
        raise InputError(
            f"{record.name}: no excitation: body has {body:.3g} m/s^2 rms, its noise {noise.body_rms:.3g}: "
            "record while the valve vibrates"
        )
    if spool < THRESHOLDS.excited * noise.spool_rms and spool < 0.05 * body:
        raise InputError(
            f"{record.name}: spool shows only noise ({spool:.3g} m/s^2) while body moves with {body:.3g}: "
            "is its sensor dead, or not mounted?"
        )
    if record.sample_rate < THRESHOLDS.samples_per_excited_period * noise.high:
        raise InputError(
            f"{record.name}: {record.sample_rate:g} Hz is too slow for a natural frequency of "
            f"{natural:.1f} Hz driven up to {min(noise.high, 0.5 * record.sample_rate):.0f} Hz: "
            f"sample at {max(needed, 10.0 * min(noise.high, 200.0)):.0f} Hz or more"
        )
    warnings: list[str] = []
    ratio, coherence, frequency = transfer(record, noise)
    low = frequency < 0.45 * natural
    if coherence.size and float(np.median(coherence)) < THRESHOLDS.incoherent:
        warnings.append(
            f"body and spool hardly belong together (coherence {float(np.median(coherence)):.2f}): "
            "same valve, same clock, sensors tight?"
        )
        return warnings, False
    trusted = True
    text = unit_or_exchange(ratio, frequency, valve)
    if text:
        raise InputError(f"{record.name}: {text}")
    if frequency.size >= 4 and like_no_valve(ratio, frequency, valve):
        warnings.append(
            "spool over body is the transfer of no valve with this mass, whatever its spring: units of both "
            "channels, order of the columns, valve file?"
        )
        trusted = False
    if not low.any() and frequency.size and float(frequency.min()) > 1.3 * natural:
        warnings.append(
            f"the excitation begins at {noise.low:.0f} Hz, above the natural frequency of {natural:.1f} Hz: "
            "gain, stiffness and slow friction are hardly determined there"
        )
    return warnings, trusted


def transfer(record: Record, noise: ChannelNoise) -> tuple[Array, Array, Array]:
    """Return the spool's acceleration over the body's (complex), coherence, and frequency where driven."""
    from scipy import signal  # noqa: PLC0415

    piece = int(min(record.body.size // 4, round(2.0 * record.sample_rate)))
    options = {"fs": record.sample_rate, "window": "hann", "nperseg": piece}
    frequency, body = signal.welch(record.body, **options)
    _, spool = signal.welch(record.spool, **options)
    _, cross = signal.csd(record.body, record.spool, **options)
    driven = (body > 30.0 * noise.body) & (frequency >= noise.low) & (frequency <= noise.high)
    ratio = cross[driven] / body[driven]
    coherence = np.abs(cross[driven]) ** 2 / (body[driven] * spool[driven])
    return ratio, coherence, frequency[driven]


def unit_or_exchange(ratio: Array, frequency: Array, valve: Valve) -> str:
    """Return what is wrong with units or channels, or an empty string.

    Judged by the transfer that the valve's description gives: spool over body, with its sign.
    """
    if frequency.size < 4:
        return ""
    expected = expected_transfer(frequency, valve)

    def distance(candidate: Array) -> float:
        return float(np.median(np.abs(np.log(np.maximum(np.abs(ratio), 1e-9) / np.abs(candidate)))))

    direct = distance(expected)
    factor = wrong_unit(ratio, frequency, valve)
    if factor > 1.0:
        return "spool reads 9.81 times too much: is body in g instead of m/s^2?"
    if factor < 1.0:
        return "spool reads 9.81 times too little: is spool in g instead of m/s^2?"
    if opposite(ratio, frequency, valve):
        return "body and spool have opposite signs: one sensor is turned round: change the sign of its column"
    inverse = 1.0 / expected
    unlike = difference(np.abs(ratio), frequency, valve, 1.0, ANY_SPRING) > THRESHOLDS.unlike_described
    if unlike and direct > 0.45 and distance(inverse) < 0.4 * direct:
        return "body and spool look exchanged: the one that should follow leads: swap the columns"
    return ""

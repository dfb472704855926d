"""Readings of one record as a likelihood takes them: both channels, what is missing, noise and excitation.

Samples that spike or are missing are missing in both roles: the spool's do not count, and after a missing
sample of the body nothing counts until the motion has forgotten it. A sample of the spool at the limit of its
sensor shows that the acceleration is at least that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.numbers import Array
from spool_estimator.identification.channel_faults import at_rail, restored
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import ChannelNoise, ZeroPhase, noise_of, quiet, resting_noise

Mask = NDArray[np.bool_]

#: Hz: a record at twice this rate or more is averaged.
RATE = 2500.0
#: Hz, below which no excitation of a valve is looked for.
LOWEST = 1.0
#: Deviations of the body's noise up to which a restored sample of its channel counts as read.
KNOWN = 3.0
#: s after a missing sample of the body, and after a longer gap (of ``LONG`` s), that do not count.
AFTER, AFTER_LONG, LONG = 0.008, 0.15, 0.005
#: Share of the samples at a rail that are of one side alone; s within which a rail hardly moves; share of the
#: range that noise there takes; samples at a rail over those below it (the top of a wave shows 2.4).
ONE_SIDE, WITHIN, NEAR, PILED_UP = 0.05, 0.25, 0.02, 3.0
#: Pieces with a rail that moves, at least; share of samples beyond it, at most.
FEWEST, CROSSED = 3, 1e-4


@dataclass(frozen=True, slots=True)
class Readings:
    """Readings; every array has shape (n,).

    Attributes:
        period: s between samples.
        time: of the first sample since the record's origin, s.
        body: excitation, m/s^2: restored where it clips, freed of noise, nothing below ``low_cut``.
        spool: m/s^2, nothing below ``low_cut``.
        heard: samples of the spool that are there.
        rail: limit of the spool's sensor where it clips, on the scale of ``spool``, m/s^2; NaN elsewhere.
        counted: samples whose prediction errors count.
        noise: of both channels, with the excitation's band.
        resting: frequencies and density of the body's noise there, Hz and (m/s^2)^2/Hz, shape (2, bands).
        low_cut: Hz, above which the channels are used.
        body_limit, spool_limit: m/s^2, where the channel clips, else 0.
        body_clipped, spool_clipped: share of the samples at the limit.
        hum: lines of the mains in either channel, Hz.
        record: as measured.
        means: each sample is the mean of several.
    """

    period: float
    time: float
    body: Array
    spool: Array
    heard: Mask
    rail: Array
    counted: Mask
    noise: ChannelNoise
    resting: Array
    low_cut: float
    body_limit: float
    spool_limit: float
    body_clipped: float
    spool_clipped: float
    hum: tuple[float, ...]
    record: Record
    means: bool = False

    def part(self, begin: int, end: int) -> Readings:
        """Return the samples from ``begin`` to before ``end``."""
        return replace(
            self,
            time=self.time + begin * self.period,
            **{
                name: getattr(self, name)[begin:end] for name in ("body", "spool", "heard", "rail", "counted")
            },
            record=self.record.part(begin, end),
        )


def readings_of(
    record: Record,
    *,
    missing: tuple[Mask, Mask] | None = None,
    hum: tuple[float, ...] = (),
    noise: ChannelNoise | None = None,
) -> Readings:
    """Return the readings of ``record``.

    Args:
        record: as measured.
        missing: samples of body and spool that are known to be wrong, as spikes, shape (n,) each.
        hum: lines of the mains, Hz, that are not compared.
        noise: of both channels, where the record does not show it.
    """
    rows, masks, limits, shares, deviations = [], [], [], [], []
    for number, row in enumerate((record.body, record.spool)):
        gone = np.zeros(row.size, dtype=np.bool_) if missing is None else missing[number].copy()
        rail = at_rail(row)
        limits.append(0.0 if rail is None else float(np.median(np.abs(row[rail]))))
        shares.append(0.0 if rail is None else float(rail.mean()))
        flat: Mask = np.zeros(row.size, dtype=np.bool_)
        if rail is not None:
            # What is known to be wrong, as a spike that ends at the rail, is no top.
            flat = ~gone & (rail | _at_moving_rail(row, rail, round(WITHIN * record.sample_rate)))
            gone |= np.convolve(flat.astype(np.float64), np.ones(3), mode="same") > 0.0
        filled, deviation = _filled(row, gone, flat, record.sample_rate)
        rows.append(filled)
        deviations.append(deviation)
        masks.append(gone)
    noise = noise or noise_of(rows[0], rows[1], record.sample_rate)
    # What is restored as well as noise lets it be read is not missing.
    unknown = masks[0] & (deviations[0] > KNOWN * noise.body_rms)
    low_cut = max(LOWEST, 0.4 * noise.low)
    conditioning = ZeroPhase(record.sample_period, low_cut)
    body, spool = conditioning.apply(rows[0]), conditioning.apply(rows[1])
    resting = resting_noise(body, spool, noise.body, record.sample_rate)
    return Readings(
        record.sample_period,
        record.first_sample * record.sample_period,
        quiet(body, lambda hertz: np.interp(hertz, *resting), record.sample_rate).apply(body),
        spool,
        ~masks[1],
        np.where(flat, spool + record.spool - rows[1], np.nan),
        ~masks[1] & ~_disturbed(unknown, record.sample_period),
        noise,
        resting,
        low_cut,
        limits[0],
        limits[1],
        shares[0],
        shares[1],
        hum,
        record,
    )


def averaged(readings: Readings) -> Readings:
    """Return ``readings`` averaged to no more than ``RATE`` where they are sampled faster than twice that."""
    every = math.floor(1.0 / (readings.period * RATE))
    if every < 2:
        return readings
    size = readings.body.size // every * every

    def means(row: Array) -> Array:
        return np.asarray(row[:size].reshape(-1, every).mean(axis=1), dtype=np.float64)

    def whole(mask: Mask) -> Mask:
        return np.asarray(mask[:size].reshape(-1, every).all(axis=1))

    record = readings.record
    period = record.sample_period * every
    # The mean of clipped readings is no more than that of the true ones.
    at_least = np.where(np.isnan(readings.rail), readings.spool, readings.rail)
    return replace(
        readings,
        period=period,
        body=means(readings.body),
        spool=means(readings.spool),
        heard=whole(readings.heard),
        rail=np.where(whole(np.isnan(readings.rail)), np.nan, means(at_least)),
        counted=whole(readings.counted),
        means=True,
        record=replace(
            record,
            sample_period=period,
            body=means(record.body),
            spool=means(record.spool),
            oil_temperature=None,
        ),
    )


def bridged(readings: Readings, guess: Array) -> Readings:
    """Return ``readings`` with the samples that the spool lacks bridged by ``guess``, shape (n,), m/s^2.

    A bridge ends at the measured samples. What is filled in counts nowhere by itself, but the filters that
    take slow drift away spread it.
    """
    row, there, places = readings.record.spool, readings.heard, np.arange(readings.heard.size)
    offset = np.interp(places, places[there], (row - guess)[there])
    filled = np.where(there, row, guess + offset)
    spool = ZeroPhase(readings.period, readings.low_cut).apply(filled)
    rail = np.where(np.isnan(readings.rail), np.nan, spool + row - filled)
    return replace(readings, spool=spool, rail=rail)


def _filled(row: Array, gone: Mask, flat: Mask, rate: float) -> tuple[Array, Array]:
    """Return ``row`` with the samples ``gone`` filled in, and their deviations, m/s^2, shape (n,).

    Tops that are ``flat`` are restored; else a line through the neighbours is as good as nothing.
    """
    if gone.all() or not gone.any():
        return row, np.where(gone, np.inf, 0.0)
    if flat.any():
        return restored(row, gone, flat, rate)
    place = np.arange(row.size)
    return np.interp(place, place[~gone], row[~gone]), np.where(gone, np.inf, 0.0)


def _at_moving_rail(row: Array, rail: Mask, length: int) -> Mask:
    """Return which samples sit at the other rail, where ``rail`` is of one side alone.

    A sensor that clips on both sides and whose bias then moves shows one side at the logger's limit and the
    other as flat tops that move. There more samples pile up than in the tops of a wave: in pieces of
    ``length`` samples those within a share ``NEAR`` of the range are compared with as wide a band below. Its
    level moves slowly from one piece to the next.
    """
    found = np.zeros(row.size, dtype=np.bool_)
    upper = float(np.mean(row[rail] > 0.0))
    if ONE_SIDE < upper < 1.0 - ONE_SIDE:
        return found
    values = row if upper <= ONE_SIDE else -row
    near = NEAR * float(np.ptp(row))
    places, levels = [], []
    for begin in range(0, row.size, length):
        piece = values[begin : begin + length]
        top = float(np.quantile(piece, 0.999))
        at = piece > top - near
        below = int(np.count_nonzero(piece > top - 2.0 * near)) - int(np.count_nonzero(at))
        if np.count_nonzero(at) > PILED_UP * (below + 1):
            places.append(begin + 0.5 * length)
            levels.append(float(np.median(piece[at])))
    if len(places) < FEWEST:
        return found
    over = values - np.interp(np.arange(row.size), places, levels)
    # A rail is not crossed, but by spikes.
    return found if np.mean(over > near) > CROSSED else np.asarray(over > -0.5 * near)


def _disturbed(gone: Mask, period: float) -> Mask:
    """Return which samples follow missing samples of the body too closely."""
    found = _extended(gone, round(AFTER / period) + 1)
    long = max(1, round(LONG / period))
    if gone.any():
        runs = np.convolve(gone.astype(np.float64), np.ones(long), mode="full")[: gone.size] >= long - 0.5
        found |= _extended(runs, round(AFTER_LONG / period) + 1)
    return found


def _extended(mask: Mask, length: int) -> Mask:
    near = np.convolve(mask.astype(np.float64), np.ones(length), mode="full")[: mask.size]
    return np.asarray(near > 0.0)

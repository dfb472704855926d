"""Accounts of a pair of channels, compiled: what a valve, a gain, a delay or a step of a clock leave of it.

All of them are least squares of few rows, so sums of products over pieces of the record are all they need.
The rows are those of :class:`~.channel_pair.ChannelPair`: of the spool its slope, itself, and it integrated
once, twice and three times; of the body it integrated as often.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array, Complex

#: Speed over its rms below which dry friction is taken as proportional to it.
SMOOTH = 0.05
#: Times as finely as the pair is sampled that delays are tried, and that the sign of its velocity is taken.
FINE = 8
#: Delays that are tried within a reach.
TRIES = 401


@compiled
def remainder(sums: Array) -> tuple[float, Array]:
    """Return what least squares leave of the first row by the others, from their products, and the values."""
    size, left = sums.shape[0] - 1, sums[0, 0]
    scale, normal, values = np.empty(size), np.empty((size, size)), np.empty(size)
    for i in range(size):
        scale[i] = math.sqrt(max(sums[i + 1, i + 1], 1e-300))
    for i in range(size):
        values[i] = sums[0, i + 1] / scale[i]
        for j in range(size):
            normal[i, j] = sums[i + 1, j + 1] / (scale[i] * scale[j])
        normal[i, i] += 1e-9
    for i in range(size):
        left -= values[i] * values[i] / normal[i, i]
        for j in range(i + 1, size):
            share = normal[j, i] / normal[i, i]
            values[j] -= share * values[i]
            for k in range(i + 1, size):
                normal[j, k] -= share * normal[i, k]
    for i in range(size - 1, -1, -1):
        for j in range(i + 1, size):
            values[i] -= normal[i, j] * values[j]
        values[i] /= normal[i, i]
    return left, values / scale


@compiled
def sign_of(velocity: Array, sign: Array) -> None:
    """Fill ``sign`` with that of a velocity, shape (m,), smooth where it is slow."""
    mean = square = 0.0
    for i in range(velocity.size):
        mean += velocity[i]
        square += velocity[i] * velocity[i]
    mean /= velocity.size
    speed = SMOOTH * math.sqrt(max(0.0, square / velocity.size - mean * mean)) + 1e-12
    for i in range(velocity.size):
        sign[i] = math.tanh(velocity[i] / speed)


@compiled
def products(rows: Array, first: int, last: int, sums: Array) -> None:
    """Fill ``sums``, shape (4, 4), with the products of four rows from ``first`` before ``last``."""
    aa = az = av = af = zz = zv = zf = vv = vf = ff = 0.0
    for i in range(first, last):
        a, z, v, f = rows[0, i], rows[1, i], rows[2, i], rows[3, i]
        aa += a * a
        az += a * z
        av += a * v
        af += a * f
        zz += z * z
        zv += z * v
        zf += z * f
        vv += v * v
        vf += v * f
        ff += f * f
    sums[0, 0], sums[0, 1], sums[0, 2], sums[0, 3] = aa, az, av, af
    sums[1, 1], sums[1, 2], sums[1, 3], sums[2, 2], sums[2, 3], sums[3, 3] = zz, zv, zf, vv, vf, ff
    for i in range(4):
        for j in range(i):
            sums[i, j] = sums[j, i]


@compiled
def leaves(
    spool: Array, body: Array, gain: float, corner: float, slip: float, left: Array
) -> tuple[float, float, float, float]:
    """Fill ``left``, shape (m,), with what the best valve leaves over the spool's rms.

    Return its mean square, and the valve's stiffness, damping and friction per mass. ``spool``, shape (5, m),
    and ``body``, shape (3, m), are the rows of a pair; ``gain`` is the logarithm, ``corner`` in rad/s, and
    ``slip`` (s) a small delay besides.
    """
    count = left.size
    keep, high, low = math.exp(-gain), max(0.0, corner), max(0.0, -corner)
    rows = np.empty((4, count))
    mean = 0.0
    for i in range(count):
        here, once, twice = spool[1, i], spool[2, i], spool[3, i]
        acceleration = keep * (here + slip * spool[0, i] + high * (once + slip * here))
        rows[0, i] = acceleration
        rows[1, i] = keep * (twice + slip * once + high * (spool[4, i] + slip * twice))
        rows[1, i] -= body[1, i] + low * body[2, i]
        rows[2, i] = keep * (once + slip * here + high * (twice + slip * once))
        rows[2, i] -= body[0, i] + low * body[1, i]
        mean += acceleration
    mean /= count
    sign_of(rows[2], rows[3])
    sums = np.empty((4, 4))
    products(rows, 0, count, sums)
    square, values = remainder(sums)
    scale = 1.0 / (math.sqrt(max(0.0, sums[0, 0] / count - mean * mean)) + 1e-300)
    for i in range(count):
        left[i] = scale * (
            rows[0, i] - values[0] * rows[1, i] - values[1] * rows[2, i] - values[2] * rows[3, i]
        )
    return scale * scale * square / count, -values[0], -values[1], -values[2]


@compiled
def glance(rows: Array, bins: int, margin: int, half: int) -> tuple[float, float, float, float, float]:
    """Return what accounts leave of a pair, see :class:`Glance`.

    ``rows``, shape (9, m): spool, its slope, spool integrated once to three times, body as often, and room.
    All accounts are linear in them: gain and corner of either channel exactly, a delay to first order. Pieces
    have ``bins`` samples; a moment has ``margin`` pieces on both sides, ``half`` of which it mixes.
    """
    kinds, size = rows.shape
    velocity = rows[2] - rows[5]
    sign_of(velocity, rows[8])
    count = size // bins
    # A drift grows from piece to piece: of the spool, its slope and its first integral.
    drifts = np.array([1, 0, 2])
    wide = kinds + drifts.size
    upto, whole = np.zeros((count + 1, kinds, kinds)), np.zeros((wide, wide))
    for piece in range(count):
        last = (piece + 1) * bins if piece < count - 1 else size
        cut = np.ascontiguousarray(rows[:, piece * bins : last])
        sums = np.dot(cut, cut.T)
        upto[piece + 1] = upto[piece] + sums
        late = piece - 0.5 * (count - 1)
        for i in range(drifts.size):
            whole[kinds + i, :kinds] += late * sums[drifts[i]]
            for j in range(drifts.size):
                whole[kinds + i, kinds + j] += late * late * sums[drifts[i], drifts[j]]
    total = upto[count]
    whole[:kinds, :kinds] = total
    whole[:kinds, kinds:] = whole[kinds:, :kinds].T
    # Without a fault: displacement, velocity and its sign.
    valve = np.zeros((4, kinds))
    valve[0, 0] = valve[1, 3] = valve[2, 2] = valve[3, 8] = 1.0
    valve[1, 6] = valve[2, 5] = -1.0
    power = max(total[0, 0], 1e-300)
    plain, values = remainder(np.dot(np.dot(valve, total), valve.T))
    constant = remainder(whole)[0]
    # A delay moves the spool along its slope, a gain changes what is the body's of the motion.
    bent = np.zeros((6, kinds))
    bent[:4] = valve
    bent[4, 1], bent[4, 2], bent[4, 0] = 1.0, -values[0], -values[1]
    bent[5, 6], bent[5, 5] = values[0], values[1]
    delayed, moved = remainder(np.dot(np.dot(bent, total), bent.T))
    best = 1.0
    if count >= 4 * margin:
        for split in range(margin, count - margin + 1):
            before, after = upto[split - half], total - upto[split + half]
            kept = before + after
            parted = remainder(before)[0] + remainder(after)[0]
            alike = remainder(np.dot(np.dot(valve, kept), valve.T))[0]
            best = min(best, parted / max(alike, 1e-300))
    return plain / power, constant / power, best * plain / power, -moved[3], delayed / power


@compiled
def piece_sums(
    fine: Array, body: Array, delays: NDArray[np.int64], gain: float, bins: int, count: int
) -> Array:
    """Return the normal equations of ``count`` pieces for each delay, shape (delays, count, 4, 4).

    Every account of a step is a sum of these. ``fine`` has the spool, and it integrated once and twice, shape
    (3, FINE n), ``body`` its rows; delays are in samples of ``fine``.
    """
    size, whole = body.shape[1], fine.shape[1]
    edge, keep = (whole // FINE - size) // 2, math.exp(-gain)
    sums, rows = np.empty((delays.size, count, 4, 4)), np.empty((4, size))
    for place in range(delays.size):
        at = (FINE * edge + delays[place]) % whole
        for i in range(size):
            rows[0, i] = keep * fine[0, at]
            rows[1, i] = keep * fine[2, at] - body[1, i]
            rows[2, i] = keep * fine[1, at] - body[0, i]
            at += FINE
            if at >= whole:
                at -= whole
        sign_of(rows[2], rows[3])
        for piece in range(count):
            products(rows, piece * bins, (piece + 1) * bins, sums[place, piece])
    return sums


@compiled
def best_step(totals: Array, margin: int, half: int, none: int) -> tuple[int, int, int, float, float, float]:
    """Return the moment (in pieces) and the delays before and behind it by which a step explains most.

    And the residuals, rms, of no step, of the step, and of a valve that changes. ``totals``, shape
    (delays, pieces + 1, 4, 4), are the normal equations up to each piece; ``none`` is the place of no delay.
    """
    delays, count = totals.shape[0], totals.shape[1] - 1
    early, late = np.empty(delays), np.empty(delays)
    found, ratio = (margin, none, none, math.inf, math.inf, math.inf), math.inf
    for split in range(margin, count - margin + 1):
        common = valve = math.inf
        first = second = none
        for i in range(delays):
            before, after = totals[i, split - half], totals[i, count] - totals[i, split + half]
            early[i], late[i] = remainder(before)[0], remainder(after)[0]
            left = remainder(before + after)[0]
            if left < common:
                common, first, second = left, i, i
            valve = min(valve, early[i] + late[i])
        clock = common
        for i in range(delays):
            for j in range(delays):
                # One valve for both parts leaves no less than one for each.
                if i != j and early[i] + late[j] < clock:
                    left = remainder(totals[i, split - half] + totals[j, count] - totals[j, split + half])[0]
                    if left < clock:
                        clock, first, second = left, i, j
        scale = (
            totals[none, split - half, 0, 0] + totals[none, count, 0, 0] - totals[none, split + half, 0, 0]
        )
        if clock < ratio * max(common, 1e-300):
            ratio = clock / max(common, 1e-300)
            found = (
                split, first, second, math.sqrt(max(0.0, common) / scale),
                math.sqrt(max(0.0, clock) / scale), math.sqrt(max(0.0, valve) / scale),
            )  # fmt: skip
    return found


@compiled
def best_delay(turned: Complex, frequency: Array, known: float, reach: float) -> float:
    """Return the delay (s), within ``reach`` of ``known`` and less that, which turns phases by ``turned``.

    ``turned`` and ``frequency`` (Hz) have shape (lines,).
    """
    step = 2.0 * reach / (TRIES - 1)
    match = np.zeros(TRIES)
    for line in range(frequency.size):
        angle = 2.0 * math.pi * frequency[line]
        now = turned[line] * complex(math.cos(angle * (known - reach)), math.sin(angle * (known - reach)))
        on = complex(math.cos(angle * step), math.sin(angle * step))
        for i in range(TRIES):
            match[i] += now.real
            now *= on
    return step * np.argmax(match) - reach

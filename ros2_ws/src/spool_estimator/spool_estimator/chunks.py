"""Chunks of samples: what a tracker learns from each, compiled, up to what only the tracker can do.

A chunk's standstill, prediction, least squares and the verdict on them are one kernel, which goes on from
chunk to chunk; the seldom steps (a first start, a refit, a new beginning) are handed to the tracker, which
lets the kernel go on behind them. One chunk by itself is a run of one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from spool_core.block import Samples
from spool_core.kernels.compiled import compiled
from spool_core.kernels.samples import StandingArrays, scan
from spool_core.numbers import Array

from spool_estimator.history import DisplacementArrays, follow_displacement, keep, sampled_pointwise
from spool_estimator.prediction import (
    BAND_LIMITED,
    BODY,
    COUNT,
    MEAN_SQUARES,
    POINTWISE,
    RESIDUAL,
    PredictionArrays,
    clear_sums,
    predict,
    shift,
)
from spool_estimator.recursive import RegressionArrays, advance
from spool_estimator.sliding_window import WindowArrays, take_chunk
from spool_estimator.stream_estimator import CHUNK

#: N, force noise that the prior is weighed with, and the least that a record is believed to have.
NOISE, SMALLEST_NOISE = 0.05, 1.0e-3
#: s of samples that the first start needs.
NEEDED = 2.0
#: The valve has changed when the parameters leave CHANGED times the residual power of the best fit to the
#: last chunks (one of these lengths), and when what that fit gains, in residual variances, is SIGNIFICANT and
#: ATYPICAL times what it gained lately: noise shaped by a resonance, or a poor model, gains always.
CHANGED, SIGNIFICANT, ATYPICAL, LENGTHS = 1.25, 300.0, 8.0, (4, 10)
#: Share by which a chunk moves a typical value, and how far in one step.
TYPICAL, TYPICAL_STEP = 0.03, 3.0
#: Chunks until a refit is tried whatever least squares promise, each time twice as many as before: in a long
#: curved valley of the error, as that of dry friction in thick oil, they need a minute where a descent ends.
FIRST_CHECK, LAST_CHECK = 10.0, 320.0
#: Refits saved up at most, and how many more a chunk allows: a model that does not fit must not cost more.
MOST_REFITS, REFITS = 6.0, 0.05
#: Relative residual above which the model does not describe what is seen and a new start is tried, and the
#: residual power, relative to the least seen lately, above which it may be in the wrong local minimum.
POOR, WORSE = 0.25, 16.0
#: Time constants 2 m / c of the motion after which a start from rest is forgotten, and its limits, s.
FORGOTTEN, SHORTEST_SETTLING, LONGEST_SETTLING = 8.0, 0.5, 1.5
#: m/s, rms velocity above which the spool moves.
MOVING = 2.0e-3
#: Error over the body's force (both squared) beyond which the model's motion ran away: of data that no
#: passive valve makes, a dead channel's, least squares make a model that is driven by its own drag.
RAN_AWAY = 1.0e6
#: Share of the correction for the noise of the body's sensor that counts as uncertainty.
DOUBT = 0.5

#: What the kernel asks of its tracker: a refit to one of LENGTHS, a new start where the fit is poor, the
#: step of a sliding window, fresh least squares, a first start, to forget everything, to stand still.
REFIT_SHORT, REFIT_LONG, POOR_START, SLIDE, FRESH, FIRST_START, FORGET, STAND, NOTHING = range(9)

#: Places in the numbers of a tracker: samples that wait for their chunk, those taken by the last call with
#: the chunks that they filled and the samples of these that were used, what is known (see ``Tracker``),
#: what belongs to the prediction, the window of chunks and the history, what a refit gained usually until
#: now, chunks until the next check and between the last two.
(
    WAITING, TAKEN, CHUNKS, USED, STARTED, EXCITED, SETTLING, DISTINGUISHED, LEAST, SINCE_RESTART, ALLOWED,
    PAUSE, EVIDENCE_POINTWISE, EVIDENCE_BAND_LIMITED, EARLIER, POINT_VALUES, WINDOW, KEPT_SAMPLES, USUAL_GAIN,
    CHECK, BETWEEN,
) = range(21)  # fmt: skip
NUMBERS = 21

_LENGTHS = np.array(LENGTHS)
_POOR_SQUARE, _NOISE_SQUARE, _SMALLEST_SQUARE = POOR**2, NOISE**2, SMALLEST_NOISE**2
_MOVING_SQUARE = MOVING**2


class Valve(NamedTuple):
    """Valve and settings of a tracker: numbers that do not change with the samples.

    ``period`` in s, ``mass`` in kg, ``forgetting`` and ``enough`` of the regression, ``least_body`` the mean
    square (m/s^2)^2 that excites, ``runaway`` the error over the body's squares (N^2 over (m/s^2)^2) that no
    valve makes.
    """

    period: float
    mass: float
    forgetting: float
    enough: float
    least_body: float
    runaway: float
    sliding: bool


class TrackerArrays(NamedTuple):
    """Arrays of a tracker itself, which kernels move on in place; see there."""

    numbers: Array
    waiting: Samples
    ring: Samples
    powers: Array
    sizes: Array
    typical: Array
    earlier: Array
    verdicts: Array
    scale: Array
    nominal: Array


@compiled
def follow(
    body: Samples,
    spool: Samples,
    most: int,
    valve: Valve,
    tracker: TrackerArrays,
    standing: StandingArrays,
    displacement: DisplacementArrays,
    run: PredictionArrays,
    window: WindowArrays,
    regression: RegressionArrays,
) -> int:
    """Take samples, shape (n,), m/s^2, until ``most`` chunks are full or one asks; return what it asks."""
    numbers, waiting = tracker.numbers, tracker.waiting
    size = waiting.shape[1]
    taken, chunks, filled = 0, 0, int(numbers[WAITING])
    numbers[TAKEN] = numbers[CHUNKS] = numbers[USED] = 0.0
    while taken < body.size and chunks < most:
        count = min(size - filled, body.size - taken)
        for i in range(count):
            waiting[0, filled + i] = body[taken + i]
            waiting[1, filled + i] = spool[taken + i]
        taken += count
        filled = (filled + count) % size
        numbers[WAITING], numbers[TAKEN] = filled, taken
        if filled:
            break
        chunks += 1
        numbers[CHUNKS] = chunks
        asks = _learn(valve, tracker, standing, displacement, run, window, regression)
        if asks != NOTHING:
            return asks
    return NOTHING


@compiled
def _learn(
    valve: Valve,
    tracker: TrackerArrays,
    standing: StandingArrays,
    displacement: DisplacementArrays,
    run: PredictionArrays,
    window: WindowArrays,
    regression: RegressionArrays,
) -> int:
    """Learn from the chunk that waits; return what it asks."""
    numbers, waiting = tracker.numbers, tracker.waiting
    if scan(waiting, standing):
        return STAND
    keep(tracker.ring, int(numbers[KEPT_SAMPLES]), waiting[0], waiting[1])
    numbers[KEPT_SAMPLES] += waiting.shape[1]
    started = numbers[STARTED] != 0.0
    parameters = regression.parameters if started else tracker.nominal
    pointwise = numbers[POINT_VALUES] != 0.0
    predict(waiting[0], waiting[1], valve.period, valve.mass, parameters, pointwise, run)
    sums = run.sums
    shaken = sums[COUNT] * valve.least_body
    shaken = shaken if shaken > sums[BODY] else sums[BODY]
    if started and not sums[RESIDUAL] <= valve.runaway * shaken:
        return FORGET
    follow_displacement(waiting, displacement)
    numbers[SINCE_RESTART] += 1.0
    settling = numbers[SINCE_RESTART] <= settling_chunks(valve, tracker, regression)
    moves = run.mean_squares[2] > valve.least_body and run.mean_squares[4] > _MOVING_SQUARE
    excited = moves and not settling
    numbers[SETTLING], numbers[EXCITED] = settling, excited
    numbers[ALLOWED] = min(MOST_REFITS, numbers[ALLOWED] + REFITS)
    numbers[PAUSE] -= 1.0
    if not settling:
        for i in range(len(MEAN_SQUARES)):
            new, known = run.mean_squares[i], math.isfinite(tracker.powers[i])
            tracker.powers[i] = tracker.powers[i] + CHUNK * (new - tracker.powers[i]) if known else new
    if excited:
        # Of the motion that taught the parameters; at a standstill they stay what they were.
        tracker.sizes[:] = tracker.powers
        # Weighed by how well the model fits: while the valve changes, neither does.
        left = 1e-30 if sums[RESIDUAL] < 1e-30 else sums[RESIDUAL]
        for place, kind in ((EVIDENCE_POINTWISE, POINTWISE), (EVIDENCE_BAND_LIMITED, BAND_LIMITED)):
            numbers[place] += TYPICAL * (sums[kind] / left - numbers[place])
    if excited and started:
        return regress(REFIT_SHORT, valve, tracker, run, window, regression)
    if excited and numbers[SINCE_RESTART] * CHUNK >= NEEDED - 1e-9 and numbers[PAUSE] <= 0.0:
        return FIRST_START
    end_chunk(tracker, run)
    return NOTHING


@compiled
def regress(
    begin: int,
    valve: Valve,
    tracker: TrackerArrays,
    run: PredictionArrays,
    window: WindowArrays,
    regression: RegressionArrays,
) -> int:
    """Judge the chunk and step by its prediction errors; return what it asks.

    ``begin`` is REFIT_SHORT for a chunk, and what follows on the last answer where its tracker has done,
    in vain, what was asked.
    """
    numbers, powers = tracker.numbers, tracker.powers
    score = run.product - run.noise_score
    if begin == REFIT_SHORT:
        count = run.sums[COUNT] if run.sums[COUNT] > 1.0 else 1.0
        take_chunk(
            window, int(numbers[WINDOW]), run.gram, score, run.sums[RESIDUAL], count,
            regression.parameters / tracker.scale, _LENGTHS, tracker.verdicts,
        )  # fmt: skip
        numbers[WINDOW] += 1.0
        numbers[CHECK] -= 1.0
    for which in range(begin, _LENGTHS.size):
        if numbers[WINDOW] < _LENGTHS[which]:
            continue
        present, own, samples = (
            tracker.verdicts[which, 0],
            tracker.verdicts[which, 1],
            tracker.verdicts[which, 2],
        )
        gain = (present / own - 1.0) * samples
        typical = numbers[USUAL_GAIN] = tracker.typical[which]
        bounded = TYPICAL_STEP * typical if TYPICAL_STEP * typical < gain else gain
        tracker.typical[which] += TYPICAL * (bounded - typical)
        atypical = ATYPICAL * typical if ATYPICAL * typical > SIGNIFICANT else SIGNIFICANT
        changed = present > CHANGED * own and gain > atypical
        due = which == _LENGTHS.size - 1 and numbers[CHECK] <= 0.0
        if (changed or due) and numbers[ALLOWED] >= 1.0:
            return which
    own = tracker.verdicts[_LENGTHS.size - 1, 1]
    if begin <= POOR_START:
        # A descent may have ended in the wrong local minimum: far more is left than was once.
        target = powers[1]
        least = own / target
        numbers[LEAST] = least if least < 1.01 * numbers[LEAST] else 1.01 * numbers[LEAST]
        poor = own > _POOR_SQUARE * target or own > WORSE * numbers[LEAST] * target
        if poor and numbers[SINCE_RESTART] * CHUNK >= NEEDED and numbers[PAUSE] <= 0.0:
            return POOR_START
    if begin <= SLIDE:
        if valve.sliding:
            return SLIDE
        weight = _NOISE_SQUARE / (own + _SMALLEST_SQUARE)
        change = np.empty(score.size)
        advance(
            regression,
            run.gram,
            score,
            DOUBT * run.noise_score,
            weight,
            valve.forgetting,
            valve.enough,
            change,
        )
        change *= tracker.scale
        regression.parameters[:] += change
        shift(run.state, change)
    by_points, band_limited = numbers[EVIDENCE_POINTWISE], numbers[EVIDENCE_BAND_LIMITED]
    numbers[POINT_VALUES] = sampled_pointwise(by_points, band_limited, numbers[POINT_VALUES] != 0.0)
    if sampled_pointwise(by_points, band_limited, True) == sampled_pointwise(by_points, band_limited, False):
        numbers[DISTINGUISHED] = 1.0
    if not (np.isfinite(regression.parameters).all() and regression.parameters[0] > 0.0):
        return FRESH
    end_chunk(tracker, run)
    return NOTHING


@compiled
def end_chunk(tracker: TrackerArrays, run: PredictionArrays) -> None:
    """End a chunk that was learned from: reset its sums and keep the state of the motion."""
    numbers, earlier = tracker.numbers, tracker.earlier
    clear_sums(run)
    earlier[int(numbers[EARLIER]) % earlier.shape[0]] = run.state
    numbers[EARLIER] += 1.0
    if numbers[EXCITED] != 0.0:
        numbers[USED] += tracker.waiting.shape[1]


@compiled
def settling_chunks(valve: Valve, tracker: TrackerArrays, regression: RegressionArrays) -> int:
    """Return the chunks after a restart that nothing is learned from."""
    known = tracker.numbers[STARTED] != 0.0
    viscous = regression.parameters[1] if known else tracker.scale[1]
    viscous = 1e-9 if viscous < 1e-9 else viscous
    time = FORGOTTEN * 2.0 * valve.mass / viscous
    time = time if time > SHORTEST_SETTLING else SHORTEST_SETTLING
    return math.ceil(min(time, LONGEST_SETTLING) / CHUNK)

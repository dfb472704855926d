"""Chunks of samples: what a tracker learns from each, compiled, up to what only the tracker can do.

``follow`` learns from chunk after chunk: standstill, prediction, least squares and the verdict on them. It
ends at a chunk with a seldom ``Need`` (a start, a refit, a new beginning), which the tracker finishes.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
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

#: s, samples are taken in and judged in chunks of this length: chosen, shorter ones cost more calls.
CHUNK = 0.1
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
FIRST_CHECK, LAST_CHECK = 10, 320
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


class Need(IntEnum):
    """What the tracker has to do with the chunk at which a kernel ended."""

    NOTHING = 0
    STANDSTILL = 1  # begin the motion again: a channel does not change
    FORGETTING = 2  # forget everything: the model's motion ran away
    START = 3  # the first start
    REFIT = 4  # a refit, or a new start of a poor fit; the step where none is better
    REGRESSION = 5  # fresh least squares: the parameters are those of no valve


#: Progress of a tracker; each field is a number that the kernels move on in place.
PROGRESS = np.dtype(
    [
        ("taken", np.int64),  # samples that the last call took
        ("chunks", np.int64),  # chunks that they filled
        ("used", np.int64),  # samples of these chunks that were used
        ("started", np.bool_),  # the parameters are those of a fit
        ("excited", np.bool_),  # the last chunk was excited
        ("settling", np.bool_),  # the motion was settling in it
        ("pointwise", np.bool_),  # samples are point values, see Prediction.take
        ("distinguished", np.bool_),  # and it is known whether they are
        ("by_points", np.float64),  # share of the error near jumps that point values leave
        ("band_limited", np.float64),  # and that band-limited samples leave
        ("least", np.float64),  # least residual power of late, relative
        ("since_restart", np.int64),  # chunks since the motion began
        ("earlier", np.int64),  # states kept since then
        ("allowed", np.float64),  # refits saved up
        ("pause", np.int64),  # chunks until the next start
        ("check", np.int64),  # chunks until the next refit whatever is promised
        ("between", np.int64),  # chunks between the last two of these
    ],
    align=True,
)

_LENGTHS = np.array(LENGTHS)
_POOR_SQUARE, _NOISE_SQUARE, _SMALLEST_SQUARE = POOR**2, NOISE**2, SMALLEST_NOISE**2
_MOVING_SQUARE = MOVING**2


class Valve(NamedTuple):
    """Valve and settings of a tracker: numbers that do not change with the samples.

    ``period`` in s, ``mass`` in kg, ``forgetting`` of the regression, ``least_body`` the mean square
    (m/s^2)^2 that excites, ``runaway`` the error over the body's squares (N^2 over (m/s^2)^2) of no valve.
    """

    period: float
    mass: float
    forgetting: float
    least_body: float
    runaway: float


class TrackerArrays(NamedTuple):
    """Arrays of a tracker itself, which kernels move on in place; see there."""

    progress: NDArray[np.void]
    waiting: Samples
    ring: Samples
    powers: Array
    sizes: Array
    typical: Array
    earlier: Array
    verdicts: Array
    scale: Array
    nominal: Array


class Learning(NamedTuple):
    """What learns from a chunk."""

    valve: Valve
    tracker: TrackerArrays
    standing: StandingArrays
    displacement: DisplacementArrays
    run: PredictionArrays
    window: WindowArrays
    regression: RegressionArrays


@compiled
def follow(body: Samples, spool: Samples, filled: int, most: int, learning: Learning) -> int:
    """Learn from samples, shape (n,), m/s^2, of up to ``most`` chunks; return what the last one needs.

    ``filled``: samples that wait already, for the first of them.
    """
    now, waiting = learning.tracker.progress[0], learning.tracker.waiting
    size, taken = waiting.shape[1], 0
    now["taken"] = now["chunks"] = now["used"] = 0
    need = Need.NOTHING
    while need == Need.NOTHING and taken < body.size and now["chunks"] < most:
        count = min(size - filled, body.size - taken)
        for i in range(count):
            waiting[0, filled + i] = body[taken + i]
            waiting[1, filled + i] = spool[taken + i]
        taken += count
        now["taken"] = taken
        if filled + count == size:
            filled = 0
            now["chunks"] += 1
            need = _learn(learning)
    return need.value


@compiled
def _learn(learning: Learning) -> Need:
    """Learn from the chunk that waits; return what it needs."""
    valve, tracker, standing, displacement, run, window, regression = learning
    now, waiting = tracker.progress[0], tracker.waiting
    if scan(waiting, standing):
        return Need.STANDSTILL
    keep(tracker.ring, now["since_restart"] * waiting.shape[1], waiting[0], waiting[1])
    started = now["started"]
    parameters = regression.parameters if started else tracker.nominal
    predict(waiting[0], waiting[1], valve.period, valve.mass, parameters, now["pointwise"], run)
    sums = run.sums
    shaken = sums[COUNT] * valve.least_body
    shaken = shaken if shaken > sums[BODY] else sums[BODY]
    if started and not sums[RESIDUAL] <= valve.runaway * shaken:
        return Need.FORGETTING
    follow_displacement(waiting, displacement)
    now["since_restart"] += 1
    settling = now["since_restart"] <= settling_chunks(valve, tracker, regression)
    moves = run.mean_squares[2] > valve.least_body and run.mean_squares[4] > _MOVING_SQUARE
    excited = moves and not settling
    now["settling"], now["excited"] = settling, excited
    now["allowed"] = min(MOST_REFITS, now["allowed"] + REFITS)
    now["pause"] -= 1
    if not settling:
        for i in range(len(MEAN_SQUARES)):
            new, known = run.mean_squares[i], math.isfinite(tracker.powers[i])
            tracker.powers[i] = tracker.powers[i] + CHUNK * (new - tracker.powers[i]) if known else new
    if excited:
        # Of the motion that taught the parameters; at a standstill they stay what they were.
        tracker.sizes[:] = tracker.powers
        # Weighed by how well the model fits: while the valve changes, neither does.
        left = 1e-30 if sums[RESIDUAL] < 1e-30 else sums[RESIDUAL]
        now["by_points"] += TYPICAL * (sums[POINTWISE] / left - now["by_points"])
        now["band_limited"] += TYPICAL * (sums[BAND_LIMITED] / left - now["band_limited"])
        if started:
            return _regress(valve, tracker, run, window, regression)
        if now["since_restart"] * CHUNK >= NEEDED - 1e-9 and now["pause"] <= 0:
            return Need.START
    end_chunk(tracker, run)
    return Need.NOTHING


@compiled
def _regress(
    valve: Valve, tracker: TrackerArrays, run: PredictionArrays, window: WindowArrays,
    regression: RegressionArrays
) -> Need:  # fmt: skip
    """Judge the chunk and step by its prediction errors; return what it needs."""
    now = tracker.progress[0]
    count = run.sums[COUNT] if run.sums[COUNT] > 1.0 else 1.0
    take_chunk(
        window, run.gram, run.product - run.noise_score, run.sums[RESIDUAL], count,
        regression.parameters / tracker.scale, _LENGTHS, tracker.verdicts,
    )  # fmt: skip
    now["check"] -= 1
    for which in range(_LENGTHS.size):
        if wants_refit(which, tracker, window):
            return Need.REFIT
    if fits_poorly(tracker):
        return Need.REFIT
    for which in range(_LENGTHS.size):
        learn_gain(which, tracker, window)
    now["least"] = least_left(tracker)
    need = step(valve, tracker, run, regression)
    if need == Need.NOTHING:
        end_chunk(tracker, run)
    return need


@compiled
def step(valve: Valve, tracker: TrackerArrays, run: PredictionArrays, regression: RegressionArrays) -> Need:
    """Step by the prediction errors of the chunk; return what it needs."""
    score = run.product - run.noise_score
    weight = _NOISE_SQUARE / (tracker.verdicts[-1, 1] + _SMALLEST_SQUARE)
    change = np.empty(score.size)
    advance(regression, run.gram, score, DOUBT * run.noise_score, weight, valve.forgetting, NOISE, change)
    change *= tracker.scale
    regression.parameters[:] += change
    shift(run.state, change)
    now = tracker.progress[0]
    by_points, band_limited = now["by_points"], now["band_limited"]
    now["pointwise"] = sampled_pointwise(by_points, band_limited, now["pointwise"])
    # Whether that is certain.
    if sampled_pointwise(by_points, band_limited, True) == sampled_pointwise(by_points, band_limited, False):
        now["distinguished"] = True
    holds_spring = np.isfinite(regression.parameters).all() and regression.parameters[0] > 0.0
    return Need.NOTHING if holds_spring else Need.REGRESSION


@compiled
def wants_refit(which: int, tracker: TrackerArrays, window: WindowArrays) -> bool:
    """Whether a refit to the last ``LENGTHS[which]`` chunks is wanted: the valve changed, or it is due."""
    now = tracker.progress[0]
    if window.taken[0] < _LENGTHS[which] or now["allowed"] < 1.0:
        return False
    present, own, samples = tracker.verdicts[which, 0], tracker.verdicts[which, 1], tracker.verdicts[which, 2]
    atypical = ATYPICAL * tracker.typical[which]
    atypical = atypical if atypical > SIGNIFICANT else SIGNIFICANT
    changed = present > CHANGED * own and (present / own - 1.0) * samples > atypical
    return changed or (which == _LENGTHS.size - 1 and now["check"] <= 0)


@compiled
def learn_gain(which: int, tracker: TrackerArrays, window: WindowArrays) -> None:
    """Move what a refit to the last ``LENGTHS[which]`` chunks typically gains towards what it gains now."""
    if window.taken[0] < _LENGTHS[which]:
        return
    present, own, samples = tracker.verdicts[which, 0], tracker.verdicts[which, 1], tracker.verdicts[which, 2]
    gain, typical = (present / own - 1.0) * samples, tracker.typical[which]
    bounded = TYPICAL_STEP * typical if TYPICAL_STEP * typical < gain else gain
    tracker.typical[which] += TYPICAL * (bounded - typical)


@compiled
def least_left(tracker: TrackerArrays) -> float:
    """Return the least relative residual power of late, this chunk included."""
    least = tracker.verdicts[-1, 1] / tracker.powers[1]
    known: float = 1.01 * tracker.progress[0]["least"]
    return least if least < known else known


@compiled
def fits_poorly(tracker: TrackerArrays) -> bool:
    """Whether a new start is due: a descent may have ended in the wrong local minimum."""
    now, own, target = tracker.progress[0], tracker.verdicts[-1, 1], tracker.powers[1]
    # Far more is left than was once.
    poor = own > _POOR_SQUARE * target or own > WORSE * least_left(tracker) * target
    waited: bool = now["since_restart"] * CHUNK >= NEEDED and now["pause"] <= 0
    return poor and waited


@compiled
def end_chunk(tracker: TrackerArrays, run: PredictionArrays) -> None:
    """End a chunk that was learned from: reset its sums and keep the state of the motion."""
    now, earlier = tracker.progress[0], tracker.earlier
    clear_sums(run)
    earlier[now["earlier"] % earlier.shape[0]] = run.state
    now["earlier"] += 1
    if now["excited"]:
        now["used"] += tracker.waiting.shape[1]


@compiled
def settling_chunks(valve: Valve, tracker: TrackerArrays, regression: RegressionArrays) -> int:
    """Return the chunks after a restart that nothing is learned from."""
    viscous = regression.parameters[1] if tracker.progress[0]["started"] else tracker.scale[1]
    viscous = 1e-9 if viscous < 1e-9 else viscous
    time = FORGOTTEN * 2.0 * valve.mass / viscous
    time = time if time > SHORTEST_SETTLING else SHORTEST_SETTLING
    return math.ceil(min(time, LONGEST_SETTLING) / CHUNK)

"""Judgement of a record: can it be analysed, what would an analysis suffer from, and what to do about it.

All commands give the same advice: their limits are in :mod:`spool_core.record_limits`, their sentences here.

Dry friction and strong springs make a spool follow its body, play and soft springs make it lag: each bends
the transfer by as much as a wrong unit does, but at some frequencies. So the record is held against all
valves whose spring and drag are anywhere between, with and without a factor of 9.81.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import signal
from spool_core.errors import InputError
from spool_core.numbers import GRAVITY, Array, Complex
from spool_core.record_limits import LIMITS
from spool_sim.valve import Valve

from spool_estimator.identification.channel_faults import at_rail
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import ChannelNoise, CrossSpectrum, cross_spectrum, noise_of

#: Spring and drag over those of the valve's description: of any valve that may be met, a stuck one included,
#: and of one whose units alone are wrong.
ANY_SPRING: Array = np.geomspace(0.3, 64.0, 36, dtype=np.float64)
SAME_SPRING: Array = np.geomspace(0.7, 1.5, 9, dtype=np.float64)
ANY_DRAG: Array = np.geomspace(0.1, 6.0, 14, dtype=np.float64)
#: The same where the spool floats in the play of its springs: hardly a spring, but the drag that it has.
NO_SPRING: Array = np.geomspace(1e-3, 0.3, 9, dtype=np.float64)
SAME_DRAG: Array = np.geomspace(0.5, 2.0, 7, dtype=np.float64)
#: Frequencies that are looked at, and a distance (natural logarithm) beyond which more says nothing.
LOOKED_AT, FAR = 150, 1.5
#: Share of the frequencies that are the slow ones.
SLOW = 0.1
#: Hz, faster than loggers of accelerometers are.
FASTEST = 1e5


# Rate and length --------------------------------------------------------------------------------------------
class Analysis(enum.Enum):
    """Work that needs a least sample rate; the value is the text people read."""

    ESTIMATE = "an estimate"
    GAP = "`gap`"
    SHAPE = "narrow intervals"


class Need(NamedTuple):
    """Least rate (Hz) that an analysis needs, and the reason."""

    rate: float
    reason: str


#: Least length of a record: s of a stretch without gaps, of such stretches together, and the reason.
LENGTHS = {
    Analysis.ESTIMATE: (
        *(LIMITS.seconds_of_estimate, LIMITS.seconds_of_estimate),
        "the filters settle, the model runs in, and something is fitted",
    ),
    Analysis.GAP: (LIMITS.stretch_of_gap, LIMITS.seconds_of_gap, "windows to fit and to hold out"),
    Analysis.SHAPE: (LIMITS.stretch_of_gap, LIMITS.seconds_of_shape, "20 periods at 1 Hz"),
}


def least_rate(analysis: Analysis, natural_frequency: float, highest: float = 0.0) -> Need:
    """Return the least sample rate of an analysis.

    Args:
        analysis: what the samples are for.
        natural_frequency: of the valve, Hz; 0: unknown.
        highest: frequency of the excitation, Hz; 0: unknown.
    """

    def need(samples: float, frequency: float, what: str) -> Need:
        reason = f"{samples:g} samples in a period of the {what}, {frequency:.3g} Hz"
        return Need(math.ceil(samples * frequency), reason)

    natural, excited = "natural frequency", "highest frequency excited"
    if analysis is Analysis.ESTIMATE:
        return need(LIMITS.samples_of_estimate, natural_frequency, natural)
    of_gap = max(
        need(LIMITS.samples_of_gap, natural_frequency, natural),
        need(LIMITS.samples_of_gap_excited, highest, excited),
    )
    if analysis is Analysis.GAP:
        return of_gap
    return max(of_gap, need(LIMITS.samples_of_shape, highest, excited))


def slowness(analysis: Analysis, sample_rate: float, natural_frequency: float, highest: float = 0.0) -> str:
    """Return that ``sample_rate`` (Hz) is too low for an analysis and the rate to choose; "" where it is not.

    The rate to choose serves every analysis: all commands give the same advice for a record.
    """
    need = least_rate(analysis, natural_frequency, highest)
    if sample_rate >= need.rate:
        return ""
    if sample_rate < LIMITS.samples_of_estimate * natural_frequency:
        highest = 0.0  # the resonance may be folded: what is seen of the excitation is, too
    best = least_rate(Analysis.SHAPE, natural_frequency, highest)
    needs = f"{analysis.value}, which needs {need.rate:.0f} Hz ({need.reason})"
    if best == need:
        needs = f"{analysis.value} ({need.reason})"
    advice = f"sample at {best.rate:.0f} Hz or more"
    reason = "" if best == need else f" ({best.reason}), by which every analysis is served"
    return f"{sample_rate:.6g} Hz is too slow for {needs}: {advice}{reason}"


def shortness(analysis: Analysis, durations: Sequence[float]) -> str:
    """Return that stretches (s, between gaps) are too short for an analysis; "" where they are not.

    As with the rate, the length to choose serves every analysis.
    """
    (stretch, total, reason), (_, best, widest) = LENGTHS[analysis], LENGTHS[Analysis.SHAPE]
    if sum(one for one in durations if one >= stretch) >= total:
        return ""
    needs = f", which needs {total:g} s ({reason})" if total < best else ""
    return (
        f"too short for {analysis.value}{needs}: {sum(durations):.3g} s, the longest "
        f"stretch without gaps {max(durations, default=0.0):.3g} s: record {best:g} s or more ({widest}), by "
        "which every analysis is served"
    )


def check_rate(name: str, sample_rate: float, valve: Valve) -> None:
    """Refuse a record that is sampled too slowly to show the valve's natural frequency.

    Raises:
        InputError: it is; where times in milliseconds or microseconds explain that, they are named.
    """
    slow = slowness(Analysis.ESTIMATE, sample_rate, valve.natural_frequency)
    if not slow:
        return
    needed = least_rate(Analysis.ESTIMATE, valve.natural_frequency).rate
    units = (("milliseconds", 1e3), ("microseconds", 1e6))
    guess = next((unit for unit, factor in units if sample_rate * factor <= FASTEST), "")
    asked = f"; are its times {guess} instead of seconds?" if guess and sample_rate * 1e3 >= needed else ""
    raise InputError(f"{name}: '{valve.id}': {slow}{asked}")


# Units and signs --------------------------------------------------------------------------------------------
def expected_transfer(frequency: Array, valve: Valve) -> Array:
    """Return spool over body by the valve's description, complex, shape of ``frequency`` (Hz)."""
    return np.asarray(_transfer(frequency, valve, np.ones((1, 1)), np.ones((1, 1)))[0, 0])


def difference(size: Array, frequency: Array, valve: Valve, factor: float, springs: Array) -> float:
    """Return how far ``size`` is from ``factor`` times the nearest valve: mean difference of logarithms.

    Args:
        size: amplitude of the transfer, shape (n,).
        frequency: Hz, shape (n,).
        valve: the description.
        factor: on its transfer.
        springs: that are tried, over the description's.
    """
    apart, _ = _nearest(size, frequency, valve, factor, springs, ANY_DRAG)
    if springs is not ANY_SPRING:
        return apart
    floating, _ = _nearest(size, frequency, valve, factor, NO_SPRING, SAME_DRAG)
    # A valve whose spool floats in its play above some frequency.
    swings = _apart(size, frequency, valve, factor, ANY_SPRING, ANY_DRAG)
    floats = _apart(size, frequency, valve, factor, NO_SPRING[:1], ANY_DRAG)
    below = np.cumsum(swings, axis=-1)
    above = np.cumsum(floats[..., ::-1], axis=-1)[..., ::-1]
    return min(apart, floating, float((below[..., :-1] + above[..., 1:]).min()) / swings.shape[-1])


def opposite(ratio: Complex, frequency: Array, valve: Valve) -> bool:
    """Whether ``ratio`` (complex) has the sign of no valve: one sensor is turned round."""
    apart, (spring, drag) = _nearest(np.abs(ratio), frequency, valve, 1.0, ANY_SPRING, ANY_DRAG)
    nearest = _transfer(frequency, valve, np.array([[spring]]), np.array([[drag]]))[0, 0]
    described = expected_transfer(frequency, valve)
    # Exchanged channels have no valve's amplitude, and their angle says nothing.
    tried = (described, nearest) if apart < LIMITS.unlike_described else (described,)
    # A channel that lags, as behind a low-pass, has the right sign where the excitation is slow.
    slow = frequency <= np.quantile(frequency, SLOW)
    alike = [np.cos(np.angle(ratio / one)) for one in tried]
    return any(
        np.median(row) < LIMITS.opposite and np.median(row[slow]) < LIMITS.opposite_slow for row in alike
    )


def wrong_unit(ratio: Complex, frequency: Array, valve: Valve) -> float:
    """Return the factor by which the spool's channel reads too much (9.81), too little (1/9.81), or 1."""
    size = np.abs(ratio)
    unscaled = difference(size, frequency, valve, 1.0, ANY_SPRING)
    # Everywhere alike, next to the description as it stands.
    powers = np.log(np.maximum(size, 1e-9) / np.abs(expected_transfer(frequency, valve))) / math.log(GRAVITY)
    for sign in (1.0, -1.0):
        factor = GRAVITY**sign
        left = difference(size, frequency, valve, factor, SAME_SPRING)
        shifted = np.median(np.abs(powers - sign)) < 0.35 * np.median(np.abs(powers))
        everywhere = float(np.quantile(sign * powers, 0.25)) > 0.5 and bool(shifted)
        clearly = left < LIMITS.wrong_unit * unscaled and unscaled > LIMITS.unlike_described
        if clearly or (everywhere and left < LIMITS.wrong_unit_everywhere * unscaled):
            return float(factor)
    return 1.0


def like_no_valve(ratio: Complex, frequency: Array, valve: Valve) -> bool:
    """Whether ``ratio`` is the transfer of no valve with this mass, whatever its spring and drag."""
    return difference(np.abs(ratio), frequency, valve, 1.0, ANY_SPRING) > LIMITS.like_no_valve


def _transfer(frequency: Array, valve: Valve, spring: Array, drag: Array) -> Array:
    angular = 2j * np.pi * frequency
    force = valve.spring_stiffness * spring[..., np.newaxis] + (
        angular * valve.likely_viscous_coefficient * drag[..., np.newaxis]
    )
    return np.asarray(force / (force + valve.moving_mass * angular**2))


def _nearest(
    size: Array, frequency: Array, valve: Valve, factor: float, springs: Array, drags: Array
) -> tuple[float, tuple[float, float]]:
    apart = _apart(size, frequency, valve, factor, springs, drags).mean(axis=-1)
    spring, drag = np.unravel_index(int(np.argmin(apart)), apart.shape)
    return float(apart[spring, drag]), (float(springs[spring]), float(drags[drag]))


def _apart(size: Array, frequency: Array, valve: Valve, factor: float, springs: Array, drags: Array) -> Array:
    """Return how far ``size`` is from valves at each frequency, shape (springs, drags, frequencies)."""
    some = np.unique(np.linspace(0, frequency.size - 1, min(frequency.size, LOOKED_AT)).astype(int))
    spring, drag = np.meshgrid(springs, drags, indexing="ij")
    tried = np.log(factor * np.abs(_transfer(frequency[some], valve, spring, drag)))
    return np.asarray(np.minimum(np.abs(np.log(np.maximum(size[some], 1e-9)) - tried), FAR))


# Records ----------------------------------------------------------------------------------------------------
def usable(records: Sequence[Record]) -> tuple[list[Record], list[str]]:
    """Return the stretches that are long enough, and warnings about the others.

    Raises:
        InputError: there is none, or a channel is dead.
    """
    warnings = []
    short = shortness(Analysis.GAP, [record.duration for record in records])
    if short:
        raise InputError(f"{records[0].name if records else 'record'}: {short}")
    kept = [record for record in records if record.duration >= LIMITS.stretch_of_gap]
    gaps = sum(not record.cut for record in records) - 1
    if gaps > 0:
        lost = sum(record.duration for record in records) - sum(record.duration for record in kept)
        warnings.append(f"the record has {gaps} gaps; {len(kept)} stretches are used, {lost:.1f} s left out")
    for record in kept:
        dead, stopped = unchanging(record)
        if dead:
            raise InputError(f"{record.name}: {dead[0]}")
        warnings += stopped
    return [part for record in kept for part in changing(record, LIMITS.stretch_of_gap)] or kept, warnings


def changing(record: Record, least: float) -> list[Record]:
    """Return ``record``, or its parts of ``least`` s or more in which both channels change if one stops."""
    found = [record]
    for name in ("body", "spool"):
        found = [part for one in found for part in _without_still(one, getattr(one, name))]
    return [part for part in found if part is record or part.duration >= least]


def unchanging(record: Record) -> tuple[list[str], list[str]]:
    """Return a sentence for each channel that is dead, and for each that stops for a while."""
    dead, stopped = [], []
    for name, row in (("body", record.body), ("spool", record.spool)):
        edges = np.flatnonzero(np.concatenate([[True], np.diff(row) != 0.0, [True]]))
        still = int(np.diff(edges).max()) * record.sample_period
        if still > LIMITS.still and edges.size == 2:
            dead.append(f"{name} reads {row[0]:g} m/s^2 throughout: check sensor and cable")
        elif still > LIMITS.still:
            stopped.append(f"{name} does not change for {still:.1f} s: check sensor and cable")
    return dead, stopped


def judge(record: Record, valve: Valve) -> tuple[list[str], bool]:
    """Return what is doubtful about ``record``, one line each, and whether a verdict may still be trusted.

    Raises:
        InputError: the record cannot be analysed: no excitation, a channel dead, sampled too slowly,
            channels exchanged, or a unit that is off by 9.81.
    """
    noise = noise_of(record.body, record.spool, record.sample_rate)
    natural = valve.natural_frequency
    refused, doubt = sampling(record, noise, natural, [Analysis.GAP])
    if refused:
        raise InputError(f"{record.name}: {refused}")
    ratio, coherent, frequency = transfer(record, noise)
    wrong, misfit = misread(ratio, coherent, frequency, valve)
    if wrong:
        raise InputError(f"{record.name}: {wrong}")
    warnings = [one for one in (doubt, misfit) if one]
    if coherent >= LIMITS.incoherent and frequency.size and float(frequency.min()) > 1.3 * natural:
        warnings.append(
            f"the excitation begins at {noise.low:.0f} Hz, above the natural frequency of {natural:.1f} Hz: "
            "gain, stiffness and slow friction are hardly determined there"
        )
    return warnings, not misfit


def sampling(
    record: Record, noise: ChannelNoise, natural: float, analyses: Iterable[Analysis]
) -> tuple[str, str]:
    """Return that a record is too slow for one of ``analyses`` or only noise, and ``noisiness``'s doubt.

    ``natural`` is the valve's natural frequency, Hz; 0: unknown.
    """
    unseen, doubt = noisiness(record, noise)
    highest = 0.0 if unseen else min(noise.high, 0.5 * record.sample_rate)
    texts = (slowness(one, record.sample_rate, natural, highest) for one in analyses)
    slow = next(filter(None, texts), "")
    # What is sampled too slowly folds back and looks like noise.
    folded = record.sample_rate < least_rate(Analysis.GAP, natural).rate
    return slow if folded else unseen or slow, doubt


def noisiness(record: Record, noise: ChannelNoise) -> tuple[str, str]:
    """Return that a channel shows only noise, and that noise drowns the spool's motion; "" where not."""
    body, spool = float(record.body.std()), float(record.spool.std())
    moves = body >= LIMITS.excited * noise.body_rms and noise.high > noise.low
    missing = "is its sensor dead, or not mounted?"
    if not moves and spool > LIMITS.excited * max(noise.spool_rms, noise.body_rms):
        return f"body shows only noise ({body:.3g} m/s^2) while spool moves: {missing}", ""
    if not moves:
        seen = f"no excitation: body has {body:.3g} m/s^2 rms, its noise {noise.body_rms:.3g}"
        return f"{seen}: shake the body harder, at 10 to 100 Hz, or use a finer sensor", ""
    drowned = spool < LIMITS.excited * noise.spool_rms
    if drowned and spool < 0.05 * body:
        return f"spool shows only noise ({spool:.3g} m/s^2) while body moves with {body:.3g}: {missing}", ""
    if drowned and not noise.spool_is_bound:
        seen = f"spool: its noise of {noise.spool_rms:.2g} m/s^2 (rms) drowns the motion of {spool:.2g} m/s^2"
        return "", f"{seen}: shake the body harder, or use a finer sensor"
    return "", ""


def clipping(records: Sequence[Record]) -> list[str]:
    """Return a sentence for each channel that clips in ``records``: its limit, and how often."""
    found = []
    for name in ("body", "spool"):
        share, limit = rail_of([getattr(record, name) for record in records])
        if share > 0.0:
            found.append(
                f"{name} clips at {limit:.4g} m/s^2 in {100.0 * share:.2g} % of the samples: choose a larger "
                "range of the sensor"
            )
    return found


def rail_of(rows: Sequence[Array]) -> tuple[float, float]:
    """Return the share of samples of ``rows`` at a rail and their largest size, m/s^2; 0 without a rail."""
    found = [row[rail] for row in rows if (rail := at_rail(row - row.mean())) is not None]
    if not found:
        return 0.0, 0.0
    share = sum(row.size for row in found) / sum(row.size for row in rows)
    return share, max(float(np.median(np.abs(row))) for row in found)


def check_samples(name: str, records: Sequence[Record]) -> None:
    """Refuse what nothing can be learnt from.

    Raises:
        InputError: no stretch is long enough, a channel is dead, or the body does not move.
    """
    short = shortness(Analysis.ESTIMATE, [record.duration for record in records])
    if short:
        raise InputError(f"{name}: {short}")
    used = [record for record in records if record.duration >= LIMITS.seconds_of_estimate]
    dead = next((dead for record in used for dead in unchanging(record)[0]), "")
    if dead:
        raise InputError(f"{name}: {dead}")
    longest = max(used, key=lambda record: record.body.size)
    unseen, _ = noisiness(longest, noise_of(longest.body, longest.spool, longest.sample_rate))
    if unseen and not any(_stands_out(record) for record in used):
        raise InputError(f"{name}: {unseen}")


def misread(ratio: Complex, coherent: float, frequency: Array, valve: Valve) -> tuple[str, str]:
    """Return what is wrong with how the channels were read, and what is doubtful; empty where nothing is."""
    apart = unrelated(coherent)
    if apart:
        return "", apart
    wrong = unit_or_exchange(ratio, frequency, valve, coherent)
    if wrong or frequency.size < 4 or not like_no_valve(ratio, frequency, valve):
        return wrong, ""
    return "", (
        "no spring explains the transfer from body to spool with this mass: check the units of both "
        "channels, the order of the columns and the valve file"
    )


def unrelated(coherent: float) -> str:
    """Return that body and spool hardly belong together, by the coherence of ``transfer``; "" if they do."""
    if not coherent < LIMITS.incoherent:
        return ""
    return (
        f"body and spool hardly belong together (coherence {coherent:.2f}): "
        "same valve, same clock, sensors tight?"
    )


def doubts_of(records: Sequence[Record], valve: Valve) -> list[str]:
    """Return a sentence for each thing in ``records`` of ``valve`` that a fit to them suffers from."""
    found = []
    for record in records:
        noise = noise_of(record.body, record.spool, record.sample_rate)
        natural = valve.natural_frequency
        said = [*unchanging(record)[1], *clipping([record]), *sampling(record, noise, natural, ())]
        said.append(next(filter(None, misread(*transfer(record, noise), valve)), ""))
        found += [f"{record.name}: {one}" for one in said if one]
    return found


def transfer(record: Record, noise: ChannelNoise) -> tuple[Complex, float, Array]:
    """Return the spool's acceleration over the body's (complex) where driven, its coherence, and frequency.

    Coherence: share of the spool's power there that the body accounts for; 1 where nothing is driven.
    """
    piece = int(min(record.body.size // 4, round(2.0 * record.sample_rate)))
    both = cross_spectrum(record.body, record.spool, record.sample_rate, piece)
    frequency, body, spool, cross = both.frequency, both.body, both.spool, both.cross
    driven = (body > 30.0 * noise.body) & (frequency >= noise.low) & (frequency <= noise.high)
    ratio = cross[driven] / body[driven]
    coherent = (
        np.sum(np.abs(cross[driven]) ** 2 / body[driven]) / np.sum(spool[driven]) if driven.any() else 1.0
    )
    return ratio, float(coherent), frequency[driven]


def resonance_of(both: CrossSpectrum, noise: ChannelNoise) -> tuple[float, float]:
    """Return frequency (Hz) and height of the highest coherent peak of the spool over the body.

    It lies within the excitation's band, not at the edge; both are NaN where there is none.
    """
    frequency, height = both.frequency, both.amplification
    usable = (frequency >= noise.low) & (frequency <= noise.high) & (both.coherence > LIMITS.coherent)
    peaks = signal.find_peaks(np.where(usable, height, 0.0))[0]
    peaks = [at for at in peaks if usable[max(at - 1, 0) : at + 2].all()]
    best = max(peaks, key=lambda at: height[at], default=0)
    if not peaks or height[best] <= 1.1:
        return math.nan, math.nan
    return float(frequency[best]), float(height[best])


def unit_or_exchange(ratio: Complex, frequency: Array, valve: Valve, coherent: float = 1.0) -> str:
    """Return what is wrong with units or channels, or an empty string.

    Judged by the transfer that the valve's description gives: spool over body, with its sign. Far above the
    resonance, where springs hardly move a spool, dry friction carries it many times farther, incoherently,
    yet never farther than the body.
    """
    if frequency.size < 4:
        return ""
    expected = expected_transfer(frequency, valve)

    def distance(candidate: Array) -> float:
        return float(np.median(np.abs(np.log(np.maximum(np.abs(ratio), 1e-9) / np.abs(candidate)))))

    direct = distance(expected)
    factor = wrong_unit(ratio, frequency, valve)
    carried = coherent < LIMITS.carried and float(np.median(np.abs(ratio))) < 1.0
    if factor > 1.0 and not (carried and float(frequency.min()) > 2.0 * valve.natural_frequency):
        return "spool reads 9.81 times too much: is body in g instead of m/s^2?"
    if factor < 1.0:
        return "spool reads 9.81 times too little: is spool in g instead of m/s^2?"
    if opposite(ratio, frequency, valve):
        return "body and spool have opposite signs: one sensor is turned round: change the sign of its column"
    inverse = 1.0 / expected
    unlike = difference(np.abs(ratio), frequency, valve, 1.0, ANY_SPRING) > LIMITS.unlike_described
    if unlike and direct > 0.45 and distance(inverse) < 0.4 * direct:
        return "body and spool look exchanged: the one that should follow leads: swap the columns"
    return ""


def _without_still(record: Record, row: Array) -> list[Record]:
    edges = np.flatnonzero(np.concatenate([[True], np.diff(row) != 0.0, [True]]))
    still = np.flatnonzero(np.diff(edges) * record.sample_period > LIMITS.still)
    if not still.size:
        return [record]
    firsts = [0, *edges[still + 1].tolist()]
    stops = [*edges[still].tolist(), row.size]
    return [record.part(first, stop) for first, stop in zip(firsts, stops, strict=True) if stop - first > 1]


def _stands_out(record: Record) -> bool:
    """Whether something stands out of the noise in the body's acceleration, or the spool follows it.

    Of a body that is shaken at all frequencies alike nothing stands out.
    """
    piece = max(4, min(record.body.size // 4, max(32, round(0.5 / record.sample_period))))
    both = cross_spectrum(record.body, record.spool, record.sample_rate, piece)
    body, spool = (
        float(row[1:].max()) > LIMITS.stands_out * float(np.median(row[1:]))
        for row in (both.body, both.spool)
    )
    return body or (spool and float(np.median(both.coherence[1:])) > LIMITS.coherent)

"""Checks of a record: whether it can be analysed, which unit or sign is wrong, whether the spool is stuck.

Dry friction and strong springs make a spool follow its body, play and soft springs make it lag: each bends
the transfer by as much as a wrong unit does, but at some frequencies. So the record is held against all
valves whose spring and drag are anywhere between, with and without a factor of 9.81.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array, Complex
from spool_core.record_needs import LENGTHS, Analysis, least_rate, shortness, slowness
from spool_estimator.identification.fit_result import EXPLAINS_NOTHING
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import ChannelNoise, cross_spectrum, noise_of
from spool_sim.valve import Valve

from spool_gap.result import GapResult

#: s without any change from which a channel is dead: noise alone changes a reading within a few samples.
STILL = 0.5
GRAVITY = 9.80665
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
#: Relative motion over that of the described valve, rms, below which a spool is stuck: 26 dB less; a spring
#: or a drag twenty times as strong as described would be needed to move so little.
STUCK = 0.05
#: Share of the body's rms that noise is given in a record whose channels read the same numbers: so little
#: moves no number of the fit.
DITHER = 1e-4
#: Confidence of that verdict: that of others which one clear fact decides.
CONFIDENCE = 0.99

#: Origin that several thresholds share. Blind cases are records of ``spool_blind``; those of the tables in
#: the documentation have other seeds than those that thresholds were chosen on.
CASES = "chosen on blind cases other than the published ones; not derived"


def decided(value: float, unit: str, decides: str, origin: str) -> Any:
    """Return a field of default ``value`` that carries its ``unit``, what it decides, and its origin."""
    return field(default=value, metadata={"unit": unit, "decides": decides, "origin": origin})


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Thresholds of the checks and the verdict; ``described`` returns each one's unit, use and origin."""

    # Checks of the record -------------------------------------------------------------------------------
    excited: float = decided(5.0, "1", "rms over the noise's below which a channel shows only noise", CASES)
    incoherent: float = decided(
        0.3,
        "1",
        "share of the spool's power that is coherent with the body, below which nothing is trusted",
        CASES,
    )
    unlike_described: float = decided(
        0.3, "ln", "distance of the transfer from the described valve's from which units are doubted", CASES
    )
    wrong_unit: float = decided(
        0.6, "1", "share of that distance that may remain if a factor of 9.81 is the cause", CASES
    )
    wrong_unit_everywhere: float = decided(
        0.85, "1", "the same share if the factor reduces the distance for every spring", CASES
    )
    opposite: float = decided(
        -0.7, "1", "cosine to the expected transfer below which a sign is wrong", "more than 135 degrees"
    )
    opposite_slow: float = decided(
        0.35, "1", "cosine at the slow tenth of the frequencies from which the sign is right", CASES
    )
    like_no_valve: float = decided(
        0.65, "ln", "distance of the transfer from any valve's beyond which no valve fits", CASES
    )
    # Verdict ---------------------------------------------------------------------------------------------
    explains_nothing: float = decided(
        EXPLAINS_NOTHING,
        "1",
        "error from which a model explains nothing and the message asks for units or columns",
        CASES,
    )


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
    return min(apart, floating, _floating_above(size, frequency, valve, factor))


def opposite(ratio: Complex, frequency: Array, valve: Valve) -> bool:
    """Whether ``ratio`` (complex) has the sign of no valve: one sensor is turned round."""
    apart, (spring, drag) = _nearest(np.abs(ratio), frequency, valve, 1.0, ANY_SPRING, ANY_DRAG)
    nearest = _transfer(frequency, valve, np.array([[spring]]), np.array([[drag]]))[0, 0]
    described = expected_transfer(frequency, valve)
    # Exchanged channels have no valve's amplitude, and their angle says nothing.
    tried = (described, nearest) if apart < THRESHOLDS.unlike_described else (described,)
    # A channel that lags, as behind a low-pass, has the right sign where the excitation is slow.
    slow = frequency <= np.quantile(frequency, SLOW)
    alike = [np.cos(np.angle(ratio / one)) for one in tried]
    return any(
        np.median(row) < THRESHOLDS.opposite and np.median(row[slow]) < THRESHOLDS.opposite_slow
        for row in alike
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
        clearly = left < THRESHOLDS.wrong_unit * unscaled and unscaled > THRESHOLDS.unlike_described
        if clearly or (everywhere and left < THRESHOLDS.wrong_unit_everywhere * unscaled):
            return float(factor)
    return 1.0


def like_no_valve(ratio: Complex, frequency: Array, valve: Valve) -> bool:
    """Whether ``ratio`` is the transfer of no valve with this mass, whatever its spring and drag."""
    return difference(np.abs(ratio), frequency, valve, 1.0, ANY_SPRING) > THRESHOLDS.like_no_valve


def described() -> Mapping[str, tuple[float, str, str, str]]:
    """Return value, unit, what it decides and origin of each threshold, by name."""
    return {
        entry.name: (
            getattr(THRESHOLDS, entry.name),
            entry.metadata["unit"],
            entry.metadata["decides"],
            entry.metadata["origin"],
        )
        for entry in fields(Thresholds)
    }


def _transfer(frequency: Array, valve: Valve, spring: Array, drag: Array) -> Array:
    angular = 2j * np.pi * frequency
    force = valve.spring_stiffness * spring[..., np.newaxis] + (
        angular * valve.likely_viscous_coefficient * drag[..., np.newaxis]
    )
    return np.asarray(force / (force + valve.moving_mass * angular**2))


def _floating_above(size: Array, frequency: Array, valve: Valve, factor: float) -> float:
    """Return the difference from the nearest valve whose spool floats in its play above some frequency."""
    swings = _apart(size, frequency, valve, factor, ANY_SPRING, ANY_DRAG)
    floats = _apart(size, frequency, valve, factor, NO_SPRING[:1], ANY_DRAG)
    below = np.cumsum(swings, axis=-1)
    above = np.cumsum(floats[..., ::-1], axis=-1)[..., ::-1]
    return float((below[..., :-1] + above[..., 1:]).min()) / swings.shape[-1]


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


#: Thresholds that the analysis uses.
THRESHOLDS = Thresholds()


def usable(records: Sequence[Record]) -> tuple[list[Record], list[str]]:
    """Return the stretches that are long enough, and warnings about the others.

    Raises:
        InputError: there is none, or a channel is dead.
    """
    warnings = []
    short = shortness(Analysis.GAP, [record.duration for record in records])
    if short:
        raise InputError(f"{records[0].name if records else 'record'}: {short}")
    kept = [record for record in records if record.duration >= LENGTHS[Analysis.GAP].stretch]
    gaps = sum(not record.cut for record in records) - 1
    if gaps > 0:
        lost = sum(record.duration for record in records) - sum(record.duration for record in kept)
        warnings.append(f"the record has {gaps} gaps; {len(kept)} stretches are used, {lost:.1f} s left out")
    for record in kept:
        dead, stopped = unchanging(record)
        if dead:
            raise InputError(f"{record.name}: {dead[0]}")
        warnings += stopped
    return [part for record in kept for part in _changing(record)] or kept, warnings


def unchanging(record: Record) -> tuple[list[str], list[str]]:
    """Return a sentence for each channel that is dead, and for each that stops for a while."""
    dead, stopped = [], []
    for name, row in (("body", record.body), ("spool", record.spool)):
        edges = np.flatnonzero(np.concatenate([[True], np.diff(row) != 0.0, [True]]))
        still = int(np.diff(edges).max()) * record.sample_period
        if still > STILL and edges.size == 2:
            dead.append(f"{name} reads {row[0]:g} m/s^2 throughout: check sensor and cable")
        elif still > STILL:
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
    body, spool = float(record.body.std()), float(record.spool.std())
    still = body < THRESHOLDS.excited * noise.body_rms or noise.high <= noise.low
    highest = 0.0 if still else min(noise.high, 0.5 * record.sample_rate)
    slow = slowness(Analysis.GAP, record.sample_rate, natural, highest)
    # First of all: what is sampled too slowly folds back and looks like noise.
    if record.sample_rate < least_rate(Analysis.GAP, natural).rate:
        raise InputError(f"{record.name}: {slow}")
    if still:
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
    if slow:
        raise InputError(f"{record.name}: {slow}")
    ratio, coherent, frequency = transfer(record, noise)
    low = frequency < 0.45 * natural
    wrong, doubt = misread(ratio, coherent, frequency, valve)
    if wrong:
        raise InputError(f"{record.name}: {wrong}")
    warnings, trusted = [doubt] if doubt else [], not doubt
    if coherent < THRESHOLDS.incoherent:
        return warnings, False
    if not low.any() and frequency.size and float(frequency.min()) > 1.3 * natural:
        warnings.append(
            f"the excitation begins at {noise.low:.0f} Hz, above the natural frequency of {natural:.1f} Hz: "
            "gain, stiffness and slow friction are hardly determined there"
        )
    return warnings, trusted


def misread(ratio: Complex, coherent: float, frequency: Array, valve: Valve) -> tuple[str, str]:
    """Return what is wrong with how the channels were read, and what is doubtful; empty where nothing is."""
    apart = unrelated(coherent)
    if apart:
        return "", apart
    wrong = unit_or_exchange(ratio, frequency, valve)
    if wrong or frequency.size < 4 or not like_no_valve(ratio, frequency, valve):
        return wrong, ""
    return "", (
        "no spring explains the transfer from body to spool with this mass: check the units of both "
        "channels, the order of the columns and the valve file"
    )


def unrelated(coherent: float) -> str:
    """Return that body and spool hardly belong together, by the coherence of ``transfer``; "" if they do."""
    if not coherent < THRESHOLDS.incoherent:
        return ""
    return (
        f"body and spool hardly belong together (coherence {coherent:.2f}): "
        "same valve, same clock, sensors tight?"
    )


def reading_doubts(records: Sequence[Record], valve: Valve) -> list[str]:
    """Return a sentence for each of ``records`` whose channels were hardly read as they were measured."""
    found = []
    for record in records:
        noise = noise_of(record.body, record.spool, record.sample_rate)
        said = next(filter(None, misread(*transfer(record, noise), valve)), "")
        found += [f"{record.name}: {said}"] if said else []
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


def unit_or_exchange(ratio: Complex, frequency: Array, valve: Valve) -> str:
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


# Stuck spool ------------------------------------------------------------------------------------------------
def is_stuck(records: Sequence[Record], valve: Valve) -> bool:
    """Whether the spool of ``valve`` moves with its body throughout ``records``."""
    return all(_is_stuck(record, valve) for record in records)


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


def thresholds_table() -> str:
    """Return the thresholds as a table in Markdown."""
    rows = [
        f"| `{name}` | {value:g} | {unit} | {decides} | {origin} |"
        for name, (value, unit, decides, origin) in described().items()
    ]
    return "\n".join(["| threshold | value | unit | decides | origin |", "|---|---|---|---|---|", *rows])


def _changing(record: Record) -> list[Record]:
    """Return the parts of ``record`` that are long enough and in which both channels change."""
    found = [record]
    for name in ("body", "spool"):
        found = [part for one in found for part in _without_still(one, getattr(one, name))]
    return [part for part in found if part.duration >= LENGTHS[Analysis.GAP].stretch]


def _without_still(record: Record, row: Array) -> list[Record]:
    edges = np.flatnonzero(np.concatenate([[True], np.diff(row) != 0.0, [True]]))
    still = np.flatnonzero(np.diff(edges) * record.sample_period > STILL)
    if not still.size:
        return [record]
    firsts = [0, *edges[still + 1].tolist()]
    stops = [*edges[still].tolist(), row.size]
    return [record.part(first, stop) for first, stop in zip(firsts, stops, strict=True) if stop - first > 1]


def _is_stuck(record: Record, valve: Valve) -> bool:
    rate = record.sample_rate
    noise = noise_of(record.body, record.spool, rate)
    piece = int(min(record.body.size, max(256, 2 ** round(np.log2(rate)))))
    both = cross_spectrum(record.body, record.spool - record.body, rate, piece)
    frequency, body, moved = both.frequency, both.body, both.spool
    driven = (frequency >= noise.low) & (frequency <= noise.high) & (frequency > 0.0)
    if not driven.any():
        return False
    expected = np.abs(expected_transfer(frequency[driven], valve) - 1.0) ** 2 * body[driven]
    shown = np.maximum(moved[driven] - noise.body - noise.spool, 0.0)
    return float(shown.sum()) < STUCK**2 * float(expected.sum())


if __name__ == "__main__":
    print(thresholds_table())

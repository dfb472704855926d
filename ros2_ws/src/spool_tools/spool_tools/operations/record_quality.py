"""Quality of a record: what its channels hold, and what an estimate from it would suffer from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from spool_core.numbers import Array
from spool_estimator.identification.channel_faults import at_rail
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import cross_spectrum, noise_of

from spool_tools.operations.record_loading import channel_faults, cleaned_stretches, outliers_text

#: Squared coherence from which the spool follows the body, as the noise estimate has it.
COHERENT = 0.5
#: s of the pieces that spectra are averaged over: lines 0.5 Hz apart.
PIECE = 2.0
#: Share of samples at a rail from which fits lose what they need: half a per cent of a sine's time are the
#: outer 0.01 % of its height.
CLIPPED = 0.005
#: Signal over noise (rms) below which parameters become uncertain by more than a tenth in a minute.
QUIET = 3.0
#: Hz of rate over the highest frequency of the excitation, by which its shape is known (ISO 18431-1 asks for
#: 2.56 of a spectrum; steps of friction need their harmonics, of which the third still lies below half of
#: it).
RATE_OVER_BAND = 8.0
#: s from which a record tells of friction: 20 periods at 1 Hz.
SHORT = 20.0


@dataclass(frozen=True, slots=True)
class ChannelQuality:
    """Quality of a channel: ``mean``, ``rms`` about it, ``peak``, ``noise`` in m/s^2, ``clipped`` share.

    ``at_most``: the noise is an upper bound, since motion reaches up to the frequencies it is seen at.
    """

    name: str
    mean: float
    rms: float
    peak: float
    noise: float
    clipped: float
    at_most: bool = False


@dataclass(frozen=True, slots=True)
class Response:
    """Response of the spool over ``frequency`` (Hz): densities, amplification, squared coherence."""

    frequency: Array
    body: Array
    spool: Array
    amplification: Array
    coherence: Array


@dataclass(slots=True)
class RecordQuality:
    """Quality of a record.

    ``band``: Hz, of the excitation. ``coherence``: median in it. ``resonance``: Hz and amplification of the
    highest coherent peak, NaN where none is seen. ``doubts``: what an estimate would suffer from.
    """

    name: str
    duration: float
    rate: float
    gaps: int
    missing: float
    channels: tuple[ChannelQuality, ChannelQuality]
    band: tuple[float, float]
    coherence: float
    resonance: tuple[float, float]
    response: Response
    longest: Record
    doubts: list[str] = field(default_factory=list)

    def dictionary(self) -> dict[str, Any]:
        """Return the quality as JSON has it, SI units, ``None`` for what is not known."""
        known = math.isfinite(self.resonance[0])
        return {
            "record": self.name,
            "duration_s": self.duration,
            "sample_rate_Hz": self.rate,
            "gaps": self.gaps,
            "missing_s": self.missing,
            "channels": {
                one.name: {
                    "mean": one.mean,
                    "rms": one.rms,
                    "peak": one.peak,
                    "noise_rms": one.noise,
                    "noise_is_upper_bound": one.at_most,
                    "clipped": one.clipped,
                    "unit": "m/s^2",
                }
                for one in self.channels
            },
            "excitation": {"low_Hz": self.band[0], "high_Hz": self.band[1]},
            "coherence": self.coherence,
            "resonance": {
                "frequency_Hz": self.resonance[0] if known else None,
                "amplification": self.resonance[1] if known else None,
            },
            "doubts": self.doubts,
        }


def quality_of(
    stretches: Sequence[Record], name: str, warnings: Sequence[str] = (), left_out: int = 0
) -> RecordQuality:
    """Return the quality of a record, its stretches in order of time; ``warnings`` of its reading join.

    ``left_out`` are impossible samples that are left out already; those in ``stretches`` are left out here.
    """
    stretches, more = cleaned_stretches(stretches)
    left_out += more
    longest = max(stretches, key=lambda one: one.body.size)
    rate = longest.sample_rate
    noise = noise_of(longest.body, longest.spool, rate)
    channels = (
        _channel("body", [one.body for one in stretches], noise.body_rms),
        replace(
            _channel("spool", [one.spool for one in stretches], noise.spool_rms), at_most=noise.spool_is_bound
        ),
    )
    response = _response(longest)
    inside = (response.frequency >= noise.low) & (response.frequency <= noise.high)
    coherence = float(np.median(response.coherence[inside])) if inside.any() else 0.0
    ends = [one.start * 1e-9 + one.duration for one in stretches]
    missing = sum(
        max(0.0, after.start * 1e-9 - end) for end, after in zip(ends[:-1], stretches[1:], strict=True)
    )
    found = RecordQuality(
        name,
        sum(one.duration for one in stretches),
        rate,
        len(stretches) - 1,
        missing,
        channels,
        (noise.low, noise.high),
        coherence,
        _resonance(response, inside),
        response,
        longest,
    )
    outliers = [outliers_text(left_out)] if left_out else []
    faults = [one.sentence for one in channel_faults(stretches)]
    found.doubts = [*warnings, *outliers, *faults, *_doubts(found)]
    return found


def _channel(name: str, rows: Sequence[Array], noise: float) -> ChannelQuality:
    row = np.concatenate(rows)
    mean = float(row.mean())
    rail = at_rail(row - mean)
    clipped = 0.0 if rail is None else float(np.count_nonzero(rail)) / row.size
    return ChannelQuality(name, mean, float(np.std(row)), float(np.abs(row - mean).max()), noise, clipped)


def _response(record: Record) -> Response:
    piece = int(min(record.body.size, max(64, round(PIECE * record.sample_rate))))
    both = cross_spectrum(record.body, record.spool, record.sample_rate, piece)
    several = record.body.size >= 2 * piece
    coherence = both.coherence if several else np.zeros_like(both.body)
    return Response(both.frequency, both.body, both.spool, both.amplification, coherence)


def _resonance(response: Response, inside: NDArray[np.bool_]) -> tuple[float, float]:
    """Return frequency and amplification of the highest coherent peak that is not at the band's edge."""
    usable = inside & (response.coherence > COHERENT)
    if np.count_nonzero(usable) < 3:
        return math.nan, math.nan
    peaks = signal.find_peaks(np.where(usable, response.amplification, 0.0))[0]
    peaks = [at for at in peaks if usable[max(at - 1, 0) : at + 2].all()]
    if not peaks:
        return math.nan, math.nan
    best = max(peaks, key=lambda at: response.amplification[at])
    size = float(response.amplification[best])
    return (float(response.frequency[best]), size) if size > 1.1 else (math.nan, math.nan)


def _doubts(found: RecordQuality) -> list[str]:
    said = []
    for one in found.channels:
        if one.rms == 0.0:
            said.append(f"{one.name}: all samples are alike: is the sensor connected?")
            continue
        if one.clipped > 0.0:
            grave = "more than a fit can do without" if one.clipped > CLIPPED else "left out by fits"
            said.append(f"{one.name}: {100.0 * one.clipped:.2g} % of the samples are clipped, {grave}")
        if one.rms < QUIET * one.noise:
            said.append(
                f"{one.name}: its noise of {'at most ' if one.at_most else ''}{one.noise:.2g} m/s^2 (rms) "
                f"drowns the motion of "
                f"{one.rms:.2g} m/s^2: "
                "shake harder, or use a finer sensor"
            )
    if found.duration < SHORT:
        said.append(f"{found.duration:.1f} s are short: friction needs {SHORT:g} s and more")
    if found.rate < RATE_OVER_BAND * found.band[1]:
        said.append(
            f"{found.rate:g} Hz are few for an excitation up to {found.band[1]:.0f} Hz: sample at "
            f"{RATE_OVER_BAND * found.band[1]:.0f} Hz or more"
        )
    if found.coherence < COHERENT and all(one.rms > 0.0 for one in found.channels):
        said.append(
            f"coherence of body and spool is {found.coherence:.2f} in the excitation's band: "
            "sticking, noise, another "
            "axis, or two records that do not belong together"
        )
    elif not math.isfinite(found.resonance[0]):
        said.append(
            "no resonance is seen: the natural frequency may lie outside the band, or friction damps it"
        )
    return said

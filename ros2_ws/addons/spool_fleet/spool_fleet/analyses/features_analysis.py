"""Features of the two signals: sizes, shapes, resonance; they need no model of the valve."""

from __future__ import annotations

import math

import numpy as np
from spool_core.errors import InputError
from spool_estimator.identification.spectra import cross_spectrum, noise_of
from spool_estimator.record_judgement import Analysis as Work
from spool_estimator.record_judgement import resonance_of, shortness
from spool_report.records.record_loading import load_recording
from spool_report.requests import Selection

from spool_fleet.analyses import Analysis, Rows, Subject, parameter

#: Samples that are read of a record at most.
LONGEST = 1_200_000
#: s of a segment of Welch's method: 0.5 Hz between two lines.
SEGMENT = 2.0


def run(subject: Subject) -> Rows:
    """Return rms, crest factor and kurtosis of both channels, and the resonance of their transmissibility.

    Raises:
        InputError: the record has no second of samples without a gap.
    """
    selection = Selection(subject.namespace, longest=LONGEST, described=False)
    recording = load_recording(subject.path, selection)
    longest = max(recording.stretches, key=lambda stretch: stretch.duration)
    short = shortness(Work.ESTIMATE, [longest.duration])
    if short:
        raise InputError(short)
    found = []
    for channel in ("body", "spool"):
        row = np.concatenate([getattr(stretch, channel) for stretch in recording.stretches])
        around = row - row.mean()
        power = float(np.mean(around**2))
        rms = power**0.5
        crest = float(np.abs(around).max()) / rms if rms > 0.0 else float("nan")
        kurtosis = float(np.mean(around**4)) / power**2 if power > 0.0 else float("nan")
        shape = (("rms", rms, "m/s^2"), ("crest_factor", crest, "1"), ("kurtosis", kurtosis, "1"))
        found += [(f"{channel}_{name}", value, unit) for name, value, unit in shape]
    length = min(longest.body.size, round(SEGMENT * longest.sample_rate))
    both = cross_spectrum(longest.body, longest.spool, longest.sample_rate, length)
    noise = noise_of(longest.body, longest.spool, longest.sample_rate)
    frequency, height = resonance_of(both, noise)
    # A single segment is coherent throughout.
    if longest.body.size >= 2 * length and math.isfinite(frequency):
        found += [
            ("transmissibility_peak_frequency", frequency, "Hz"),
            ("transmissibility_peak", height, "1"),
        ]
    rows = [parameter("features", "", name, {"value": value, "unit": unit}) for name, value, unit in found]
    return {"parameters": rows}


ANALYSIS = Analysis("features", run, "sizes and shapes of both signals, resonance")

"""Stuck spool: one that moves with its body, of whose spring and friction a record says nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import signal
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import noise_of
from spool_sim.valve import Valve

from spool_gap.result import GapResult

from .units import expected_transfer

#: Relative motion over that of the described valve, rms, below which a spool is stuck: 26 dB less; a spring
#: or a drag twenty times as strong as described would be needed to move so little.
STUCK = 0.05
#: Share of the body's rms that noise is given in a record whose channels read the same numbers: so little
#: moves no number of the fit.
DITHER = 1e-4
#: Confidence of that verdict: that of others which one clear fact decides.
CONFIDENCE = 0.99


def is_stuck(records: Sequence[Record], valve: Valve) -> bool:
    """Whether the spool of ``valve`` moves with its body throughout ``records``."""
    return all(_is_stuck(record, valve) for record in records)


def _is_stuck(record: Record, valve: Valve) -> bool:
    rate = record.sample_rate
    noise = noise_of(record.body, record.spool, rate)
    piece = int(min(record.body.size, max(256, 2 ** round(np.log2(rate)))))
    frequency, body = signal.welch(record.body, rate, "hann", piece)
    moved = signal.welch(record.spool - record.body, rate, "hann", piece)[1]
    driven = (frequency >= noise.low) & (frequency <= noise.high) & (frequency > 0.0)
    if not driven.any():
        return False
    expected = np.abs(expected_transfer(frequency[driven], valve) - 1.0) ** 2 * body[driven]
    shown = np.maximum(moved[driven] - noise.body - noise.spool, 0.0)
    return float(shown.sum()) < STUCK**2 * float(expected.sum())


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
        candidates=(),
        nuisances=(),
        remainder=None,
        sentence=(
            "The spool is stuck: it moves with its body, so this record says nothing of its spring and its "
            "friction. Check for silting, dirt, a bent spool or a deformed bore, a solenoid that holds it; "
            "or whether both sensors sit on the body."
        ),
        advice="a stronger excitation near the natural frequency, or moving the spool by its solenoid",
    )

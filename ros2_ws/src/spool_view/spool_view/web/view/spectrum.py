"""Spectrum of the last seconds of both channels, for the page of one valve."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: s of samples that are looked at; lines lie 0.5 Hz apart.
WINDOW = 2.0
#: Hz, above which no line is shown, and lines that are sent at most.
HIGHEST, MOST_LINES = 200.0, 400
#: Samples of a block, and per second, that are taken at most.
MOST_SAMPLES = 100_000


def spectrum_of(blocks: Sequence[Any]) -> dict[str, Any] | None:
    """Return peak accelerations (m/s^2) by line of the newest samples of ``blocks``.

    Args:
        blocks: messages ``AccelerationBlock``, oldest first.

    Returns:
        Distance of the lines (Hz), ``body`` and ``spool``; ``None`` while there are too few samples.
    """
    if not blocks:
        return None
    period = blocks[-1].sample_period
    if not (np.isfinite(period) and WINDOW / MOST_SAMPLES < period < WINDOW / 16):
        return None
    body, spool = _newest(blocks, period)
    size = body.size
    if size < 16 or size * period < 0.5 * WINDOW:
        return None
    taper = np.hanning(size)
    scale = 2.0 / taper.sum()
    step = 1.0 / (size * period)
    count = int(min(size // 2, MOST_LINES, HIGHEST / step))
    found: dict[str, Any] = {"step": round(step, 6)}
    for name, samples in (("body", body), ("spool", spool)):
        lines = np.abs(np.fft.rfft((samples - samples.mean()) * taper))[:count] * scale
        found[name] = [float(f"{value:.2e}") for value in lines.tolist()]
    return found


def _newest(blocks: Sequence[Any], period: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the newest samples without a gap, at most ``WINDOW`` s of them; none where any is no number."""
    wanted, count, taken = round(WINDOW / period), 0, []
    following: int | None = None
    for block in reversed(blocks):
        size = len(block.body)
        fits = following is None or block.sequence == following - 1
        if not fits or size != len(block.spool) or block.sample_period != period:
            break
        taken.append(block)
        following, count = block.sequence, count + size
        if count >= wanted:
            break
    parts = [
        np.concatenate([np.frombuffer(getattr(one, name), np.float32) for one in reversed(taken)])
        for name in ("body", "spool")
    ]
    body, spool = (part[-wanted:].astype(np.float64) for part in parts)
    whole = bool(np.isfinite(body).all() and np.isfinite(spool).all())
    return (body, spool) if whole else (np.zeros(0), np.zeros(0))

"""Location of the gap: shares of the residual force by frequency, displacement, velocity, time, phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_core.uncertainty import number

from spool_gap.result import Share, Surface, Where

Array = NDArray[np.float64]

#: Cells of the restoring-force surface.
CELLS = 24


@dataclass(frozen=True, slots=True)
class Residual:
    """What the model lacks along a motion; every array has shape (n,).

    Attributes:
        time: s.
        displacement, velocity: m, m/s.
        force: the missing force, N.
        floor: rms of what noise makes of it, N.
        period: s between samples; windows follow one another.
    """

    time: Array
    displacement: Array
    velocity: Array
    force: Array
    floor: float
    period: float


def locate(residual: Residual) -> Where:
    """Return the shares of the residual force's energy."""
    z, v, force = residual.displacement, residual.velocity, residual.force
    z_size = float(np.quantile(np.abs(z), 0.98)) or 1e-9
    v_size = float(np.quantile(np.abs(v), 0.98)) or 1e-9
    z_top, v_top = float(np.abs(z).max()) or 1e-9, float(np.abs(v).max()) or 1e-9
    steps = np.array([0.0, 0.1, 0.25, 0.5, 0.75, 1.0])
    displacement = _shares(np.abs(z), force, _edges(steps * z_size, z_top), "m", residual.floor)
    velocity = _shares(np.abs(v), force, _edges(steps * v_size, v_top), "m/s", residual.floor)
    direction = _shares(np.sign(v), force, [-1.5, 0.0, 1.5], "1", residual.floor)
    low, high = float(residual.time.min()), float(residual.time.max()) + residual.period
    time = _shares(residual.time, force, np.linspace(low, high, 9).tolist(), "s", residual.floor)
    angle = np.arctan2(-v / v_size, z / z_size)
    phase = _shares(angle, force, np.linspace(-np.pi, np.pi, 9).tolist(), "rad", residual.floor)
    frequency = _by_frequency(residual)
    rows = {"frequency": frequency, "displacement": displacement, "velocity": velocity, "time": time}
    return Where(frequency, displacement, velocity, direction, time, phase, _sentence(rows))


def _edges(values: Array, top: float) -> list[float]:
    return [*values[:-1].tolist(), max(top, float(values[-1])) * 1.0001]


def _shares(over: Array, force: Array, edges: Sequence[float], unit: str, floor: float) -> tuple[Share, ...]:
    power = np.square(force)
    total = float(power.sum()) or 1.0
    place = np.clip(np.digitize(over, edges) - 1, 0, len(edges) - 2)
    sums = np.bincount(place, power, minlength=len(edges) - 1)
    counts = np.bincount(place, minlength=len(edges) - 1)
    return tuple(
        Share(float(low), float(high), unit, float(part / total), min(1.0, float(count * floor**2 / total)))
        for low, high, part, count in zip(edges[:-1], edges[1:], sums, counts, strict=True)
    )


def _by_frequency(residual: Residual) -> tuple[Share, ...]:
    force = residual.force - residual.force.mean()
    lines = np.abs(np.fft.rfft(force * np.hanning(force.size))) ** 2
    frequency = np.fft.rfftfreq(force.size, residual.period)
    top = float(frequency[-1])
    edges = [0.0, *[edge for edge in (5.0, 10.0, 20.0, 35.0, 60.0, 100.0, 200.0, 400.0) if edge < top], top]
    total = float(lines.sum()) or 1.0
    place = np.clip(np.digitize(frequency, edges) - 1, 0, len(edges) - 2)
    sums = np.bincount(place, lines, minlength=len(edges) - 1)
    mean = float(np.mean(np.square(residual.force))) or 1.0
    return tuple(
        Share(low, high, "Hz", float(part / total), min(1.0, residual.floor**2 / mean * (high - low) / top))
        for low, high, part in zip(edges[:-1], edges[1:], sums, strict=True)
    )


def _sentence(rows: dict[str, tuple[Share, ...]]) -> str:
    """Return what stands out most: the narrowest part with more than half of the gap."""
    best: tuple[float, str] | None = None
    for name, shares in rows.items():
        width = sum(share.high - share.low for share in shares)
        for share in shares:
            part = (share.high - share.low) / width
            if share.share > 0.45 and share.share > 2.5 * part:
                size, unit = (1e3, "mm") if share.unit == "m" else (1.0, share.unit)
                low, high = number(size * share.low, 3), number(size * share.high, 3)
                text = f"{100.0 * share.share:.0f} % of it at a {name} of {low} to {high} {unit}"
                if best is None or share.share / part > best[0]:
                    best = (share.share / part, text)
    return best[1] if best else "it is spread over frequency, displacement, velocity and time"


def surface(residual: Residual, cells: int = CELLS) -> Surface:
    """Return the mean missing force over displacement and velocity."""
    z, v = residual.displacement, residual.velocity
    z_size = float(np.quantile(np.abs(z), 0.999)) or 1e-9
    v_size = float(np.quantile(np.abs(v), 0.999)) or 1e-9
    z_edges, v_edges = np.linspace(-z_size, z_size, cells + 1), np.linspace(-v_size, v_size, cells + 1)
    count, _, _ = np.histogram2d(z, v, [z_edges, v_edges])
    total, _, _ = np.histogram2d(z, v, [z_edges, v_edges], weights=residual.force)
    mean = np.where(count >= 3, total / np.maximum(count, 1.0), np.nan)
    return Surface(np.asarray(z_edges), np.asarray(v_edges), mean, count)

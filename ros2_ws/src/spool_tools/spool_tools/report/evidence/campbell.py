"""Campbell diagram: the spool's spectrum over time with the natural frequency and the machine's line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from spool_core.uncertainty import number

from spool_tools.report.drawing.palette import AFTER, BEFORE, DASHED, WIDTH, plain
from spool_tools.report.estimates.spectrogram import Spectrogram

from .exhibit import Exhibit

Array = NDArray[np.float64]

TITLE = "Spectrum over time (Campbell)"
CAPTION = (
    "Darker: more power at that frequency and time (each step of the scale is a tenfold of power); dots: the "
    "strongest line of the excitation; lines: the natural frequency. Good: where the dots cross the natural "
    "frequency the spool answers darkly, and the natural frequency stays level. Bad: a dark line that is "
    "neither on the dots nor a multiple (another machine, mains hum), a natural frequency that wanders "
    "(spring, or dry friction that holds the spool), dark columns over all frequencies (hits, spikes)."
)
#: Decades of power shown below the largest.
DECADES = 6.0
#: Relative distance at which the machine's line counts as at the natural frequency.
NEAR = 0.1


@dataclass(frozen=True, slots=True)
class Frequency:
    """Natural frequency over time: ``value`` (Hz) at ``time`` (s), and half width of its 95 % interval."""

    time: Array
    value: Array
    half_width: Array


def constant(frequency: float, shown: Spectrogram) -> Frequency:
    """Return a natural frequency that does not change, Hz."""
    time = shown.time[[0, -1]]
    return Frequency(time, np.full(2, frequency), np.zeros(2))


def campbell(shown: Spectrogram, natural: Mapping[str, Frequency], unit: str = "(m/s²)²/Hz") -> Exhibit:
    """Return the picture of ``shown`` with the natural frequencies by name, at most two."""
    power = np.log10(np.maximum(shown.density, 1e-30))
    top = float(power.max())
    figure, axis = plt.subplots(figsize=(WIDTH, 4.4), layout="constrained")
    # Gaps of a record stay white: each piece of the picture ends where its columns do.
    columns = np.flatnonzero(np.diff(shown.time) > 3.0 * shown.length + 3.0 * np.median(np.diff(shown.time)))
    edges = [0, *(columns + 1).tolist(), shown.time.size]
    half = 0.5 * float(np.median(np.diff(shown.time)))
    image = None
    for first, stop in pairwise(edges):
        extent = (
            float(shown.time[first]) - half, float(shown.time[stop - 1]) + half,
            float(shown.frequency[0]), float(shown.frequency[-1]),
        )  # fmt: skip
        image = axis.imshow(
            power[:, first:stop], origin="lower", aspect="auto", extent=extent, cmap="Greys",
            vmin=top - DECADES, vmax=top, interpolation="none",
        )  # fmt: skip
    axis.plot(
        shown.time,
        shown.line,
        ls="",
        marker=".",
        ms=2.5,
        color="#009E73",
        label="strongest line of the excitation",
    )
    looks = ((BEFORE, DASHED), (AFTER, "-"))[-max(1, len(natural)) :]
    for (name, one), (colour, dash) in zip(natural.items(), looks, strict=False):
        axis.plot(one.time, one.value, color=colour, ls=dash, lw=1.6, label=f"natural frequency, {name}")
        if np.any(one.half_width > 0.0):
            axis.fill_between(
                one.time,
                one.value - one.half_width,
                one.value + one.half_width,
                color=colour,
                alpha=0.3,
                lw=0,
            )
    axis.set_xlim(float(shown.time[0]) - half, float(shown.time[-1]) + half)
    axis.set_ylim(float(shown.frequency[0]), float(shown.frequency[-1]))
    plain(axis, "time since the start of the record, s", "frequency, Hz")
    if image is not None:
        figure.colorbar(image, ax=axis, label=f"log10 of the power density, {unit}", shrink=0.9)
    handles, names = axis.get_legend_handles_labels()
    figure.legend(handles, names, fontsize=8, loc="outside lower center", ncols=3)
    return Exhibit(TITLE, figure, CAPTION, _seen(shown, natural))


def _seen(shown: Spectrogram, natural: Mapping[str, Frequency]) -> str:
    parts = [
        f"Strongest line of the excitation from {number(float(shown.line.min()), 3)} to "
        f"{number(float(shown.line.max()), 3)} Hz over {number(float(shown.time[-1] - shown.time[0]), 3)} s"
    ]
    for name, one in natural.items():
        known = one.value[np.isfinite(one.value)]
        if not known.size:
            parts.append(f"the natural frequency ({name}) is not known")
            continue
        low, high = float(known.min()), float(known.max())
        span = (
            f"{number(low, 3)} Hz"
            if high - low < 5e-3 * high
            else f"{number(low, 3)} to {number(high, 3)} Hz"
        )
        middle = float(np.median(known))
        share = float(np.mean(np.abs(shown.line / middle - 1.0) < NEAR))
        parts.append(
            f"natural frequency ({name}) {span}; the excitation's strongest line is within "
            f"{100.0 * NEAR:.0f} % of it during {100.0 * share:.0f} % of the time"
        )
    return f"{'; '.join(parts)}."

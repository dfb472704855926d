"""What the record could have told: power, coherence and information by frequency band."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from spool_core.uncertainty import Z_95, percent

from spool_tools.report.drawing.palette import AFTER, BEFORE, DARK, MEASURED, WIDTH, plain
from spool_tools.report.estimates.bands import Band

from .exhibit import Exhibit

TITLE = "What the record could have told"
CAPTION = (
    "By frequency band: how much the drive moves, how much of the answer follows from it (coherence), and "
    "where the knowledge about spring and drag comes from: shares of the Fisher information of a linear "
    "model, given this drive and what is incoherent. Good: power and coherence on both sides of the natural "
    "frequency, and information in more than one band. Bad: all information in one band (one speed of the "
    "machine: spring, mass and drag are hardly told apart), or none where the question is."
)
TITLE_FORCE = "What the record excites"
CAPTION_FORCE = (
    "By frequency band: how much the displacement moves, and how much of the force follows linearly from it "
    "(coherence). Good: several bands with motion, coherence near 1. Low coherence with much motion: a force "
    "that is not linear, as dry friction is, or one that does not follow from the motion."
)


def information_bands(bands: Sequence[Band], what: str = "body acceleration, m/s² rms") -> Exhibit:
    """Return the picture of ``bands``; ``what`` the drive is, with its unit."""
    informed = all(np.isfinite(band.stiffness) and np.isfinite(band.damping) for band in bands)
    rows = 3 if informed else 2
    figure, axes = plt.subplots(rows, 1, figsize=(WIDTH, 1.9 * rows + 0.6), layout="constrained", sharex=True)
    places = np.arange(len(bands))
    axes[0].bar(places, [band.drive for band in bands], 0.6, color=MEASURED)
    axes[1].bar(
        places, [0.0 if np.isnan(band.coherence) else band.coherence for band in bands], 0.6, color=MEASURED
    )
    axes[1].set_ylim(0.0, 1.05)
    plain(axes[0], "", what)
    plain(axes[1], "", "coherence, 1")
    if informed:
        spring, drag = (_shares([getattr(band, name) for band in bands]) for name in ("stiffness", "damping"))
        axes[2].bar(places - 0.2, spring, 0.38, color=AFTER, label="of the spring")
        axes[2].bar(
            places + 0.2, drag, 0.38, color=BEFORE, hatch="//", edgecolor=DARK, lw=0.3, label="of the drag"
        )
        axes[2].legend(fontsize=8, frameon=False)
        plain(axes[2], "", "information, %")
    axes[-1].set_xticks(places, [f"{band.low:g}–{band.high:g}" for band in bands], fontsize=8)
    axes[-1].set_xlabel("frequency, Hz", fontsize=9)
    seen = _seen(bands, informed=informed)
    return (
        Exhibit(TITLE, figure, CAPTION, seen)
        if informed
        else Exhibit(TITLE_FORCE, figure, CAPTION_FORCE, seen)
    )


def _shares(values: list[float]) -> list[float]:
    total = sum(values)
    return [100.0 * value / total if total > 0.0 else 0.0 for value in values]


def _seen(bands: Sequence[Band], *, informed: bool) -> str:
    loudest = max(bands, key=lambda band: band.drive)
    parts = [f"The drive moves most from {_hertz(loudest)}"]
    weak = [band for band in bands if band.coherence < 0.8]
    if weak:
        parts.append(f"the coherence is below 0.8 from {' and from '.join(map(_hertz, weak))}")
    if not informed:
        return f"{'; '.join(parts)}."
    for name, said in (("stiffness", "the spring"), ("damping", "the drag")):
        values = [getattr(band, name) for band in bands]
        best = int(np.argmax(values))
        total = sum(values)
        if not total > Z_95**2:  # not even to 100 %
            parts.append(f"it says nothing about {said}")
            continue
        parts.append(
            f"{_shares(values)[best]:.0f} % of what it says about {said} comes from {_hertz(bands[best])}; "
            f"all of it tells {said} to {percent(Z_95 / float(np.sqrt(total)))} on either side (95 %) or "
            "better, "
            "were the spool's law linear"
        )
    return f"{'; '.join(parts)}."


def _hertz(band: Band) -> str:
    return f"{band.low:g} to {band.high:g} Hz"

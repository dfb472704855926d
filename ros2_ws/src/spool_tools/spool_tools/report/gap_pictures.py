"""Pictures of a gap analysis: where the gap sits, its surface, the ranking, waveforms and spectra."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from spool_gap.profile_likelihood import RISE_95, ProfileLikelihood
from spool_gap.result import Curves, GapResult, RankedHypothesis, Share, Surface, Where

from .drawing.palette import AFTER, BEFORE, FLOOR, MEASURED, WIDTH
from .drawing.palette import plain as _plain

#: Hypotheses shown at most.
SHOWN = 12
UNIT = {"m": (1e3, "mm"), "rad": (180.0 / np.pi, "°")}


def where_figure(before: Where, after: Where, share_left: float) -> Figure:
    """Return the shares of the gap, before and after, over what the motion was there.

    ``share_left``: energy of the gap after over that before.
    """
    rows = (
        ("frequency", before.frequency, after.frequency),
        ("displacement, size", before.displacement, after.displacement),
        ("velocity, size", before.velocity, after.velocity),
        ("time", before.time, after.time),
        ("phase (0: outermost)", before.phase, after.phase),
        ("direction", before.direction, after.direction),
    )
    figure: Figure
    figure, axes = plt.subplots(2, 3, figsize=(WIDTH, 5.2), layout="constrained")
    for axis, (name, first, last) in zip(axes.ravel(), rows, strict=True):
        places = np.arange(len(first))
        axis.bar(places - 0.2, [100.0 * s.share for s in first], 0.4, color=BEFORE, label="before")
        axis.bar(places + 0.2, [100.0 * share_left * s.share for s in last], 0.4, color=AFTER, label="after")
        axis.plot(
            places, [100.0 * s.floor for s in first], ls="", marker="_", ms=14, mew=1.6, color=FLOOR,
            label="noise alone",
        )  # fmt: skip
        axis.set_xticks(places, _labels(first), rotation=40, ha="right", fontsize=7)
        axis.set_title(name + _unit(first), fontsize=9)
        axis.tick_params(axis="y", labelsize=7)
        _plain(axis)
    axes[0, 0].set_ylabel("share of the gap's energy, %", fontsize=8)
    axes[1, 0].set_ylabel("share of the gap's energy, %", fontsize=8)
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, fontsize=8, loc="outside lower center", ncols=3)
    return figure


def _unit(shares: Sequence[Share]) -> str:
    unit = shares[0].unit if shares else "1"
    return "" if unit == "1" else f", {UNIT.get(unit, (1.0, unit))[1]}"


def _labels(shares: Sequence[Share]) -> list[str]:
    if shares and shares[0].unit == "1":
        return ["backward", "forward"]
    factor = UNIT.get(shares[0].unit, (1.0, ""))[0] if shares else 1.0
    return [f"{factor * s.low:.3g}–{factor * s.high:.3g}" for s in shares]


def surface_figure(before: Surface, after: Surface) -> Figure:
    """Return the restoring-force surface of the gap, before and after, in one scale."""
    known = np.abs(before.force[np.isfinite(before.force)])
    top = float(np.quantile(known, 0.99)) if known.size else 1.0
    figure: Figure
    figure, axes = plt.subplots(1, 2, figsize=(WIDTH, 4.0), layout="constrained", sharey=True)
    mesh = None
    for axis, surface, title in zip(axes, (before, after), ("before", "after"), strict=True):
        axis.set_facecolor("#eeeeee")
        mesh = axis.pcolormesh(
            1e3 * surface.displacement, surface.velocity, surface.force.T, cmap="RdBu_r",
            vmin=-top or None, vmax=top or None, rasterized=True,
        )  # fmt: skip
        axis.axhline(0.0, color=MEASURED, lw=0.6)
        axis.axvline(0.0, color=MEASURED, lw=0.6)
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("displacement, mm", fontsize=9)
    axes[0].set_ylabel("velocity, m/s", fontsize=9)
    if mesh is not None:
        figure.colorbar(mesh, ax=axes, label="force that the model lacks, N", shrink=0.9)
    return figure


def profile_figure(profiles: Sequence[ProfileLikelihood]) -> Figure:
    """Return the profile likelihood of each number, with the threshold of its 95 % interval."""
    columns = min(3, len(profiles))
    rows = -(-len(profiles) // columns)
    figure: Figure
    size = (WIDTH, 0.6 + 2.2 * rows)
    figure, axes = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    for axis, profile in zip(axes.ravel(), profiles, strict=False):
        axis.plot(profile.values, profile.rises, marker="o", ms=3, color=AFTER)
        axis.axhline(RISE_95, color=FLOOR, lw=1.2, ls=(0, (4, 2)))
        axis.axvline(profile.best, color=BEFORE, lw=1.0)
        axis.set_ylim(-0.3, 3.0 * RISE_95)
        axis.set_title(profile.verdict, fontsize=8)
        unit = "" if profile.unit == "1" else f", {profile.unit}"
        axis.set_xlabel(f"{profile.name.replace('_', ' ')}{unit}", fontsize=8)
        axis.tick_params(labelsize=7)
        _plain(axis)
    for axis in axes.ravel()[len(profiles) :]:
        axis.set_visible(False)
    for axis in axes[:, 0]:
        axis.set_ylabel("2 x fall of log likelihood", fontsize=8)
    return figure


def ranking_figure(result: GapResult) -> Figure:
    """Return the error that each hypothesis leaves, by what it was tried jointly with."""
    rows = [row for row in result.ranking if np.isfinite(row.nrmse_after)][:SHOWN][::-1]
    top = 1.3 * max(result.before.nrmse, 1e-6)
    figure: Figure
    figure, axis = plt.subplots(figsize=(WIDTH, 1.4 + 0.3 * len(rows)), layout="constrained")
    for place, row in enumerate(rows):
        length = min(row.nrmse_after, top)
        axis.barh(place, 100.0 * length, 0.62, color=AFTER if row.accepted else "#bbbbbb")
        text = f"{100.0 * row.nrmse_after:.2g} %" + ("  accepted" if row.accepted else "")
        axis.text(100.0 * length, place, f" {text}", va="center", fontsize=7.5)
    axis.set_yticks(range(len(rows)), [_hypothesis(row) for row in rows], fontsize=8)
    axis.axvline(100.0 * result.before.nrmse, color=BEFORE, lw=1.4, label="base model")
    axis.axvline(100.0 * result.noise_floor, color=FLOOR, lw=1.2, ls=(0, (4, 2)), label="noise alone")
    axis.set_xlim(0.0, 115.0 * top)
    axis.set_xlabel("error on held-out data, % of the measured rms", fontsize=9)
    axis.legend(fontsize=8, loc="lower right")
    _plain(axis)
    return figure


def _hypothesis(row: RankedHypothesis) -> str:
    joint = (
        f"  (jointly with {', '.join(_said(name) for name in row.jointly_with)})" if row.jointly_with else ""
    )
    return _said(row.id) + joint


def waveform_figure(curves: Curves) -> Figure:
    """Return measured and simulated signal before and after, and what is left over."""
    what, unit = ("force", "N") if curves.unit == "N" else ("spool acceleration", "m/s²")
    time = curves.time - curves.time[0]
    figure: Figure
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(WIDTH, 5.4), layout="constrained", sharex=True, height_ratios=(3, 2)
    )
    upper.plot(time, curves.measured, color=MEASURED, lw=3.2, alpha=0.7, label="measured")
    for row, colour, dash, name in (
        (curves.before, BEFORE, (0, (5, 2)), "before"), (curves.after, AFTER, "-", "after"),
    ):  # fmt: skip
        upper.plot(time, row, color=colour, ls=dash, lw=1.1, label=name)
        lower.plot(time, row - curves.measured, color=colour, ls=dash, lw=0.9)
    upper.set_ylabel(f"{what}, {unit}", fontsize=9)
    lower.set_ylabel(f"model − measured, {unit}", fontsize=9)
    lower.set_xlabel(f"time from {curves.time[0]:.2f} s, s", fontsize=9)
    upper.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)
    for axis in (upper, lower):
        _plain(axis)
        axis.margins(x=0.0)
    return figure


def spectrum_figure(curves: Curves) -> Figure:
    """Return the spectra of the measured signal, what is left before and after, and the noise floor."""
    figure: Figure
    figure, axis = plt.subplots(figsize=(WIDTH, 3.8), layout="constrained")
    inside = curves.frequency > 0.0
    for row, colour, dash, width, name in (
        (curves.measured_density, MEASURED, "-", 2.6, "measured"),
        (curves.before_density, BEFORE, (0, (5, 2)), 1.3, "left before"),
        (curves.after_density, AFTER, "-", 1.3, "left after"),
        (curves.floor_density, FLOOR, (0, (1.5, 1.2)), 1.2, "noise alone"),
    ):
        axis.plot(
            curves.frequency[inside], np.sqrt(np.maximum(row[inside], 1e-30)), color=colour, ls=dash,
            lw=width, label=name,
        )  # fmt: skip
    axis.set_xscale("log")
    axis.set_yscale("log")
    low = np.sqrt(max(float(np.median(curves.floor_density[inside])), 1e-30))
    axis.set_ylim(bottom=0.1 * low)
    axis.margins(x=0.0)
    unit = "N" if curves.unit == "N" else "m/s²"
    axis.set_xlabel("frequency, Hz", fontsize=9)
    axis.set_ylabel(f"amplitude density, {unit}/√Hz", fontsize=9)
    axis.legend(fontsize=8, ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False)
    _plain(axis)
    return figure


def _said(name: str) -> str:
    return name.replace("_", " ")

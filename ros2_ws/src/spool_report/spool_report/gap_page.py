"""Page of a gap analysis: the verdict in a sentence, and pictures that show why."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from spool_core.uncertainty import LEGEND
from spool_estimator.identification.determination import RISE_95, ProfileLikelihood, sentences
from spool_gap import report
from spool_gap.catalogue import EFFECTS
from spool_gap.result import Curves, GapResult, Surface, Where

from spool_report import page as html
from spool_report.evidence.exhibit import AFTER, BEFORE, FLOOR, MEASURED, Exhibit, LeftOut, plain, subplots
from spool_report.terminal import Table, captions, spoken

_CAPTIONS = captions("gap")

UNIT = {"m": (1e3, "mm"), "rad": (180.0 / np.pi, "°")}


def gap_page(
    result: GapResult, sources: Sequence[tuple[str, str]] = (), evidence: Sequence[Exhibit | LeftOut] = ()
) -> str:
    """Return the page of ``result``.

    Args:
        result: of the analysis.
        sources: label and value of what it was made from.
        evidence: pictures that let an expert check it.
    """
    title = {
        "none": f"{result.record}: nothing is missing",
        "unexplained": f"{result.record}: something is missing that has no name here",
    }.get(result.verdict, f"{result.record}: {spoken(result.verdict).replace('+', ' and ')}")
    before, after = result.before, result.after
    what = "spool acceleration" if result.kind == "accelerations" else "force"
    errors = (before.nrmse, after.nrmse, result.known_floor)
    shown = [100.0 * error if math.isfinite(error) else "not known" for error in errors]
    rows = [(f"held-out error, % of the rms of the {what}", *shown)]
    if math.isfinite(before.amplitude_ratio):
        ratios = (before.amplitude_ratio, after.amplitude_ratio, 1.0)
        rows.append(("amplitude, model over measured", *ratios))
    first, last, noise = (f"{100.0 * error:.2g} %" for error in errors)
    alone = f", noise alone {noise}" if math.isfinite(result.known_floor) else ""
    seen = f"Held-out error {first} before, {last} after{alone}."
    sections = [
        html.answers(report.lead(result)),
        html.drawing(waveform_figure(result.curves), _CAPTIONS["waveform"], seen),
        *([html.listing([f"Warning: {line}" for line in result.warnings])] if result.warnings else []),
        html.table(Table(("", "before", "after", "noise alone"), rows)),
        *([html.listing(known)] if (known := sentences(result.determinations)) else []),
        *([html.paragraph(report.anomaly_sentence(anomaly))] if (anomaly := result.linear_anomaly) else []),
        *_what_was_found(result),
        html.section("Where the gap sits", _where_it_sits(result)),
        *_hypotheses(result),
        *(
            [html.section("Evidence", [html.paragraph(_CAPTIONS["evidence"]), *html.evidence(evidence)])]
            if evidence
            else []
        ),
        html.section("Spectrum and numbers", _numbers(result, seen, bool(alone))),
    ]
    return html.page(title, sections, sources)


def _what_was_found(result: GapResult) -> list[Markup]:
    """Return the effects that are missing, what bounds their numbers, and what else was noticed."""
    sections = [
        html.table(Table(*report.effects(result), title="What is missing")),
        html.table(Table(*report.explanations(result), title="Explanations not distinguished")),
    ]
    if result.profiles:
        profiles = [f"{profile.sentence}." for profile in result.profiles]
        sections += [
            html.heading("Parameters that the record determines"),
            html.drawing(profile_figure(result.profiles), _CAPTIONS["profiles"], " ".join(profiles)),
            html.listing(profiles),
        ]
    sections.append(html.table(Table(*report.nuisances(result), title="Measuring-chain effects")))
    if result.candidates:
        known = {name: EFFECTS[name] for name in result.candidates if name in EFFECTS}
        checks = {name: f": {one.on_the_machine}; check {one.to_check}" for name, one in known.items()}
        candidates = [f"{spoken(name)}{checks.get(name, '')}" for name in result.candidates]
        sections += [html.heading("Closest candidates"), html.listing(candidates)]
    return sections


def _where_it_sits(result: GapResult) -> list[Markup]:
    before, after = result.before.nrmse, result.after.nrmse
    left = (after / before) ** 2 if before > 0.0 else 1.0
    largest = [
        float(np.nanmax(np.abs(surface.force))) if np.isfinite(surface.force).any() else math.nan
        for surface in (result.surface, result.surface_after)
    ]
    return [
        html.paragraph(
            f"Gap location: {result.where.sentence}. "
            f"Location of the remainder: {result.where_after.sentence}."
        ),
        html.drawing(
            where_figure(result.where, result.where_after, left),
            _CAPTIONS["where"],
            f"Before: {result.where.sentence}. After: {result.where_after.sentence}.",
        ),
        html.drawing(
            surface_figure(result.surface, result.surface_after),
            _CAPTIONS["surface"],
            f"Largest mean force missing: {largest[0]:.2g} N before, {largest[1]:.2g} N after.",
        ),
    ]


def _hypotheses(result: GapResult) -> list[Markup]:
    """Return how the hypotheses rank, nothing where none was tried."""
    if not result.ranking:
        return []
    first = ", ".join(f"{spoken(row.id)} {100.0 * row.nrmse_after:.2g} %" for row in result.ranking[:3])
    kind = "accelerations" if result.kind == "accelerations" else "forces"
    parts = [
        html.drawing(
            ranking_figure(result), _CAPTIONS["ranking"], f"Held-out error with the first ones: {first}."
        ),
        html.table(Table(*report.hypotheses(result))),
        html.paragraph(_CAPTIONS[f"evidence of {kind}"]),
    ]
    return [html.section("Hypotheses", parts)]


def _numbers(result: GapResult, seen: str, known: bool) -> list[Markup]:
    """Return the spectrum of both models and their numbers; ``known``: whether the noise alone is."""
    noise = "noise alone" if known else "noise at most"
    return [
        html.drawing(spectrum_figure(result.curves, noise), _CAPTIONS["spectrum"], seen),
        html.table(Table(*report.parameters(result))),
        html.paragraph(
            f"{LEGEND}. Model: {', '.join(term.name for term in result.model.terms)}; {result.seconds:.0f} s "
            f"of data, {result.elapsed:.1f} s of computing."
        ),
    ]


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
    figure, axes = subplots(5.2, 2, 3)
    for axis, (name, first, last) in zip(axes.ravel(), rows, strict=True):
        places = np.arange(len(first))
        axis.bar(places - 0.2, [100.0 * s.share for s in first], 0.4, color=BEFORE, label="before")
        axis.bar(places + 0.2, [100.0 * share_left * s.share for s in last], 0.4, color=AFTER, label="after")
        axis.plot(
            places, [100.0 * s.floor for s in first], ls="", marker="_", ms=14, mew=1.6, color=FLOOR,
            label="noise alone",
        )  # fmt: skip
        unit = first[0].unit if first else ""
        factor, shown = UNIT.get(unit, (1.0, unit))
        labels = [f"{factor * s.low:.3g}–{factor * s.high:.3g}" for s in first]
        labels = ["backward", "forward"] if unit == "1" else labels
        axis.set_xticks(places, labels, rotation=40, ha="right", fontsize=7)
        axis.set_title(name + ("" if unit in ("", "1") else f", {shown}"), fontsize=9)
        axis.tick_params(axis="y", labelsize=7)
        plain(axis)
    axes[0, 0].set_ylabel("share of the gap's energy, %", fontsize=8)
    axes[1, 0].set_ylabel("share of the gap's energy, %", fontsize=8)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=3)
    return figure


def surface_figure(before: Surface, after: Surface) -> Figure:
    """Return the restoring-force surface of the gap, before and after, in one scale."""
    known = np.abs(before.force[np.isfinite(before.force)])
    top = float(np.quantile(known, 0.99)) if known.size else 1.0
    figure, axes = subplots(4.0, 1, 2, sharey=True)
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
    figure, axes = subplots(0.6 + 2.2 * rows, rows, columns, squeeze=False)
    for axis, profile in zip(axes.ravel(), profiles, strict=False):
        axis.plot(profile.values, profile.rises, marker="o", ms=3, color=AFTER)
        axis.axhline(RISE_95, color=FLOOR, lw=1.2, ls=(0, (4, 2)))
        axis.axvline(profile.best, color=BEFORE, lw=1.0)
        axis.set_ylim(-0.3, 3.0 * RISE_95)
        axis.set_title(profile.verdict, fontsize=8)
        unit = "" if profile.unit == "1" else f", {profile.unit}"
        axis.set_xlabel(f"{spoken(profile.name)}{unit}", fontsize=8)
        axis.tick_params(labelsize=7)
        plain(axis)
    for axis in axes.ravel()[len(profiles) :]:
        axis.set_visible(False)
    for axis in axes[:, 0]:
        axis.set_ylabel("2 x fall of log likelihood", fontsize=8)
    return figure


def ranking_figure(result: GapResult) -> Figure:
    """Return the error that each hypothesis leaves, by what it was tried jointly with."""
    rows = [row for row in result.ranking if np.isfinite(row.nrmse_after)][: report.RANKED][::-1]
    top = 1.3 * max(result.before.nrmse, 1e-6)
    figure, axis = subplots(1.4 + 0.3 * len(rows))
    for place, row in enumerate(rows):
        length = min(row.nrmse_after, top)
        axis.barh(place, 100.0 * length, 0.62, color=AFTER if row.accepted else "#bbbbbb")
        text = f"{100.0 * row.nrmse_after:.2g} %" + ("  accepted" if row.accepted else "")
        axis.text(100.0 * length, place, f" {text}", va="center", fontsize=7.5)
    labels = [
        spoken(row.id)
        + (f"  (jointly with {', '.join(map(spoken, row.jointly_with))})" if row.jointly_with else "")
        for row in rows
    ]
    axis.set_yticks(range(len(rows)), labels, fontsize=8)
    axis.axvline(100.0 * result.before.nrmse, color=BEFORE, lw=1.4, label="base model")
    axis.axvline(100.0 * result.known_floor, color=FLOOR, lw=1.2, ls=(0, (4, 2)), label="noise alone")
    axis.set_xlim(0.0, 115.0 * top)
    axis.legend(fontsize=8, loc="lower right")
    plain(axis, "error on held-out data, % of the measured rms")
    return figure


def waveform_figure(curves: Curves) -> Figure:
    """Return measured and simulated signal before and after, and the residual."""
    what, unit = ("force", "N") if curves.unit == "N" else ("spool acceleration", "m/s²")
    time = curves.time - curves.time[0]
    figure, (upper, lower) = subplots(5.4, 2, sharex=True, height_ratios=(3, 2))
    upper.plot(time, curves.measured, color=MEASURED, lw=3.2, alpha=0.7, label="measured")
    for row, colour, dash, name in (
        (curves.before, BEFORE, (0, (5, 2)), "before"), (curves.after, AFTER, "-", "after"),
    ):  # fmt: skip
        upper.plot(time, row, color=colour, ls=dash, lw=1.1, label=name)
        lower.plot(time, row - curves.measured, color=colour, ls=dash, lw=0.9)
    plain(upper, "", f"{what}, {unit}")
    plain(lower, f"time from {curves.time[0]:.2f} s, s", f"model − measured, {unit}")
    upper.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)
    for axis in (upper, lower):
        axis.margins(x=0.0)
    return figure


def spectrum_figure(curves: Curves, noise: str = "noise alone") -> Figure:
    """Return the spectra of the measured signal, of the residual before and after, and of the noise floor."""
    figure, axis = subplots(3.8)
    inside = curves.frequency > 0.0
    for row, colour, dash, width, name in (
        (curves.measured_density, MEASURED, "-", 2.6, "measured"),
        (curves.before_density, BEFORE, (0, (5, 2)), 1.3, "left before"),
        (curves.after_density, AFTER, "-", 1.3, "left after"),
        (curves.floor_density, FLOOR, (0, (1.5, 1.2)), 1.2, noise),
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
    plain(axis, "frequency, Hz", f"amplitude density, {unit}/√Hz")
    axis.legend(fontsize=8, ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False)
    return figure

"""Page of a gap analysis: the verdict in a sentence, and pictures that show why."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from spool_core.quantity import Quantity
from spool_core.uncertainty import LEGEND, interval, with_interval
from spool_gap.registry import EFFECTS
from spool_gap.result import COUNTED, GapResult

from . import gap_pictures as pictures
from . import page as html
from .evidence.exhibit import Exhibit, LeftOut

WHERE = (
    "Where the missing force sits, as shares of its energy before anything was added; after is drawn in the "
    "same scale. Bars: shares of the gap; dashes: what the sensors' noise alone would show there."
)
SURFACE = (
    "Mean force that the model lacks over displacement and velocity. Where left and right differ, a spring "
    "is missing; where top and bottom differ, friction; grey: the record was not there."
)
RANKING = "Every hypothesis, fitted together with the base and validated on data that no fit has seen."
WAVEFORM = "The held-out stretch in which the base model was worst: measured, before, after."
PROFILES = (
    "Profile likelihood: each number held at values around its estimate, all others fitted anew. Where the "
    "curve crosses the dashed line (3.84, 95 %) on both sides the record determines the number, and the "
    "crossings are its interval; where it stays below on one side the record sets no bound there."
)
EVIDENCE = (
    "What an expert looks at before believing the above, in this order. Records are shown as they were "
    "measured: what was taken out of a channel is still in them here."
)
SPECTRUM = "What is left over by frequency, before and after, with the measured signal and the noise."


def gap_page(
    result: GapResult, sources: Sequence[tuple[str, str]] = (), evidence: Sequence[Exhibit | LeftOut] = ()
) -> str:
    """Return the page of ``result``.

    Args:
        result: of the analysis.
        sources: label and value of what it was made from.
        evidence: pictures that let an expert check it.
    """
    said = result.verdict.replace("_", " ").replace("+", " and ")
    title = {
        "none": f"{result.record}: nothing is missing",
        "unexplained": f"{result.record}: something is missing that has no name here",
    }.get(result.verdict, f"{result.record}: {said}")
    before, after = result.before, result.after
    left = (after.nrmse / before.nrmse) ** 2 if before.nrmse > 0.0 else 1.0
    sections = [
        html.verdict(result.sentence),
        *([html.listing([f"Warning: {line}" for line in result.warnings])] if result.warnings else []),
        html.table(["", "before", "after", "noise alone"], _gap_rows(result)),
        html.paragraph(
            f"Confidence {result.confidence:.2f}{f' ({note})' if (note := result.confidence_note) else ''}. "
            f"Where it sat: {result.where.sentence}. "
            f"What is left: {result.where_after.sentence}."
        ),
    ]
    if result.advice:
        sections.append(html.paragraph(f"What would tell more: {result.advice}."))
    if result.effects:
        sections.append(html.heading("What is missing"))
        sections.append(html.table(["effect", "numbers", "what it means", "what to check"], _found(result)))
    if result.profiles:
        sections += [
            html.heading("What the record determines"),
            html.drawing(
                pictures.profile_figure(result.profiles),
                PROFILES,
                " ".join(f"{profile.sentence}." for profile in result.profiles),
            ),
            html.listing([f"{profile.sentence}." for profile in result.profiles]),
        ]
    if result.nuisances:
        sections.append(html.heading("What the measuring chain did"))
        sections.append(html.table(["finding", "channel", "size", "what to check"], _nuisances(result)))
    if result.candidates:
        sections.append(html.heading("What comes nearest"))
        sections.append(html.listing([_candidate(name) for name in result.candidates]))
    sections += [
        html.heading("Where the gap sits"),
        html.drawing(
            pictures.where_figure(result.where, result.where_after, left),
            WHERE,
            f"Before: {result.where.sentence}. After: {result.where_after.sentence}.",
        ),
        html.drawing(
            pictures.surface_figure(result.surface, result.surface_after), SURFACE, _surface_seen(result)
        ),
    ]
    if result.ranking:
        sections += [
            html.heading("Hypotheses"),
            html.drawing(pictures.ranking_figure(result), RANKING, _ranking_seen(result)),
            html.table(["hypothesis", "jointly with", "error, %", "evidence", "verdict"], _ranking(result)),
            html.paragraph(
                "Evidence: twice the logarithm of the likelihood ratio on held-out data, less the BIC "
                "penalty of the hypothesis's numbers."
            ),
        ]
    sections += [
        html.heading("Before and after"),
        html.drawing(pictures.waveform_figure(result.curves), WAVEFORM, _error_seen(result)),
        html.drawing(pictures.spectrum_figure(result.curves), SPECTRUM, _error_seen(result)),
        *([html.heading("Evidence"), html.paragraph(EVIDENCE)] if evidence else []),
        *html.evidence(evidence),
        html.heading("Numbers"),
        html.table(["parameter", "base model", "with what was found", "unit"], _numbers(result)),
        html.paragraph(
            f"{LEGEND}{f'; {COUNTED}' if result.noise_alone else ''}. "
            f"Model: {', '.join(term.name for term in result.model.terms)}; "
            f"{result.seconds:.0f} s of data, {result.elapsed:.1f} s of computing."
        ),
    ]
    return html.page(title, sections, sources)


def _surface_seen(result: GapResult) -> str:
    """Return how large the force is that is missing, before and after."""
    largest = [
        float(np.nanmax(np.abs(surface.force))) if np.isfinite(surface.force).any() else math.nan
        for surface in (result.surface, result.surface_after)
    ]
    return f"Largest mean force missing: {largest[0]:.2g} N before, {largest[1]:.2g} N after."


def _ranking_seen(result: GapResult) -> str:
    """Return the hypotheses that come first."""
    first = [f"{row.id.replace('_', ' ')} {100.0 * row.nrmse_after:.2g} %" for row in result.ranking[:3]]
    return f"Held-out error with the first ones: {', '.join(first)}."


def _error_seen(result: GapResult) -> str:
    """Return the held-out errors, in words."""
    before, after, noise = (
        f"{100.0 * error:.2g} %" for error in (result.before.nrmse, result.after.nrmse, result.noise_floor)
    )
    return f"Held-out error {before} before, {after} after, noise alone {noise}."


def _gap_rows(result: GapResult) -> list[dict[str, object]]:
    what = "spool acceleration" if result.kind == "accelerations" else "force"
    rows: list[dict[str, object]] = [
        {
            "": f"held-out error, % of the rms of the {what}",
            "before": 100.0 * result.before.nrmse,
            "after": 100.0 * result.after.nrmse,
            "noise alone": 100.0 * result.noise_floor,
        }
    ]
    if math.isfinite(result.before.amplitude_ratio):
        rows.append(
            {
                "": "amplitude ratio a_est/a_pom",
                "before": result.before.amplitude_ratio,
                "after": result.after.amplitude_ratio,
                "noise alone": 1.0,
            }
        )
    return rows


def _found(result: GapResult) -> list[dict[str, object]]:
    return [
        {
            "effect": effect.id.replace("_", " "),
            "numbers": "; ".join(_quantity(quantity) for quantity in effect.parameters),
            "what it means": effect.meaning,
            "what to check": effect.check,
        }
        for effect in result.effects
    ]


def _nuisances(result: GapResult) -> list[dict[str, object]]:
    return [
        {
            "finding": f"{entry.id.replace('_', ' ')}{', taken out' if entry.corrected else ''}",
            "channel": entry.channel,
            "size": f"{entry.size:.2g} {entry.unit}".removesuffix(" 1"),
            "what to check": entry.check,
        }
        for entry in result.nuisances
    ]


def _candidate(name: str) -> str:
    if name not in EFFECTS:
        return name.replace("_", " ")
    entry = EFFECTS[name]
    return f"{name.replace('_', ' ')}: {entry.on_the_machine}; check {entry.to_check}"


def _quantity(quantity: Quantity) -> str:
    value = with_interval(quantity.value, quantity.standard_deviation, quantity.unit)
    return f"{quantity.name.replace('_', ' ')} {value}"


def _ranking(result: GapResult) -> list[dict[str, object]]:
    return [
        {
            "hypothesis": row.id.replace("_", " "),
            "jointly with": ", ".join(name.replace("_", " ") for name in row.jointly_with) or "the base",
            "error, %": 100.0 * row.nrmse_after,
            "evidence": f"{row.evidence:.0f}",
            "verdict": "accepted" if row.accepted else row.reason or "another one is better",
        }
        for row in result.ranking[: pictures.SHOWN]
    ]


def _numbers(result: GapResult) -> list[dict[str, object]]:
    base, final = _by_name(result.base), _by_name(result.parameters)
    return [
        {
            "parameter": name.replace("_", " "),
            "base model": _number(base.get(name)),
            "with what was found": _number(final.get(name)),
            "unit": (final.get(name) or base[name]).unit,
        }
        for name in dict.fromkeys([*final, *base])
    ]


def _by_name(quantities: Sequence[Quantity]) -> dict[str, Quantity]:
    return {quantity.name: quantity for quantity in quantities}


def _number(quantity: Quantity | None) -> str:
    if quantity is None:
        return ""
    return str(interval(quantity.value, quantity.standard_deviation))

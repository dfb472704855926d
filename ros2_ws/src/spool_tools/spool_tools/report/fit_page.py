"""Pages of fits: of one model, and of a comparison of all."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from spool_core.uncertainty import LEGEND

from spool_tools.report import fit_curves as curves
from spool_tools.report import fit_pictures as pictures
from spool_tools.report import page as html
from spool_tools.report.evidence.collection import fit_exhibits
from spool_tools.report.fit_tables import (
    COLUMNS,
    correlated,
    parameter_lines,
    parameter_rows,
    quality_rows,
    ranking_rows,
    series_rows,
)
from spool_tools.report.provenance import sources
from spool_tools.report.ranking import WORTH, FittedSeries, Ranking, ValidatedFit

WAVEFORM = (
    "Spool acceleration, measured and simulated from the measured body acceleration alone; below, what is "
    "left over."
)
RATIO = (
    "Amplitude of the simulated over the measured spool acceleration in bands of 5 Hz; 1 is right, "
    "grey is what the paper's measuring chain may be off by."
)
FRICTION = (
    "What of the balance of forces is neither inertia nor spring, from both accelerometers, and the model's "
    "law through the same filter."
)
SPECTRUM = (
    "What the model leaves over, by frequency. The best that any model can do is the noise of both sensors."
)
EVIDENCE = (
    "What an expert looks at before believing the above, in this order, from the data that were fitted."
)


def fit_page(validated: ValidatedFit) -> str:
    """Return the page of a fit that has a result."""
    found = validated.fit
    agreement = found.agreement
    assert agreement is not None
    title = f"{found.model.name.replace('_', ' ')} fitted to {validated.data.name}"
    rows = parameter_rows(found)
    quality = quality_rows(validated)
    doubts = [f"Warning: {doubt}" for doubt in validated.data.doubts]
    sections = [
        html.verdict(summary(validated)),
        html.heading("Parameters"),
        html.table(list(rows[0]), rows),
        html.paragraph(
            f"{LEGEND}; the true value lies within it in 95 of 100 such records, if the model is right."
        ),
        *(html.listing(lines) for lines in (correlations(validated), found.warnings, doubts) if lines),
        html.heading("How well it holds"),
        html.table(["what", "value"], quality),
    ]
    shown = curves.overlay(validated.data.fitted, found, validated.data.valve)
    name = found.model.name
    friction = curves.friction(validated.data.fitted, found, validated.data.valve)
    sections += [
        html.drawing(
            pictures.waveform_figure({name: shown}, curves.excerpts(shown.run)), WAVEFORM, seen([validated])
        ),
        html.drawing(
            pictures.ratio_figure({name: agreement}, curves.highest_frequency(shown.run)),
            RATIO,
            ratio_seen([validated]),
        ),
        html.drawing(pictures.friction_figure({name: friction}), FRICTION, f"Law of {name} over velocity."),
        html.drawing(
            pictures.spectrum_figure({name: agreement}, curves.spectra(validated.data.fitted)),
            SPECTRUM,
            seen([validated]),
        ),
    ]
    sections += [
        html.heading("Evidence"),
        html.paragraph(EVIDENCE),
        *html.evidence(fit_exhibits(found, validated.data.valve, validated.data.fitted)),
    ]
    records = (*validated.data.paths, *validated.data.held_paths)
    return html.page(title, sections, sources(records, validated.data.valve))


def seen(validated: Sequence[ValidatedFit]) -> str:
    """Return what a picture of waveforms or of what is left over shows, in numbers."""
    parts = [f"{one.name.replace('_', ' ')} leaves {100.0 * one.training_error:.2g} %" for one in validated]
    return f"Of the measured rms {', '.join(parts)}." if parts else ""


def ratio_seen(validated: Sequence[ValidatedFit]) -> str:
    """Return what a picture of amplitude ratios shows, in numbers."""
    ratios = [(one.name.replace("_", " "), one.fit.agreement) for one in validated]
    parts = [f"{name} {found.amplitude_ratio:.3f}" for name, found in ratios if found is not None]
    return f"Mean amplitude ratio: {', '.join(parts)}." if parts else ""


def summary(validated: ValidatedFit) -> str:
    """Return in one sentence how much of the motion the model explains."""
    found = validated.fit
    error = validated.held_out_error
    where = "data that it has not seen"
    if not np.isfinite(error):
        error, where = validated.training_error, "the data it was fitted to"
    state = "" if found.converged else " The descent did not converge: distrust the numbers."
    return (
        f"With these parameters {found.model.name.replace('_', ' ')} gives the spool's acceleration on "
        f"{where} to within {100.0 * error:.2g} % of its rms.{state}"
    )


def correlations(validated: ValidatedFit) -> list[str]:
    """Return a line for each pair of parameters that is hardly distinguished."""
    return [
        f"{first} and {second} are correlated by {value:+.3f}".replace("_", " ")
        for first, second, value in correlated(validated.fit)
    ]


def compare_page(series: Sequence[FittedSeries], ranking: Ranking) -> str:
    """Return the page of a comparison in which at least one model has a result."""
    rows = ranking_rows(ranking)
    shown = [entry for entry in ranking.ranks if math.isfinite(entry.error)]
    sections: list[str] = [
        html.verdict(" ".join(ranking.sentences)),
        html.drawing(
            pictures.ranking_figure(
                [entry.model for entry in shown],
                [entry.excess for entry in shown],
                [entry.held_out_error for entry in shown],
                [entry.parameters for entry in shown],
                WORTH,
            ),
            "Models, best first: what each leaves over beyond the least, and its error on held-out data.",
            f"From best to worst: {', '.join(entry.model.replace('_', ' ') for entry in shown)}.",
        ),
        html.table(list(rows[0]), rows),
        html.listing(COLUMNS),
    ]
    for one in series:
        sections += _series(one, ranking)
    records = [path for one in series for path in (*one.data.paths, *one.data.held_paths)]
    made_from = [*sources(records), *(row for one in series for row in sources((), one.data.valve))]
    title = f"Models of {', '.join(one.data.name for one in series)}"
    return html.page(title, sections, list(dict.fromkeys(made_from)))


def _series(one: FittedSeries, ranking: Ranking) -> list[str]:
    order = [entry.model for entry in ranking.ranks]
    validated = sorted(
        (entry for entry in one.validated if entry.fit.reason is None),
        key=lambda entry: order.index(entry.name),
    )
    rows = [
        {**row, "parameters": "; ".join(parameter_lines(validated))}
        for row, validated in zip(series_rows(one), one.validated, strict=True)
    ]
    sections: list[str] = [
        html.heading(f"{one.data.name} ({one.data.valve.id})"),
        html.table(list(rows[0]), rows),
        html.paragraph(f"{LEGEND}. 'Not told': only combinations of them act."),
    ]
    if not validated:
        return sections
    fitted, valve = one.data.fitted, one.data.valve
    overlays = {entry.name: curves.overlay(fitted, entry.fit, valve) for entry in validated}
    agreements = {entry.name: entry.fit.agreement for entry in validated if entry.fit.agreement is not None}
    run = next(iter(overlays.values())).run
    friction = {entry.name: curves.friction(fitted, entry.fit, valve) for entry in validated}
    return [
        *sections,
        html.drawing(pictures.waveform_figure(overlays, curves.excerpts(run)), WAVEFORM, seen(validated)),
        html.drawing(
            pictures.ratio_figure(agreements, curves.highest_frequency(run)), RATIO, ratio_seen(validated)
        ),
        html.drawing(
            pictures.friction_figure(friction), FRICTION, f"Laws over velocity: {', '.join(friction)}."
        ),
        html.drawing(pictures.spectrum_figure(agreements, curves.spectra(fitted)), SPECTRUM, seen(validated)),
    ]

"""Page of a comparison: the verdict, the ranking as a picture, and each series in pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence

from spool_core.uncertainty import LEGEND

from . import fit_curves as curves
from . import fit_pictures as pictures
from . import page as html
from .comparison_tables import COLUMNS, parameter_lines, ranking_rows, series_rows
from .fit_page import FRICTION, RATIO, SPECTRUM, WAVEFORM, ratio_seen, seen
from .provenance import sources
from .ranking import WORTH, FittedSeries, Ranking


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

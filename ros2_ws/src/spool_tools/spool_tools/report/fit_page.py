"""Page of one fit: what it says, and pictures of how well it holds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from spool_core.uncertainty import LEGEND

from . import fit_curves as curves
from . import fit_pictures as pictures
from . import page as html
from .evidence.of_fit import fit_exhibits
from .fit_tables import correlated, parameter_rows, quality_rows
from .provenance import sources
from .validated_fit import ValidatedFit

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

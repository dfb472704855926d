"""Report of a joint fit of several set-ups: the page and its picture."""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from spool_core.uncertainty import LEGEND, Z_95
from spool_estimator.identification.determination import sentences
from spool_estimator.identification.fit_result import STOPPED_EARLY
from spool_report import fit_page as pictures
from spool_report import page as html
from spool_report.evidence.exhibit import DARK, STYLES, WIDTH
from spool_report.outputs import sources

from spool_design import setups as tables

CAPTION = (
    "95 % interval of each parameter over its value: from all set-ups together (thick), and from each set-up "
    "alone. An arrow across the panel: alone, it is known only together with other parameters."
)


def setups_page(found: tables.FittedSetUps) -> str:
    """Return the page of a joint fit that has a result."""
    joint = found.joint
    doubts = [f"{one.name}: {doubt}" for one in found.data for doubt in one.doubts]
    state = "" if joint.converged else " The descent did not converge: distrust the numbers."
    early = [f"Warning: {STOPPED_EARLY}."] if joint.stopped_early else []
    worst = max(one.held_out_error for one in found.validated)
    held = f"{100.0 * worst:.2g} % of its rms" if math.isfinite(worst) else "not known"
    sections = [
        html.verdict(f"{tables.headline(found)}.{state}"),
        html.answers(
            [
                (
                    "How sure",
                    f"Largest error of a set-up on data that the fit has not seen: {held}. {LEGEND}.",
                ),
                (
                    "What to do",
                    " ".join([*early, *doubts[:2]]) or "Look at the picture below, then use the numbers.",
                ),
            ]
        ),
        html.drawing(interval_figure(found), CAPTION, " ".join(sentences(joint.determinations))),
        html.heading("Parameters"),
        html.listing(sentences(joint.determinations)),
        html.table(tables.parameter_table(found)),
        html.paragraph(f"{LEGEND}. {tables.ALONE}"),
        html.table(tables.quality_table(found)),
        *(
            html.section(
                f"Set-up {setup.name}: waveform, amplitude, friction, spectrum", pictures.pictures([one])
            )
            for setup, one in zip(found.setups, found.validated, strict=True)
        ),
    ]
    records = [path for one in found.data for path in one.paths]
    title = f"{joint.model.name.replace('_', ' ')} fitted to set-ups of {found.valve.id}"
    return html.page(title, sections, sources(records, found.valve))


def interval_figure(found: tables.FittedSetUps) -> Figure:
    """Return the interval of each parameter over its value: together, and from each set-up alone."""
    known = [one for one in found.joint.parameters if math.isfinite(one.value) and one.value != 0.0]
    lines = 1 + len(found.setups)
    figure: Figure
    figure, axes = plt.subplots(
        len(known), 1, figsize=(WIDTH, 0.5 + (0.35 + 0.17 * lines) * len(known)), layout="constrained",
        squeeze=False, sharex=True,
    )  # fmt: skip
    reach = 0.0
    for axis, one in zip(axes[:, 0], known, strict=True):
        half = 100.0 * Z_95 * one.standard_deviation / abs(one.value)
        reach = max(reach, half)
        axis.errorbar(0.0, 0.0, xerr=half, color=DARK, lw=3, marker="o", capsize=4, label="together")
        for place, (setup, style) in enumerate(zip(found.setups, STYLES, strict=False), 1):
            alone = tables.alone_of(found, one.name, setup.name)
            if alone is None:
                continue
            if alone.low is not None and alone.high is not None:
                own = 50.0 * (alone.high - alone.low) / abs(one.value)
                reach = max(reach, own)
                axis.errorbar(0.0, place, xerr=own, color=style[0], lw=1.4, capsize=3, label=setup.name)
            else:
                axis.annotate(
                    "", (1.0, place), (0.0, place), xycoords=("axes fraction", "data"),
                    arrowprops={"arrowstyle": "<->", "color": style[0], "ls": "--"},
                )  # fmt: skip
        axis.set_ylim(lines - 0.4, -0.6)
        axis.set_yticks(
            range(lines), ["together", *(f"{setup.name} alone" for setup in found.setups)], fontsize=7
        )
        axis.set_title(tables.shown_name(one.name), fontsize=9, loc="left")
        axis.grid(alpha=0.25, axis="x")
    axes[-1, 0].set_xlim(-1.5 * reach, 1.5 * reach)
    axes[-1, 0].set_xlabel("95 % interval, % of the value")
    return figure

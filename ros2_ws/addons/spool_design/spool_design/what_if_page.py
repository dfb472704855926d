"""Report of what-if: the page and its pictures."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from spool_core.uncertainty import exact, number
from spool_report import page as html
from spool_report.evidence.exhibit import AFTER, BEFORE, DARK, DASHED, MEASURED, STYLES, WIDTH, plain

from spool_design import what_if as work
from spool_design.frequency_response import LIMIT, Response

RATIO = (
    "Spool acceleration over the machine's; 1: the spool moves as the machine does. Bands: 95 % interval. "
    "From the dotted line on, a speed is to be avoided."
)
STROKE = "Largest distance of the spool from the centre. Bands: 95 % interval."
CAMPBELL = (
    "Campbell diagram. Grey lines: orders (numbers at their ends). Horizontal lines: resonances. "
    "Thick: speeds to avoid after the change."
)
ORDERS = "Response to each order after the change, each acting alone. Bands: 95 % interval."
AMPLITUDES = "Largest response of the changed valve over the amplitude of the machine, without uncertainty."
#: Looks of today and after the change: colour, dash and name.
_LOOKS = ((BEFORE, DASHED, "today"), (AFTER, "-", "after the change"))


def what_if_page(found: work.WhatIf) -> str:
    """Return the page of a prediction."""
    sure = (
        f"Bands and intervals are of 95 %, from {found.draws} draws of the uncertainty of the fit. They "
        "count the model as right, and parameters without a deviation as exact."
        if found.draws
        else "No uncertainty is known: numbers without intervals are as good as the valve file."
    )
    shown = "Avoid the marked speeds." if found.after.avoid else "No speed has to be avoided."
    parts: list[str] = [
        html.verdict(found.sentence),
        html.answers(
            [("How sure", sure), ("What to do", f"{shown} Then measure: a prediction is no record.")]
        ),
        html.drawing(response_figure(found), f"{RATIO} Below: {STROKE}", found.sentence),
    ]
    if found.after.orders:
        parts += [
            html.drawing(campbell_figure(found), CAMPBELL, _seen(found)),
            html.drawing(orders_figure(found.after), ORDERS, _seen(found)),
        ]
    parts += [html.table(table) for table in work.tables(found)]
    if found.depends_on_amplitude:
        parts.append(html.drawing(amplitude_figure(found), AMPLITUDES))
    if found.notes:
        parts += [html.heading("Notes"), html.listing(list(found.notes))]
    return html.page(f"What if: {found.valve}", parts, [("valve", found.valve), ("model", found.model)])


def response_figure(found: work.WhatIf) -> Figure:
    """Draw amplitude ratio and stroke over frequency, today and after the change."""
    figure: Figure
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(WIDTH, 6.0), layout="constrained", sharex=True)
    for one, (colour, dash, name) in zip((found.before, found.after), _LOOKS, strict=True):
        upper.fill_between(one.frequency, one.low, one.high, color=colour, alpha=0.3, lw=0)
        upper.plot(one.frequency, one.amplitude_ratio, color=colour, ls=dash, lw=1.6, label=name)
        lower.fill_between(
            one.frequency, 1e3 * one.stroke_low, 1e3 * one.stroke_high, color=colour, alpha=0.3, lw=0
        )
        lower.plot(one.frequency, 1e3 * one.stroke, color=colour, ls=dash, lw=1.6)
    upper.axhline(found.limit, color=DARK, lw=0.8, ls=":")
    for axis in (upper, lower):
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.margins(x=0.0)
        for side in (axis.xaxis, axis.yaxis):
            side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            side.set_major_formatter("{x:g}")
            side.set_minor_formatter("")
    upper.legend(fontsize=8, frameon=False)
    plain(upper, up="spool over machine acceleration, 1")
    plain(
        lower, f"frequency, Hz (machine: {number(found.after.amplitude, 3)} m/s² peak)", "largest stroke, mm"
    )
    return figure


def campbell_figure(found: work.WhatIf) -> Figure:
    """Draw orders and resonances over speed, and the speeds to avoid."""
    figure: Figure
    figure, axis = plt.subplots(figsize=(WIDTH, 4.0), layout="constrained")
    assert found.speeds is not None
    speeds = np.array([0.0, 1.15 * found.speeds[1]])
    axis.axvspan(*found.speeds, color=MEASURED, alpha=0.15, lw=0, label="speeds of the machine")
    for response, (colour, dash, name) in zip((found.before, found.after), _LOOKS, strict=True):
        for place, frequency in enumerate(dict.fromkeys(one.frequency for one in response.resonances)):
            axis.axhline(
                frequency, color=colour, ls=dash, lw=1.4, label="" if place else f"resonance, {name}"
            )
    for one in found.after.avoid:
        span = np.array([one.low, one.high])
        assert one.order is not None
        axis.plot(span, span * one.order / 60.0, color=AFTER, lw=5.0, alpha=0.6, solid_capstyle="butt")
    highest = max([one.frequency for part in (found.before, found.after) for one in part.resonances] or [1.0])
    met = min(max(row.order for row in found.after.orders) * speeds[1] / 60.0, 2.5 * highest)
    top = max(met, 1.2 * highest)
    for row in found.after.orders:
        axis.plot(speeds, speeds * row.order / 60.0, color=MEASURED, lw=1.0)
        end = min(speeds[1], 60.0 * top / row.order)
        axis.annotate(
            exact(row.order), (end, end * row.order / 60.0), fontsize=8, color=DARK, xytext=(0, 2),
            textcoords="offset points", ha="center", annotation_clip=False,
        )  # fmt: skip
    axis.set_ylim(0.0, top)
    axis.set_xlim(*speeds)
    axis.legend(fontsize=8, frameon=False, loc="upper left")
    plain(axis, "speed, rev/min", "frequency, Hz")
    return figure


def orders_figure(response: Response) -> Figure:
    """Draw the amplitude ratio of each order over the speed."""
    figure: Figure
    figure, axis = plt.subplots(figsize=(WIDTH, 3.6), layout="constrained")
    for row, (colour, dash, _) in zip(response.orders, STYLES * len(response.orders), strict=False):
        label = f"order {exact(row.order)}, {number(row.amplitude, 3)} m/s²"
        axis.fill_between(row.speed, row.low, row.high, color=colour, alpha=0.3, lw=0)
        axis.plot(row.speed, row.amplitude_ratio, color=colour, ls=dash, lw=1.6, label=label)
    axis.axhline(LIMIT, color=DARK, lw=0.8, ls=":")
    axis.set_ylim(bottom=0.0)
    axis.legend(fontsize=8, frameon=False)
    plain(axis, "speed, rev/min", "spool over machine acceleration, 1")
    return figure


def amplitude_figure(found: work.WhatIf) -> Figure:
    """Draw the largest ratio and the largest stroke over the machine's amplitude."""
    figure: Figure
    figure, axes = plt.subplots(1, 2, figsize=(WIDTH, 3.0), layout="constrained")
    across = [one.amplitude for one in found.by_amplitude]
    for axis, label, values in (
        (axes[0], "largest amplitude ratio, 1", [one.amplitude_ratio for one in found.by_amplitude]),
        (axes[1], "largest stroke, mm", [1e3 * one.stroke for one in found.by_amplitude]),
    ):
        axis.plot(across, values, color=AFTER, marker="o", lw=1.4)
        axis.set_xscale("log")
        axis.set_xticks(across, [f"{one:g}" for one in across])
        axis.minorticks_off()
        axis.set_ylim(bottom=0.0)
        plain(axis, "peak acceleration of the machine, m/s²", label)
    return figure


def _seen(found: work.WhatIf) -> str:
    parts = [
        f"order {order} at {speed} ({name})"
        for name, _, _, _, order, speed, _ in (row for row in work.resonances(found)[1] if row[4:])
    ]
    return f"Resonances are met by {', '.join(parts)}." if parts else "No order meets a resonance."

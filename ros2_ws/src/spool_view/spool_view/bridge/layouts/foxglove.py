"""Foxglove and Lichtblick layout: state, plots and events of each valve in a tab of its own.

The form is that of ``LayoutData`` in ``@foxglove/studio-base``; Lichtblick reads the same. Paths name
recorded topics, so the layout serves live and on a bag.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .plotted_valve import PlottedValve

#: Okabe and Ito's colours, told apart by the colour-blind.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def foxglove_layout(valves: Sequence[PlottedValve]) -> dict[str, Any]:
    """Return the layout, types of JSON."""
    panels: dict[str, Any] = {}
    tabs = [_tab(valve, number, panels) for number, valve in enumerate(valves)]
    panels["Tab!valves"] = {"activeTabIdx": 0, "tabs": tabs}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": "Tab!valves",
    }


def _tab(valve: PlottedValve, number: int, panels: dict[str, Any]) -> dict[str, Any]:
    """Add the panels of ``valve`` to ``panels`` and return its tab."""
    space = f"/{valve.name}"

    def panel(kind: str, name: str, config: dict[str, Any]) -> str:
        key = f"{kind}!{number}{name}"
        panels[key] = config
        return key

    plots = [
        panel("Plot", "frequency", _plot("frequencies, Hz", [
            (f"{space}/health.dominant_frequency.value", "shaken at"),
            (f"{space}/estimate.natural_frequency.value", "natural frequency"),
        ])),
        panel("Plot", "amplification", _plot("amplification", [
            (f"{space}/health.amplification.value", "spool over body"),
        ])),
        *(
            panel("Plot", name, _plot(name.replace("_", " "), [
                (f"{space}/estimate.parameters[:]{{name==\"{name}\"}}.value", name),
            ]))
            for name in valve.parameters
        ),
        panel("Plot", "residual", _plot("residual", [(f"{space}/estimate.residual.value", "residual")])),
    ]  # fmt: skip
    state = panel("RawMessages", "health", {"topicPath": f"{space}/health", "expansion": "all"})
    events = panel("RawMessages", "events", {"topicPath": f"{space}/events.message"})
    side = {"first": state, "second": events, "direction": "column", "splitPercentage": 60}
    layout = {"first": side, "second": _stacked(plots), "direction": "row", "splitPercentage": 25}
    return {"title": valve.name, "layout": layout}


def _plot(title: str, paths: Sequence[tuple[str, str]]) -> dict[str, Any]:
    return {
        "title": title,
        "paths": [
            {
                "value": path,
                "label": label,
                "enabled": True,
                "color": COLOURS[place % len(COLOURS)],
                "timestampMethod": "headerStamp",
            }
            for place, (path, label) in enumerate(paths)
        ],
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _stacked(keys: Sequence[str]) -> Any:
    """Return ``keys`` one below the other, of equal heights, as the viewer's mosaic takes it."""
    if len(keys) == 1:
        return keys[0]
    share = 100.0 / len(keys)
    return {
        "first": keys[0],
        "second": _stacked(keys[1:]),
        "direction": "column",
        "splitPercentage": share,
    }

"""Page of a fleet: its tables, and the numbers of its charts, which uPlot draws in the browser."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from spool_core.numbers import Array
from spool_core.text import plural
from spool_core.uncertainty import LEGEND, Z_95, interval, number, unit_text, with_interval
from spool_report.outputs import provenance
from spool_report.page import plain_numbers, plotter

from spool_fleet.content import (
    LIGHTS,
    BagRow,
    PageContent,
    ValveContent,
    cause_name,
    cause_of,
    change_sentence,
    date,
    limit_sentence,
    news_of,
    percent,
    report_name,
    time_left,
)
from spool_fleet.courses import NAMES, Course, day_of
from spool_fleet.judgement import MACHINE, Trend
from spool_fleet.observations import BIN, PARAMETERS

#: Changes in the list of the worst, and services in theirs, at most.
MOST_WORST, MOST_SERVICES = 20, 50

_TEMPLATES = Environment(
    loader=PackageLoader(__package__), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
    lstrip_blocks=True,
)  # fmt: skip
_TEMPLATES.filters |= {"number": number, "day": date, "percent": percent, "quote": quote}
_TEMPLATES.globals |= {
    "interval": interval, "with_interval": with_interval, "cause_name": cause_name, "cause_of": cause_of,
    "change_sentence": change_sentence, "limit_sentence": limit_sentence, "names": NAMES, "plural": plural,
    "time_left": time_left, "MACHINE": MACHINE, "legend": LEGEND,
}  # fmt: skip

TEMPERATURE = "temperature"

#: Limits of the monitor that a chart shows on either side at least, and at most: what goes further is drawn
#: at the edge, else one broken estimate would make lines of all others.
LEAST_SEEN, MOST_SEEN = 1.2, 3.0
#: Share of the baseline beyond which a limit is not shown (dry friction near zero has limits of many times
#: its value), and share up to which is shown at least what there is.
FAR_LIMIT, NEAR = 0.5, 1.0

#: Weeks without a bag over which no line is drawn.
BREAK = 5.0
#: What is written at the line of a service.
LETTERS = {"oil_change": "O", "spring_change": "S", "repair": "R"}


@dataclass(frozen=True, slots=True)
class Worst:
    """Change of a valve in the list of the worst."""

    valve: ValveContent
    trend: Trend


def fleet_page(content: PageContent, reports: Mapping[str, str]) -> str:
    """Return the whole page; ``reports``: files of bags' reports, relative to it, by the bag's path."""
    (plot_style, plot_program), own = plotter(), _source("fleet.js")
    style = plot_style + _source("fleet.css")
    counts, worst = Counter(one.light for one in content.valves), worst_of(content)
    text = _TEMPLATES.get_template("fleet.html").render(
        content=content,
        charts=Charts(content),
        counts=[(light, counts[light]) for light in LIGHTS],
        news=news_of(content),
        worst=worst[:MOST_WORST],
        changes=len(worst),
        parameters=PARAMETERS,
        reports=reports,
        command=replay_command,
        services=content.services[::-1][:MOST_SERVICES],
        style=Markup(style),
        programs=[Markup(plot_program), Markup(own)],
        policy=f"default-src 'none'; style-src {_digest(style)}; script-src {_digest(plot_program)} "
        f"{_digest(own)}; base-uri 'none'; form-action 'none'",
        provenance=provenance(),
    )
    return text + "\n"


def worst_of(content: PageContent) -> list[Worst]:
    """Return the changes, the largest share of the monitor's limit first."""
    found = [Worst(valve, trend) for valve in content.valves for trend in valve.trends if trend.changed]
    return sorted(found, key=lambda one: -one.trend.share_of_limit)


def replay_command(valve: ValveContent, row: BagRow) -> str:
    """Return the command that makes the report of a bag, as a shell takes it."""
    report = report_name(valve.name, row.bag, row.start)
    return shlex.join(["./spool", "replay", row.bag, "--report", report])


class Charts:
    """Charts of the valves of ``content`` on common scales: what uPlot draws, in days and per cent."""

    def __init__(self, content: PageContent) -> None:
        courses = [course for valve in content.valves for course in valve.courses.values()]
        self.scales = {
            name: relative_scale(
                [one.largest for one in courses if one.parameter == name],
                [one.limit for one in courses if one.parameter == name],
            )
            for name in PARAMETERS
        }
        celsius = [value for valve in content.valves if valve.temperature for value in valve.temperature[1]]
        low, high = (min(celsius), max(celsius)) if celsius else (0.0, 1.0)
        margin = max(0.05 * (high - low), 1.0)
        self.scales[TEMPERATURE] = (low - margin, high + margin)
        first, last = (day_of(content.first), day_of(content.newest)) if content.first else (0.0, 1.0)
        margin = max(0.02 * (last - first), 7.0 - 0.5 * (last - first), 1.0)  # two weeks at least
        self.time = (first - margin, last + margin)
        self._drawn: dict[str, dict[str, object]] = {}

    def reach(self, parameter: str) -> str:
        """Return what the small charts of ``parameter`` show from bottom to top."""
        low, high = self.scales[parameter]
        return f"{low:+.0f} to {high:+.0f} %"

    def chart(self, valve: ValveContent, course: Course, size: str) -> Markup:
        """Return the place of the ``small`` or ``large`` chart of a course."""
        key = f"{valve.anchor}-{course.parameter}"
        points, trend = course.points, course.trend
        bounds = {"value": points.value, "low": points.low, "high": points.high}
        self._drawn[key] = {
            **_columns(points.day, **{name: 100.0 * (row - 1.0) for name, row in bounds.items()}),
            "baseline": course.baseline,
            "limit": course.limit if math.isfinite(course.limit) else None,
            "levels": [
                [round(one.first, 3), round(one.last, 3), *plain_numbers([one.value, one.half_width])]
                for one in course.levels
            ],
            "services": [[one.day, LETTERS.get(one.kind, "*")] for one in course.services],
            "since": trend.since if trend.changed else None,
            "fit": _fitted(course),
        }
        return _place(size, key, course.parameter, described(course))

    def temperature(self, valve: ValveContent) -> Markup:
        """Return the place of the large chart of the oil temperature."""
        assert valve.temperature is not None
        days, values = valve.temperature
        key = f"{valve.anchor}-{TEMPERATURE}"
        self._drawn[key] = _columns(days, value=values)
        text = f"oil temperature: {number(values.min(), 2)} to {number(values.max(), 2)} °C in weekly means"
        return _place("large", key, TEMPERATURE, text)

    def numbers(self) -> Markup:
        """Return the numbers of all charts that have a place on the page so far, as JSON."""
        shown = {"time": self.time, "scales": self.scales, "charts": self._drawn}
        # What ends a script in HTML must not stand in one.
        return Markup(json.dumps(shown, allow_nan=False, separators=(",", ":")).replace("</", "<\\/"))


def described(course: Course) -> str:
    """Return what a chart shows, for those who cannot see it."""
    trend = course.trend
    if not course.judged:
        return f"{course.title}: {trend.state}, {trend.reason}"
    level = f"baseline {interval(trend.baseline, trend.baseline_std)}{unit_text(course.unit)}"
    return f"{course.title}: {level}; {change_sentence(trend) if trend.changed else 'no change found'}"


def relative_scale(largest: Sequence[float], limits: Sequence[float]) -> tuple[float, float]:
    """Return the ends of the scale of one parameter over all valves, per cent from the baseline.

    Args:
        largest: difference from the baseline in each valve.
        limits: of the monitor in each valve.
    """
    known = [one for one in limits if math.isfinite(one)]
    limit = min(float(np.median(known)), FAR_LIMIT) if known else FAR_LIMIT
    reach = min(max(1.05 * max(largest, default=0.0), LEAST_SEEN * limit), max(MOST_SEEN * limit, NEAR))
    return 100.0 * max(-1.0, -reach), 100.0 * reach


def _fitted(course: Course) -> dict[str, float] | None:
    """Return the change that was fitted, and its 95 % interval at its end; not through a service."""
    trend = course.trend
    begun = [level for level in course.levels if level.first <= trend.since]
    if not trend.changed or not begun or any(one.day > trend.since for one in course.services):
        return None
    level = begun[-1].value
    end, half = level * (1.0 + trend.change), level * Z_95 * trend.change_std
    begin = level if math.isfinite(trend.rate) else end
    return {"latest": trend.latest, "begin": begin, "end": end, "low": end - half, "high": end + half}


def _columns(days: Array, **rows: Array) -> dict[str, object]:
    """Return the rows of a chart by name, with a gap where weeks without bags interrupt its line."""
    pauses = np.diff(days)
    usual = np.sort(pauses)[pauses.size // 2] if pauses.size else 0.0
    after = np.flatnonzero(pauses > max(BREAK * BIN, 3.0 * usual)) + 1
    between = 0.5 * (days[after - 1] + days[after])
    return {
        "day": np.insert(days, after, between).round(3).tolist(),
        **{name: plain_numbers(np.insert(row, after, np.nan)) for name, row in rows.items()},
    }


def _place(size: str, key: str, scale: str, described_as: str) -> Markup:
    template = '<div class="{} chart" data-key="{}" data-scale="{}" role="img" aria-label="{}"></div>'
    return Markup(template).format(size, key, scale, described_as)


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _source(name: str) -> str:
    """Return a file of the templates' folder as it stands."""
    assert _TEMPLATES.loader is not None
    return _TEMPLATES.loader.get_source(_TEMPLATES, name)[0]

"""Drawing of the fleet's charts as SVG: small ones side by side, large ones for one valve.

Colours and strokes stand in the page's styles; axes are drawn once and used by every chart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup
from spool_core.uncertainty import interval, number, unit_text

from spool_fleet.trends.observations import PARAMETERS

from .content import PageContent, ValveContent
from .courses import Course, Points
from .frames import LARGE, SMALL, TEMPERATURE, axes, label
from .pen import Pen
from .scales import plain_scale, relative_scale, time_scale
from .sentences import change_sentence
from .trend_rows import day_of


class Charts:
    """Charts of the valves of ``content`` on common scales."""

    def __init__(self, content: PageContent) -> None:
        courses = [course for valve in content.valves for course in valve.courses.values()]
        self.scales = {
            name: relative_scale(
                [one.largest for one in courses if one.parameter == name],
                [one.limit for one in courses if one.parameter == name],
            )
            for name in PARAMETERS
        }
        celsius = [valve.temperature[1] for valve in content.valves if valve.temperature is not None]
        self.scales[TEMPERATURE] = plain_scale([float(value) for row in celsius for value in row])
        first, last = day_of(content.first), day_of(content.newest)
        self.time = time_scale(first, last) if math.isfinite(first) else time_scale(0.0, 1.0)

    def frames(self) -> Markup:
        """Return the axes, to stand once on the page before any chart."""
        drawn = [
            Markup('<g id="{}-{}">{}</g>').format(kind, name, axes(frame, self.time, scale, name))
            for name, scale in self.scales.items()
            for kind, frame in (("large", LARGE), ("small", SMALL))
        ]
        template = '<svg class="frames" width="0" height="0" aria-hidden="true"><defs>{}{}</defs></svg>'
        return Markup(template).format(_DOT, Markup().join(drawn))

    def reach(self, parameter: str) -> str:
        """Return what the small charts of ``parameter`` show from bottom to top."""
        scale = self.scales[parameter]
        return f"{100.0 * (scale.low - 1.0):+.0f} to {100.0 * (scale.high - 1.0):+.0f} %"

    def small(self, course: Course) -> Markup:
        """Return the small chart of a course."""
        draw = Pen(SMALL, self.time, self.scales[course.parameter])
        body = [draw.levels(course), draw.marks(course, letters=False), draw.line(course.points, dots=False)]
        template = (
            '<svg class="small" viewBox="0 0 {:g} {:g}" preserveAspectRatio="none" role="img" '
            'aria-label="{}"><use href="#small-{}"/>{}</svg>'
        )
        return Markup(template).format(
            SMALL.width, SMALL.height, described(course), course.parameter, Markup().join(body)
        )

    def large(self, course: Course) -> Markup:
        """Return the large chart of a course: intervals, levels, limits, services, the fitted change."""
        scale = self.scales[course.parameter]
        draw = Pen(LARGE, self.time, scale)
        body = [
            draw.levels(course),
            draw.limits(course),
            draw.band(course.points),
            draw.marks(course),
            draw.line(course.points),
            draw.beyond(course.points),
            draw.change(course),
            *(
                label(LARGE.width - LARGE.right + 4.0, LARGE.y(scale.share(tick)) + 3.5, number(
                    tick * course.baseline, 3), "start")
                for tick in scale.ticks
            ),
        ]  # fmt: skip
        return _chart(described(course), course.parameter, body)

    def temperature(self, valve: ValveContent) -> Markup:
        """Return the large chart of the oil temperature."""
        assert valve.temperature is not None
        days, values = valve.temperature
        draw = Pen(LARGE, self.time, self.scales[TEMPERATURE])
        points = Points(days, values, values, values)
        text = f"oil temperature: {number(values.min(), 2)} to {number(values.max(), 2)} °C in weekly means"
        return _chart(text, TEMPERATURE, [draw.line(points)])


def described(course: Course) -> str:
    """Return what a chart shows, for those who cannot see it."""
    trend = course.trend
    if not course.judged:
        return f"{course.title}: {trend.state}, {trend.reason}"
    level = f"baseline {interval(trend.baseline, trend.baseline_std)}{unit_text(course.unit)}"
    return f"{course.title}: {level}; {change_sentence(trend) if trend.changed else 'no change found'}"


def _chart(described_as: str, name: str, body: Sequence[Markup]) -> Markup:
    return Markup(
        '<svg class="large" viewBox="0 0 {:g} {:g}" role="img" aria-label="{}">'
        '<use href="#large-{}"/>{}</svg>'
    ).format(LARGE.width, LARGE.height, described_as, name, Markup().join(body))


_DOT = Markup(
    '<marker id="dot" viewBox="0 0 4 4" refX="2" refY="2" markerWidth="4" markerHeight="4" '
    'markerUnits="userSpaceOnUse"><circle cx="2" cy="2" r="1.7"/></marker>'
)

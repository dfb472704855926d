"""Pen of the fleet's charts: lines, intervals, levels and marks in a frame on two scales."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

from markupsafe import Markup
from spool_core.uncertainty import Z_95

from spool_fleet.trends.weekly import BIN

from .courses import Course, Points
from .frames import Frame
from .scales import Scale, TimeScale
from .sentences import date

#: Weeks without a bag over which no line is drawn.
BREAK = 5.0
#: What is written at the line of a service.
LETTERS = {"oil_change": "O", "spring_change": "S", "repair": "R"}


@dataclass(frozen=True, slots=True)
class Pen:
    """Pen that draws in ``frame`` on two scales."""

    frame: Frame
    time: TimeScale
    scale: Scale

    def x(self, day: float) -> str:
        """Return the place of ``day``."""
        return f"{self.frame.x(self.time.share(day)):.1f}"

    def y(self, value: float) -> str:
        """Return the place of ``value``."""
        return f"{self.frame.y(self.scale.share(value)):.1f}"

    def levels(self, course: Course) -> Markup:
        """Draw the levels, with the band in which healthy weeks lie where that is known."""
        drawn = []
        for level in course.levels:
            first, last, middle = self.x(level.first), self.x(level.last), self.y(level.value)
            if math.isfinite(level.half_width):
                ends = (self.y(level.value - level.half_width), self.y(level.value + level.half_width))
                path = f"M{first} {ends[0]}H{last}V{ends[1]}H{first}Z"
                drawn.append(Markup('<path class="healthy" d="{}"/>').format(path))
            drawn.append(Markup('<path class="base" d="M{} {}H{}"/>').format(first, middle, last))
        return Markup().join(drawn)

    def limits(self, course: Course) -> Markup:
        """Draw the monitor's limits around the levels."""
        lines = [
            f"M{self.x(level.first)} {self.y(value)}H{self.x(level.last)}"
            for level in course.levels
            for value in (level.value * (1.0 - course.limit), level.value * (1.0 + course.limit))
            if self.scale.low < value < self.scale.high
        ]
        return Markup('<path class="limit" d="{}"/>').format("".join(lines)) if lines else Markup()

    def line(self, points: Points, *, dots: bool = True) -> Markup:
        """Draw the course."""
        path = "".join(
            f"{'M' if apart else 'L'}{self.x(day)} {self.y(value)}"
            for day, value, apart in zip(points.day, points.value, _apart(points.day), strict=True)
        )
        return Markup('<path class="course{}" d="{}"/>').format(" dots" if dots else "", path)

    def band(self, points: Points) -> Markup:
        """Draw the 95 % interval around the course."""
        path, start = [], 0
        apart = [*_apart(points.day)[1:], True]
        for end, closes in enumerate(apart, start=1):
            if closes:
                own = range(start, end)
                up = [f"{self.x(points.day[one])} {self.y(points.high[one])}" for one in own]
                down = [f"{self.x(points.day[one])} {self.y(points.low[one])}" for one in reversed(own)]
                path.append("M" + "L".join(up + down) + "Z")
                start = end
        return Markup('<path class="band" d="{}"/>').format("".join(path))

    def beyond(self, points: Points) -> Markup:
        """Mark points that lie beyond the scale."""
        path = []
        for day, value in zip(points.day, points.value, strict=True):
            way = 1.0 if value > self.scale.high else -1.0 if value < self.scale.low else 0.0
            if way:
                tip = self.frame.y(0.5 + way) - 3.0 * way
                path.append(f"M{self.x(day)} {tip:.1f}l-4 {7.0 * way:g}h8Z")
        return Markup('<path class="beyond" d="{}"/>').format("".join(path)) if path else Markup()

    def marks(self, course: Course, *, letters: bool = True) -> Markup:
        """Mark services, and the begin of a change."""
        drawn = []
        top, bottom = self.frame.top, self.frame.height - self.frame.bottom
        for one in course.services:
            path = f"M{self.x(one.day)} {top:g}V{bottom:g}"
            drawn.append(Markup('<path class="service" d="{}"/>').format(path))
            if letters:
                drawn.append(
                    Markup('<text class="service" x="{}" y="{:g}">{}<title>{}</title></text>').format(
                        self.x(one.day), top - 4.0, LETTERS.get(one.kind, "*"),
                        f"{one.kind.replace('_', ' ')} {date(one.day)} {one.comment}".strip(),
                    )
                )  # fmt: skip
        if course.trend.changed:
            path = f"M{self.x(course.trend.since)} {top:g}V{bottom:g}"
            drawn.append(Markup('<path class="since" d="{}"/>').format(path))
            if letters:
                drawn.append(
                    Markup('<text class="since" x="{}" y="{:g}">▼<title>began {}</title></text>').format(
                        self.x(course.trend.since), top - 4.0, date(course.trend.since)
                    )
                )
        return Markup().join(drawn)

    def change(self, course: Course) -> Markup:
        """Draw the change that was fitted, with the 95 % interval at its end; not through a service."""
        trend = course.trend
        begun = [level for level in course.levels if level.first <= trend.since]
        if not trend.changed or not begun or any(one.day > trend.since for one in course.services):
            return Markup()
        level = begun[-1].value
        end, half = level * (1.0 + trend.change), level * Z_95 * trend.change_std
        first, last, at = self.x(trend.since), self.x(trend.latest), self.y(end)
        start = f"{first} {self.y(level)}L" if math.isfinite(trend.rate) else f"{first} {at}L"
        bar = f"M{last} {self.y(end - half)}V{self.y(end + half)}m-4 0h8m-4 0V{self.y(end - half)}m-4 0h8"
        return Markup('<path class="fit" d="M{}{} {}"/><path class="bar" d="{}"/>').format(
            start, last, at, bar
        )


def _apart(days: Iterable[float]) -> list[bool]:
    """Return of each day whether it begins a new line: the first, and what follows weeks without bags."""
    row = list(days)
    gaps = [later - earlier for earlier, later in itertools.pairwise(row)]
    usual = sorted(gaps)[len(gaps) // 2] if gaps else 0.0
    return [True, *(gap > max(BREAK * BIN, 3.0 * usual) for gap in gaps)] if row else []

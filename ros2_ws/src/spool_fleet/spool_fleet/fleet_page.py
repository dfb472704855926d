"""Page of a fleet: its tables and charts.

Colours and strokes stand in the page's styles; axes are drawn once and used by every chart.
"""

from __future__ import annotations

import base64
import hashlib
import itertools
import math
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from spool_core.text import plural
from spool_core.uncertainty import LEGEND, Z_95, interval, number, unit_text, with_interval
from spool_tools.outputs import provenance

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
from spool_fleet.courses import NAMES, Course, Points, TrendRow, day_of
from spool_fleet.judgement import MACHINE
from spool_fleet.observations import BIN, DAY, PARAMETERS

#: Changes in the list of the worst, services and bags in trouble in their lists, at most.
MOST_WORST, MOST_SERVICES, MOST_TROUBLES = 20, 50, 50

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


_DOT = Markup(
    '<marker id="dot" viewBox="0 0 4 4" refX="2" refY="2" markerWidth="4" markerHeight="4" '
    'markerUnits="userSpaceOnUse"><circle cx="2" cy="2" r="1.7"/></marker>'
)

TEMPERATURE = "temperature"


@dataclass(frozen=True, slots=True)
class Frame:
    """Frame of a chart: its size and margins, px."""

    width: float
    height: float
    left: float = 0.0
    right: float = 0.0
    top: float = 2.0
    bottom: float = 2.0

    def x(self, share: float) -> float:
        """Return the place of ``share`` of the width."""
        return self.left + share * (self.width - self.left - self.right)

    def y(self, share: float) -> float:
        """Return the place of ``share`` of the height, kept within the frame."""
        return self.height - self.bottom - min(max(share, 0.0), 1.0) * (self.height - self.top - self.bottom)


LARGE = Frame(440.0, 190.0, 46.0, 58.0, 16.0, 24.0)
SMALL = Frame(200.0, 44.0)

#: Limits of the monitor that a chart shows on either side at least, and at most: what goes further is drawn
#: at the edge, else one broken estimate would make lines of all others.
LEAST_SEEN, MOST_SEEN = 1.2, 3.0
#: Share of the baseline beyond which a limit is not shown (dry friction near zero has limits of many times
#: its value), and share up to which is shown at least what there is.
FAR_LIMIT, NEAR = 0.5, 1.0
#: Marks on an axis at most.
MOST_TICKS, MOST_DATES = 5, 5

#: Weeks without a bag over which no line is drawn.
BREAK = 5.0
#: What is written at the line of a service.
LETTERS = {"oil_change": "O", "spring_change": "S", "repair": "R"}


@dataclass(frozen=True, slots=True)
class Worst:
    """Change of a valve in the list of the worst."""

    valve: ValveContent
    trend: TrendRow


def fleet_page(content: PageContent, reports: Mapping[str, str]) -> str:
    """Return the whole page; ``reports``: files of bags' reports, relative to it, by the bag's path."""
    style, program = _source("fleet.css"), _source("fleet.js")
    counts = Counter(one.light for one in content.valves)
    text = _TEMPLATES.get_template("fleet.html").render(
        content=content,
        charts=Charts(content),
        counts=[(light, counts[light]) for light in LIGHTS],
        news=news_of(content),
        worst=worst_of(content)[:MOST_WORST],
        changes=len(worst_of(content)),
        parameters=PARAMETERS,
        reports=reports,
        command=replay_command,
        services=content.services[::-1][:MOST_SERVICES],
        style=Markup(style),
        program=Markup(program),
        policy=_policy(style, program),
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


def axes(frame: Frame, time: TimeScale, scale: Scale, name: str) -> Markup:
    """Return the axes of a chart of the parameter ``name``, without texts in a small one."""
    left, right = frame.left, frame.width - frame.right
    top, bottom = frame.top, frame.height - frame.bottom
    grid = "".join(f"M{left:g} {frame.y(scale.share(tick)):.1f}H{right:g}" for tick in scale.ticks)
    months = "".join(f"M{frame.x(time.share(day)):.1f} {bottom:g}v-4" for day, _ in time.ticks)
    drawn = [
        Markup('<path class="grid" d="{}"/><path class="edge" d="M{:g} {:g}V{:g}H{:g}{}"/>').format(
            grid, left, top, bottom, right, months
        )
    ]
    if frame is LARGE:
        for tick in scale.ticks:
            said = f"{tick:g} °C" if name == TEMPERATURE else f"{100.0 * (tick - 1.0):+.3g} %"
            text = "0 %" if name != TEMPERATURE and abs(tick - 1.0) < 1e-9 else said
            drawn.append(label(left - 4.0, frame.y(scale.share(tick)) + 3.5, text, "end"))
        for day, text in time.ticks:
            drawn.append(label(frame.x(time.share(day)), frame.height - 8.0, text, "middle"))
    return Markup().join(drawn)


def label(x: float, y: float, text: str, anchor: str) -> Markup:
    """Return a text at a place."""
    return Markup('<text x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>').format(x, y, anchor, text)


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale from ``low`` to ``high`` with marks."""

    low: float
    high: float
    ticks: tuple[float, ...]

    def share(self, value: float) -> float:
        """Return where ``value`` lies: 0 at the low end, 1 at the high one."""
        return (value - self.low) / (self.high - self.low)


@dataclass(frozen=True, slots=True)
class TimeScale:
    """Scale of days since 1970; ``ticks`` are the days and names of months."""

    first: float
    last: float
    ticks: tuple[tuple[float, str], ...]

    def share(self, day: float) -> float:
        """Return where ``day`` lies: 0 at the begin, 1 at the end."""
        return (day - self.first) / (self.last - self.first)


def relative_scale(largest: Sequence[float], limits: Sequence[float]) -> Scale:
    """Return the scale of relative values (1: baseline) of one parameter over all valves.

    Args:
        largest: difference from the baseline in each valve.
        limits: of the monitor in each valve.
    """
    known = [one for one in limits if math.isfinite(one)]
    limit = min(float(np.median(known)), FAR_LIMIT) if known else FAR_LIMIT
    reach = min(max(1.05 * max(largest, default=0.0), LEAST_SEEN * limit), max(MOST_SEEN * limit, NEAR))
    low, high = max(0.0, 1.0 - reach), 1.0 + reach
    return Scale(low, high, tuple(1.0 + one for one in ticks(low - 1.0, high - 1.0)))


def plain_scale(values: Sequence[float]) -> Scale:
    """Return a scale around ``values``."""
    low, high = (min(values), max(values)) if values else (0.0, 1.0)
    margin = max(0.05 * (high - low), 1.0)
    return Scale(low - margin, high + margin, ticks(low - margin, high + margin))


def time_scale(first: float, last: float) -> TimeScale:
    """Return the scale of the days from ``first`` to ``last``, at least two weeks, with months marked."""
    margin = max(0.02 * (last - first), 7.0 - 0.5 * (last - first), 1.0)
    first, last = first - margin, last + margin
    begin = datetime.fromtimestamp(first * DAY, timezone.utc)
    months = 12 * begin.year + begin.month  # the month after the first day's
    found = []
    while (day := _first_of(months)) <= last:
        found.append((day, months))
        months += 1
    steps = (1, 2, 3, 6, 12, 24, 60, 120, 1200)
    step = next((one for one in steps if len(found) <= MOST_DATES * one), 12000)
    named = [(day, f"{number // 12}-{number % 12 + 1:02d}") for day, number in found if number % step == 0]
    if not named:
        named = [(0.5 * (first + last), (begin + timedelta(days=margin)).strftime("%Y-%m-%d"))]
    return TimeScale(first, last, tuple(named))


def ticks(low: float, high: float, most: int = MOST_TICKS) -> tuple[float, ...]:
    """Return round numbers between ``low`` and ``high``, ``most`` at most."""
    power = 10.0 ** math.floor(math.log10((high - low) / most))
    for factor in (1.0, 2.0, 5.0, 10.0, 20.0):
        step = factor * power
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if last - first < most:
            break
    return tuple(number * step for number in range(first, last + 1))


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


def _policy(style: str, program: str) -> str:
    """Return the content security policy: this page's own style and program, nothing from anywhere."""
    return (
        f"default-src 'none'; style-src {_digest(style)}; script-src {_digest(program)}; base-uri 'none'; "
        "form-action 'none'"
    )


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _source(name: str) -> str:
    """Return a file of the templates' folder as it stands."""
    assert _TEMPLATES.loader is not None
    return _TEMPLATES.loader.get_source(_TEMPLATES, name)[0]


def _chart(described_as: str, name: str, body: Sequence[Markup]) -> Markup:
    return Markup(
        '<svg class="large" viewBox="0 0 {:g} {:g}" role="img" aria-label="{}">'
        '<use href="#large-{}"/>{}</svg>'
    ).format(LARGE.width, LARGE.height, described_as, name, Markup().join(body))


def _first_of(months: int) -> float:
    """Return the day on which a month begins, counted from the year 0."""
    return datetime(months // 12, months % 12 + 1, 1, tzinfo=timezone.utc).timestamp() / DAY


def _apart(days: Iterable[float]) -> list[bool]:
    """Return of each day whether it begins a new line: the first, and what follows weeks without bags."""
    row = list(days)
    gaps = [later - earlier for earlier, later in itertools.pairwise(row)]
    usual = sorted(gaps)[len(gaps) // 2] if gaps else 0.0
    return [True, *(gap > max(BREAK * BIN, 3.0 * usual) for gap in gaps)] if row else []

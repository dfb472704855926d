"""Page of the fleet: one HTML file that needs nothing else, made from the tables of a store."""

from __future__ import annotations

import base64
import hashlib
import shlex
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from spool_core.text import plural
from spool_core.uncertainty import LEGEND, interval, number, with_interval
from spool_tools.report.provenance import provenance

from spool_fleet.charts import Charts
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
from spool_fleet.courses import NAMES, TrendRow
from spool_fleet.judgement import MACHINE
from spool_fleet.observations import PARAMETERS

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

"""Page of a replay: what the monitor said of each valve, and the evidence for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from spool_core.text import plural
from spool_core.uncertainty import LEGEND, with_interval

from . import page as html
from .evidence.exhibit import Exhibit, LeftOut

ABOUT = (
    "What an expert looks at before believing the above: first what drifted and when, then whether the "
    "record could tell it, then whether the model holds at all. The model has the numbers of the last "
    "estimate: where a parameter drifted, it fits the end of the record only."
)


def replay_page(
    result: Mapping[str, Any],
    evidence: Mapping[str, Sequence[Exhibit | LeftOut]],
    sources: Sequence[tuple[str, str]] = (),
) -> str:
    """Return the page of a replay.

    Args:
        result: as ``replay --json`` writes it.
        evidence: pictures of each valve, by its name.
        sources: label and value of what it was made from.
    """
    sections: list[str] = []
    if result["warnings"]:
        sections.append(html.listing([f"Warning: {text}" for text in result["warnings"]]))
    for name, valve in result["valves"].items():
        sections += [
            html.heading(name),
            html.verdict(_verdict(name, valve)),
            html.paragraph(valve["valve"]["sentence"]),
            html.paragraph(f"Judged by {valve['limits']['sentence']}."),
            *(
                [html.listing([f"Warning: {text}" for text in valve["warnings"]])]
                if valve["warnings"]
                else []
            ),
            *_events(valve),
            *_parameters(valve),
            html.heading(f"Evidence of {name}"),
            html.paragraph(ABOUT),
            *html.evidence(evidence.get(name, ())),
        ]
    return html.page(f"What the monitor says of {result['bag']}", sections, sources)


def _verdict(name: str, valve: Mapping[str, Any]) -> str:
    raised = [event for event in valve["events"] if event["state"] == "raised"]
    count = f"{len(raised)} event{'' if len(raised) == 1 else 's'}"
    lost = f"; {plural(valve['lost_blocks'], 'block')} lost" if valve["lost_blocks"] else ""
    return f"{name} at the end: {valve['health']['summary']}; {count} in the record{lost}."


def _events(valve: Mapping[str, Any]) -> list[str]:
    if not valve["events"]:
        return [html.paragraph("No event.")]
    rows: list[dict[str, object]] = [
        {
            "time, s": f"{event['t_s']:.1f}",
            "event": f"{event['severity']} {event['state']}: {event['kind'].replace('_', ' ')}",
            "what the monitor said": event["message"],
        }
        for event in valve["events"]
    ]
    return [html.table(list(rows[0]), rows, {"time, s"})]


def _parameters(valve: Mapping[str, Any]) -> list[str]:
    rows: list[dict[str, object]] = [
        {
            "parameter": name.replace("_", " "),
            "value at the end": with_interval(one["value"], one["std"], one["unit"]),
        }
        for name, one in valve["estimate"]["parameters"].items()
    ]
    return [html.table(list(rows[0]), rows), html.paragraph(f"{LEGEND}.")] if rows else []

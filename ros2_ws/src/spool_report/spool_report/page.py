"""Page that stands by itself: pictures and tables in one HTML file that needs no network and prints."""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Iterable, Sequence
from typing import Any

import matplotlib.pyplot as plt
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure
from spool_core.uncertainty import number

from spool_report.evidence.exhibit import Exhibit, LeftOut
from spool_report.outputs import provenance
from spool_report.terminal import Table

#: What marks a figure that can be zoomed into.
_ZOOM = '<figure class="zoom">'

#: Characters from which a cell holds a sentence.
LONG = 40

_TEMPLATES = Environment(loader=PackageLoader(__package__), autoescape=True, undefined=StrictUndefined)
_TEMPLATES.filters["number"] = number
_TEMPLATES.globals["long"] = LONG
_PARTS: Any = _TEMPLATES.get_template("parts.html").module


def page(title: str, sections: Iterable[str], sources: Sequence[tuple[str, str]] = ()) -> str:
    """Return the whole page.

    Args:
        title: of the page.
        sections: what the functions below return; other text is escaped.
        sources: label and value of what it was made from.
    """
    shown = list(sections)
    styles = programs = Markup()
    if any(_ZOOM in section for section in shown):
        style, program = plotter()
        styles = Markup(f"<style>{style}</style>")
        programs = Markup(f"<script>{program}</script><script>{_asset('viewer.js')}</script>")
    template = _TEMPLATES.get_template("page.html")
    return (
        template.render(
            title=title, sections=shown, sources=[*provenance(), *sources], styles=styles, programs=programs
        )
        + "\n"
    )


def plotter() -> tuple[str, str]:
    """Return style and program of uPlot, with its licence, for a page that needs no network."""
    licence = _asset("vendor/uplot/LICENSE")
    program = _asset("vendor/uplot/uPlot.iife.min.js").partition("*/")[2].strip()
    return _asset("vendor/uplot/uPlot.min.css"), f"/*! uPlot\n{licence}\n*/\n{program}"


def plain_numbers(row: Iterable[float]) -> list[float | None]:
    """Return numbers for JSON with as many digits as a screen shows, ``None`` for those not known."""
    return [float(f"{value:.5g}") if math.isfinite(value) else None for value in row]


def _asset(name: str) -> str:
    assert _TEMPLATES.loader is not None
    return _TEMPLATES.loader.get_source(_TEMPLATES, name)[0]


def rendered(template: str, **values: object) -> Markup:
    """Return a section from a template of this folder with ``values``, which are escaped."""
    return Markup(_TEMPLATES.get_template(template).render(**values))


def heading(text: str) -> Markup:
    """Return a heading."""
    return Markup(_PARTS.heading(text))


def paragraph(text: str) -> Markup:
    """Return a paragraph."""
    return Markup(_PARTS.paragraph(text))


def verdict(text: str) -> Markup:
    """Return the paragraph that a reader in a hurry reads."""
    return Markup(_PARTS.paragraph(text, "verdict"))


def listing(entries: Sequence[str]) -> Markup:
    """Return a list of lines."""
    return Markup(_PARTS.listing(entries))


def answers(pairs: Sequence[tuple[str, str]]) -> Markup:
    """Return questions of a reader in a hurry with their answers."""
    return Markup(_PARTS.answers(pairs))


def section(title: str, parts: Sequence[Markup]) -> Markup:
    """Return ``parts`` behind a heading that opens them; print shows all of it."""
    return Markup(_PARTS.section(title, parts))


def folded(summary: str, entries: Sequence[str]) -> Markup:
    """Return lines that show when ``summary`` is opened, and in print."""
    return Markup(_PARTS.folded(summary, entries))


def table(shown: Table) -> Markup:
    """Return a table below its title, if it has one; numbers are rounded to four digits."""
    if not shown.rows:
        return Markup()
    title = heading(shown.title) if shown.title else Markup()
    return title + Markup(_PARTS.table(shown.columns, shown.rows, shown.numbers))


def picture(figure: Figure, description: str, dpi: int = 130) -> tuple[Markup, bytes]:
    """Return the figure as HTML with its bytes in it, and as PNG; the figure is closed."""
    content = _drawn(figure, format="png", dpi=dpi)
    return Markup(_PARTS.picture(description, _address("image/png", content))), content


def drawing(figure: Figure, caption: str, seen: str = "") -> Markup:
    """Return the figure as HTML, as lines instead of pixels; the figure is closed.

    Args:
        figure: to draw.
        caption: stands below: how to read it.
        seen: what is to be seen in it, for those who cannot see it; the caption follows.
    """
    content = _drawn(figure, format="svg", dpi=200, metadata={"Date": None})
    address = _address("image/svg+xml", content)
    return Markup(_PARTS.drawing(f"{seen} {caption}".strip(), address, caption))


def evidence(items: Sequence[Exhibit | LeftOut]) -> list[Markup]:
    """Return pictures of evidence, each with how to read it and what it shows here; the figures are closed.

    A picture that could not be drawn is a sentence why.
    """
    found = []
    for item in items:
        found.append(Markup(_PARTS.minor_heading(item.title)))
        if isinstance(item, LeftOut):
            found.append(paragraph(f"Left out: {item.reason}."))
        else:
            found.append(_exhibited(item))
    return found


def _exhibited(item: Exhibit) -> Markup:
    content = _drawn(item.figure, format="svg", dpi=120, metadata={"Date": None})
    address = _address("image/svg+xml", content)
    caption = f"{item.seen} How to read it: {item.caption}"
    if not item.panels:
        return Markup(_PARTS.drawing(f"{item.title}: {item.seen}", address, caption))
    # What ends a script in HTML must not stand in one.
    numbers = json.dumps(
        [
            {
                "across": one.across,
                "up": one.up,
                "x": plain_numbers(one.x),
                "log_x": one.log_x,
                "log_y": one.log_y,
                "marks": [
                    [*plain_numbers([mark.time]), mark.text if mark.raised else f"{mark.text} over"]
                    for mark in one.marks
                ],
                "lines": [
                    {
                        "label": line.label,
                        "values": plain_numbers(line.values),
                        "colour": line.colour,
                        "dash": list(line.dash),
                        "width": line.width,
                        **({} if line.low is None else {"low": plain_numbers(line.low)}),
                        **({} if line.high is None else {"high": plain_numbers(line.high)}),
                    }
                    for line in one.lines
                ],
            }
            for one in item.panels
        ],
        allow_nan=False,
    ).replace("</", "<\\/")
    return Markup(_PARTS.zoomable(f"{item.title}: {item.seen}", address, caption, Markup(numbers)))


def _drawn(figure: Figure, **how: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, **how)
    plt.close(figure)
    return buffer.getvalue()


def _address(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"

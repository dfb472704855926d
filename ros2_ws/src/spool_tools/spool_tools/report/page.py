"""Page that stands by itself: pictures and tables in one HTML file that needs no network and prints."""

from __future__ import annotations

import base64
import io
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure
from spool_stream.uncertainty import number

from .provenance import provenance

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
    template = _TEMPLATES.get_template("page.html")
    return template.render(title=title, sections=list(sections), sources=[*provenance(), *sources]) + "\n"


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


def table(
    columns: Sequence[str], rows: Sequence[Mapping[str, object]], numbers: Collection[str] = ()
) -> Markup:
    """Return a table; numbers are rounded to four digits.

    Args:
        columns: names of the columns, in their order.
        rows: cells by the name of their column.
        numbers: columns whose texts are numbers.
    """
    return Markup(_PARTS.table(columns, rows, numbers))


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


def _drawn(figure: Figure, **how: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, **how)
    plt.close(figure)
    return buffer.getvalue()


def _address(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"

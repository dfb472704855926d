"""Pages that stand by themselves: pictures and tables in one HTML file that needs no network and prints."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Mapping, Sequence
from string import Template

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from spool_stream.uncertainty import number

from .provenance import provenance

#: Characters from which a cell holds a sentence.
LONG = 40

_PAGE = Template("""<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><title>$title</title><style>
:root{--ink:#222;--paper:#fff;--rule:#ccc;--quiet:#444;--mark:#0072B2}
@media (prefers-color-scheme:dark){:root{--ink:#e6e6e6;--paper:#16181c;--rule:#4a4f57;--quiet:#b4b9c0;
--mark:#56B4E9}}
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:var(--ink);
background:var(--paper);overflow-wrap:anywhere}
h1{font-size:1.7rem;line-height:1.25}
img{display:block;width:100%;min-width:36rem;height:auto;background:#fff;border-radius:.3rem}
table{border-collapse:collapse;margin:1rem 0;font-size:.9rem}td,th{padding:.25rem .7rem;
text-align:left;vertical-align:top;border-bottom:1px solid var(--rule);overflow-wrap:normal}
td.t{min-width:16rem}
td.n{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}
div.wide{overflow-x:auto}h2{margin-top:2.5rem}
p.verdict{font-size:1.15rem;border-left:4px solid var(--mark);padding-left:.8rem}
figure{margin:1.5rem 0}figcaption{font-size:.9rem;color:var(--quiet)}
footer{margin-top:3rem;border-top:1px solid var(--rule);font-size:.8rem;color:var(--quiet)}
footer dl{display:grid;grid-template-columns:max-content 1fr;gap:.1rem 1rem}
footer dt{font-weight:600}footer dd{margin:0;overflow-wrap:anywhere}
@media (max-width:30rem){body{margin:1rem auto;padding:0 .8rem}h1{font-size:1.35rem}
td,th{padding:.25rem .4rem}}
@page{size:A4;margin:15mm}
@media print{:root{--ink:#222;--paper:#fff;--rule:#ccc;--quiet:#444}
body{margin:0;max-width:none;padding:0;font-size:10.5pt}img{min-width:0}
figure,table,tr,p.verdict{break-inside:avoid}
h2{break-after:avoid}div.wide{overflow:visible}}</style></head><body>
<h1>$title</h1>$sections$foot</body></html>
""")


def page(title: str, sections: Iterable[str], sources: Sequence[tuple[str, str]] = ()) -> str:
    """Return the whole page; ``sections`` are HTML, ``sources`` label and value of what it was made from."""
    return _PAGE.substitute(title=html.escape(title), sections="".join(sections), foot=_foot(sources))


def _foot(sources: Sequence[tuple[str, str]]) -> str:
    rows = "".join(
        f"<dt>{html.escape(label)}</dt><dd>{html.escape(value)}</dd>"
        for label, value in (*provenance(), *sources)
    )
    return f"<footer><dl>{rows}</dl></footer>"


def heading(text: str) -> str:
    """Return a heading."""
    return f"<h2>{html.escape(text)}</h2>"


def paragraph(text: str) -> str:
    """Return a paragraph."""
    return f"<p>{html.escape(text)}</p>"


def verdict(text: str) -> str:
    """Return the paragraph that a reader in a hurry reads."""
    return f"<p class=verdict>{html.escape(text)}</p>"


def listing(entries: Sequence[str]) -> str:
    """Return a list of lines."""
    return "<ul>" + "".join(f"<li>{html.escape(entry)}</li>" for entry in entries) + "</ul>"


def table(columns: Sequence[str], rows: Sequence[Mapping[str, object]]) -> str:
    """Return a table; numbers are rounded to four digits."""
    head = "".join(f"<th>{html.escape(column)}</th>" for column in columns)
    body = "".join("<tr>" + "".join(_cell(row.get(column)) for column in columns) + "</tr>" for row in rows)
    return f"<div class=wide><table><tr>{head}</tr>{body}</table></div>"


def picture(figure: Figure, description: str) -> tuple[str, bytes]:
    """Return the figure as HTML with its bytes in it, and as PNG; the figure is closed."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130)
    plt.close(figure)
    content = buffer.getvalue()
    return _image(description, _data("image/png", content)), content


def drawing(figure: Figure, caption: str, seen: str = "") -> str:
    """Return the figure as HTML, as lines instead of pixels; the figure is closed.

    Args:
        figure: to draw.
        caption: stands below: how to read it.
        seen: what is to be seen in it, for those who cannot see it; the caption follows.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=200, metadata={"Date": None})
    plt.close(figure)
    image = _image(f"{seen} {caption}".strip(), _data("image/svg+xml", buffer.getvalue()))
    return f"<figure>{image}<figcaption>{html.escape(caption)}</figcaption></figure>"


def _image(description: str, address: str) -> str:
    """Return a picture that scrolls where the screen is too narrow to read it."""
    return f"<div class=wide><img alt='{html.escape(description, quote=True)}' src='{address}'></div>"


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"<td class=n>{number(value)}</td>"
    if value is None:
        return "<td></td>"
    text = str(value)
    # A long text gets room: in a table that scrolls it would stand in a column of single words.
    kind = " class=t" if len(text) > LONG else ""
    return f"<td{kind}>{html.escape(text)}</td>"

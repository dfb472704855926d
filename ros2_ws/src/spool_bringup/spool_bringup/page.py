"""Pages that stand by themselves: pictures and tables in one HTML file that needs no network and prints."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from string import Template

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

_PAGE = Template("""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>$title</title><style>
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}
img{width:100%}table{border-collapse:collapse;margin:1rem 0;font-size:.9rem}td,th{padding:.25rem .7rem;
text-align:left;border-bottom:1px solid #ccc}td.n{text-align:right;font-variant-numeric:tabular-nums}
div.wide{overflow-x:auto}h2{margin-top:2.5rem}p.verdict{font-size:1.15rem;border-left:4px solid #0072B2;
padding-left:.8rem}figure{margin:1.5rem 0}figcaption{font-size:.9rem;color:#444}
@page{size:A4;margin:15mm}
@media print{body{margin:0;max-width:none;padding:0;font-size:10.5pt}
figure,table,tr,p.verdict{break-inside:avoid}
h2{break-after:avoid}div.wide{overflow:visible}}</style></head><body>
<h1>$title</h1>$sections</body></html>
""")


def page(title: str, sections: Iterable[str]) -> str:
    """Return the whole page; ``sections`` are HTML."""
    return _PAGE.substitute(title=html.escape(title), sections="".join(sections))


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
    return f"<img alt='{html.escape(description)}' src='{_data('image/png', content)}'>", content


def drawing(figure: Figure, caption: str) -> str:
    """Return the figure as HTML, as lines instead of pixels, with ``caption`` below; the figure is closed."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=200, metadata={"Date": None})
    plt.close(figure)
    said = html.escape(caption, quote=True)
    return (
        f"<figure><img alt='{said}' src='{_data('image/svg+xml', buffer.getvalue())}'>"
        f"<figcaption>{said}</figcaption></figure>"
    )


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"<td class=n>{value:.4g}</td>" if math.isfinite(value) else "<td class=n>not known</td>"
    if value is None:
        return "<td></td>"
    return f"<td>{html.escape(str(value))}</td>"

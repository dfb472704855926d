"""The page that `./spool paper` writes: pictures, tables, and what they can and cannot say."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from string import Template

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

_PAGE = Template("""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>$title</title><style>
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}
img{width:100%}table{border-collapse:collapse;margin:1rem 0;font-size:.9rem}td,th{padding:.25rem .7rem;
text-align:left;border-bottom:1px solid #ccc}td.n{text-align:right;font-variant-numeric:tabular-nums}
div.wide{overflow-x:auto}h2{margin-top:2.5rem}</style></head><body>
<h1>$title</h1>$sections</body></html>
""")

#: What the comparison can tell, and what only the authors' measurements could.
CAN: tuple[str, ...] = (
    "The undamped natural frequencies, 15.15 and 28.68 Hz, and the viscous coefficients of equation "
    "(12), 8.20 and 2.65 N s/m: they follow from table 2.",
    "What each of the four equations does at 10 to 100 Hz with given parameters, the printed ones included.",
    "Which parameters a fit by (33) can tell apart. In model 1 only the product k_t (d_k0 - a_k0) acts, "
    "so the three columns of table 3 are one number; in model 3 with the drag of (12) K_V only changes "
    "the viscous coefficient to (1 - K_V) of it.",
    "Why model 4 beats models 1 and 3 in the printed tables although both contain it: h is fitted in "
    "model 4 only. With h fitted in all of them the larger models are never worse (last table).",
    "That the values of table 4 lock the spool (below).",
)
CANNOT: tuple[str, ...] = (
    "The printed objective values: they depend on the measured waveforms, their length and sigma, none "
    "of which is printed; (33) as printed is not squared, so that errors of opposite sign cancel, and "
    "its least value is no good fit.",
    "The printed ratios a_est/a_pom and the ranking of the models: they depend on the spool the authors "
    "measured. The ranking here is that of the truth stated above, which was chosen to be none of the "
    "four models.",
    "Figures 6 to 11 as numbers: neither the amplitudes of the shaker nor those of the spool are "
    "printed. Their shape, resonances and the influence of spring and oil can be compared.",
    "Table 7 from tables 3 to 6: the mean of model 2 agrees with its four entries; for model 1 the four "
    "entries average 6.21e7 where 6.27e7 is printed.",
    "The viscosities at 20 deg C: the printed ones are what these oils have at about 40 deg C. They are "
    "used as printed.",
)


def page(title: str, sections: Iterable[str]) -> str:
    """Return the whole page; ``sections`` are HTML."""
    return _PAGE.substitute(title=html.escape(title), sections="".join(sections))


def heading(text: str) -> str:
    """Return a heading."""
    return f"<h2>{html.escape(text)}</h2>"


def paragraph(text: str) -> str:
    """Return a paragraph."""
    return f"<p>{html.escape(text)}</p>"


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
    encoded = base64.b64encode(buffer.getvalue()).decode()
    return (
        f"<img alt='{html.escape(description)}' src='data:image/png;base64,{encoded}'>",
        buffer.getvalue(),
    )


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"<td class=n>{value:.4g}</td>" if math.isfinite(value) else "<td class=n>not known</td>"
    if value is None:
        return "<td></td>"
    return f"<td>{html.escape(str(value))}</td>"

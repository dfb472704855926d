"""Result page: tables of measurements, dated, with the version and the command that made them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path

from matplotlib.figure import Figure
from spool_tools.console.outputs import suite_version, write_json


def markdown_table(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown, a line a row."""
    lines = (head, ["---"] * len(head), *body)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def made_by(command: str) -> str:
    """Return the provenance of a page: date, version of the suite, and the command that makes it again."""
    today = datetime.now(timezone.utc).date().isoformat()
    return f"Made on {today} by `{command}`, version {suite_version()}."


def study_command(name: str, cases: int, seed: int) -> str:
    """Return the command of a study whose records are drawn from ``seed`` on."""
    return f"./spool study {name} --cases {cases} --seed {seed} --out DIR"


def write_page(page: Path, title: str, command: str, parts: Sequence[str]) -> Path:
    """Write a page in Markdown: title, provenance and ``parts``, blank lines between them; return it."""
    page.write_text("\n\n".join([f"# {title}", made_by(command), *parts]) + "\n", encoding="utf-8")
    return page


def renew_json(path: Path, value: object) -> None:
    """Write ``value`` as JSON in place of what the same study wrote there before."""
    path.unlink(missing_ok=True)
    write_json(path, value)


def save_picture(figure: Figure, path: Path, dpi: int = 130) -> Path:
    """Write ``figure`` as PNG; its bytes do not depend on the version of the library that draws."""
    figure.savefig(path, dpi=dpi, metadata={"Software": None})
    return path

"""Marked page: documentation whose part between two marks is written from the source, with pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from spool_evaluation.results.page import save_picture


@dataclass(frozen=True, slots=True)
class MarkedPage:
    """Page ``name``.md of a folder, with marks of its own and a folder ``pictures`` next to it."""

    name: str
    pictures: str

    @property
    def marks(self) -> tuple[str, str]:
        """Begin and end of the part that is written."""
        return f"<!-- {self.pictures}: begin -->", f"<!-- {self.pictures}: end -->"

    def written(self, folder: Path) -> str:
        """Return the part between the marks."""
        begin, end = self.marks
        return (folder / f"{self.name}.md").read_text(encoding="utf-8").partition(begin)[2].partition(end)[0]

    def write(self, folder: Path, text: str, figures: Mapping[str, Figure]) -> None:
        """Write ``text`` between the marks, and a PNG for each of ``figures``, by name."""
        begin, end = self.marks
        page = folder / f"{self.name}.md"
        before, _, rest = page.read_text(encoding="utf-8").partition(begin)
        page.write_text(f"{before}{begin}\n\n{text}\n{end}{rest.partition(end)[2]}", encoding="utf-8")
        (folder / self.pictures).mkdir(parents=True, exist_ok=True)
        for name, figure in figures.items():
            save_picture(figure, folder / self.pictures / f"{name}.png", dpi=90)
        print(f"{len(figures)} pictures, {page}")


def sentence(text: str) -> str:
    """Return ``text`` with a capital letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."

"""Results of studies: proportions with intervals, targets, dated pages, documentation between two marks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Literal

from matplotlib.figure import Figure
from scipy.stats import binomtest, chi2
from spool_report.outputs import suite_version, write_json

from spool_evaluation.results.stale import depends_on


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
    """Write a page in Markdown: title, provenance and ``parts``, blank lines between them; return it.

    The provenance names the packages that the numbers depend on: `./spool study stale` compares.
    """
    packages = ", ".join(f"`{name}`" for name in depends_on(command))
    parts = [made_by(command), f"Depends on {packages}.", *parts]
    page.write_text("\n\n".join([f"# {title}", *parts]) + "\n", encoding="utf-8")
    return page


def renew_json(path: Path, value: object) -> None:
    """Write ``value`` as JSON in place of what the same study wrote there before."""
    path.unlink(missing_ok=True)
    write_json(path, value)


def save_picture(figure: Figure, path: Path, dpi: int = 130) -> Path:
    """Write ``figure`` as PNG; its bytes do not depend on the version of the library that draws."""
    figure.savefig(path, dpi=dpi, metadata={"Software": None})
    return path


@dataclass(frozen=True, slots=True)
class MarkedPage:
    """Page ``name``.md of a folder, with its own marks and a folder ``pictures`` next to it."""

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
        """Write ``text`` between the marks in ``folder``, and a PNG for each of ``figures``, by name."""
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


#: Of every interval that is reported.
CONFIDENCE = 0.95

Method = Literal["exact", "wilson"]


def interval(count: int, of: int, method: Method) -> tuple[float, float]:
    """Return the 95 % interval of a proportion; 0 to 1 where nothing was counted.

    Args:
        count: hits.
        of: trials.
        method: "exact" is Clopper and Pearson's, which never covers less than it says; "wilson" covers 95 %
            on average.
    """
    if not of:
        return 0.0, 1.0
    found = binomtest(count, of).proportion_ci(CONFIDENCE, method)
    return float(found.low), float(found.high)


def poisson_interval(count: int) -> tuple[float, float]:
    """Return the exact 95 % interval of the mean of which ``count`` were counted (Garwood)."""
    tail = 0.5 - 0.5 * CONFIDENCE
    low = float(chi2.ppf(tail, 2 * count)) / 2.0 if count else 0.0
    return low, float(chi2.ppf(1.0 - tail, 2 * count + 2)) / 2.0


@dataclass(frozen=True, slots=True)
class Proportion:
    """Proportion of ``count`` in ``of``, shown with Wilson's 95 % interval."""

    count: int
    of: int

    @property
    def value(self) -> float | None:
        """The proportion, ``None`` of nothing."""
        return self.count / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        """Bounds within which the true proportion lies in 95 % of such studies."""
        return interval(self.count, self.of, "wilson")

    def __str__(self) -> str:
        if self.value is None:
            return "-"
        low, high = (100.0 * bound for bound in self.interval)
        return f"{self.count}/{self.of} = {100.0 * self.value:.1f} % ({low:.0f} to {high:.0f})"


@dataclass(frozen=True, slots=True)
class Target:
    """Target of a study: a proportion, what is wanted of it in words, and whether it is met."""

    name: str
    wanted: str
    share: Proportion
    met: bool

    @property
    def answer(self) -> str:
        """yes, no, or unknown where no case asked."""
        return ("yes" if self.met else "no") if self.share.of else "unknown"

    def to_dict(self) -> dict[str, object]:
        """Return what the JSON file holds of it."""
        return {
            "name": self.name,
            "wanted": self.wanted,
            "count": self.share.count,
            "of": self.share.of,
            "interval": list(self.share.interval),
            "met": self.met if self.share.of else None,
        }


def target_table(targets: Sequence[Target]) -> str:
    """Return the study's questions with their answers, Markdown."""
    rows = [(one.name, one.wanted, str(one.share), one.answer) for one in targets]
    return markdown_table(("question", "target", "found (95 % interval)", "met"), rows)

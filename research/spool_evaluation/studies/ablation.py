"""Ablation of the gap selection: what each of its stages is worth on blind cases."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from scipy.stats import binomtest
from spool_blind.case import make

from spool_evaluation.results.page import markdown_table, study_command, write_page
from spool_evaluation.studies.gap import BlindVerdict

from .gap import judge
from .workers import spread

PAGE, ROWS = "gap_ablation.md", "gap_ablation.jsonl"
#: Stages without which there is no selection.
NEEDED = frozenset(
    {
        "accept",
        "choose_candidate",
        "fit_base",
        "fit_candidates",
        "fit_whole_windows",
        "grow",
        "measure_ranking",
        "measure_whole_windows",
        "note_candidates",
        "polish",
        "rank_candidates",
        "screen_by_regression",
    }
)
#: Stages that change starts and candidates, not the choice, so that no trace shows what they do.
UNSEEN = ("screen_residual", "start_from_contained", "start_from_best_law", "free_sensors")
#: Every so many cases are analysed without those.
SPARSE = 4
#: Share of the cases that a stage must be worth to stay, and cases from which that is decided: a stage that
#: gains nothing in so many is worth less than 0.9 % (95 %, Clopper and Pearson).
WORTH, ENOUGH = 1.0 / 200.0, 400
ABOUT = (
    "Each case is analysed by the workflow as it ships; a trace tells which stages changed the choice of "
    "effects. Then each of those cases is analysed again without that stage, and the verdicts are compared. "
    "Stages that change where fits start leave no trace: they are left out of every "
    f"{SPARSE}th case. *Gained* are cases that are right with the stage and wrong without it, *lost* the "
    "other way round; worth is their difference over the cases that were looked at, p the sign test of both."
)


@dataclass(frozen=True, slots=True)
class Trial:
    """Verdict on the blind case ``seed`` without the stage ``without``; empty: with all of them."""

    seed: int
    without: str
    hidden: str
    verdict: str
    right: bool
    changed_by: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StageWorth:
    """Worth of a stage: in how many of ``cases`` it ``changed`` the choice, and what came of it."""

    stage: str
    cases: int
    changed: int
    gained: int
    lost: int

    @property
    def worth(self) -> float:
        """Cases gained less cases lost, as a share."""
        return (self.gained - self.lost) / self.cases if self.cases else 0.0

    @property
    def stays(self) -> str:
        """Whether the stage is worth enough to stay."""
        if self.worth >= WORTH:
            return "yes"
        return "no" if self.cases >= ENOUGH else "not decided"

    @property
    def p(self) -> float:
        """Probability of a difference like this by chance, two-sided."""
        moved = self.gained + self.lost
        return float(binomtest(self.gained, moved).pvalue) if moved else 1.0


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[StageWorth]:
    """Analyse ``cases`` blind cases from ``seed`` on, and again without each stage that mattered.

    ``out`` gets the page; what its rows hold already is not analysed again.
    """
    out.mkdir(parents=True, exist_ok=True)
    kept = out / ROWS
    found = {(trial.seed, trial.without): trial for trial in _kept(kept)}
    seeds = range(seed, seed + cases)
    with kept.open("a") as file:

        def take(trials: Iterable[Trial]) -> None:
            for trial in trials:
                found[trial.seed, trial.without] = trial
                file.write(json.dumps(asdict(trial)) + "\n")
                file.flush()

        first = [(number, "") for number in seeds if (number, "") not in found]
        take(spread(attempt, first, f"{len(first)} blind cases", workers))
        again = [item for item in _again([found[number, ""] for number in seeds]) if item not in found]
        take(spread(attempt, again, f"{len(again)} cases without a stage", workers))
    rows = worths([trial for trial in found.values() if trial.seed in seeds])
    page = write_page(
        out / PAGE,
        "Ablation of the gap selection",
        study_command("ablation", cases, seed),
        parts(rows, cases),
    )
    print(page.read_text())
    return rows


def _kept(path: Path) -> list[Trial]:
    if not path.exists():
        return []
    lines = [line for line in path.read_text().splitlines() if line.endswith("}")]
    rows = [json.loads(line) for line in lines]
    return [Trial(**{**row, "changed_by": tuple(row["changed_by"])}) for row in rows]


def attempt(item: tuple[int, str], look: Callable[..., BlindVerdict] = judge) -> Trial:
    """Return the verdict on the case of a seed without a stage, ``item``."""
    seed, without = item
    row = look(make(seed), frozenset({without} if without else ()))
    return Trial(seed, without, row.hidden, row.verdict, row.right, row.changed_by)


def _again(first: Sequence[Trial]) -> list[tuple[int, str]]:
    """Return what is to be analysed without a stage: (seed, stage)."""
    seen = [(trial.seed, stage) for trial in first for stage in trial.changed_by if stage not in NEEDED]
    return seen + [(trial.seed, stage) for trial in first[::SPARSE] for stage in UNSEEN]


def worths(trials: Sequence[Trial]) -> list[StageWorth]:
    """Return what each stage is worth, the least first."""
    whole = {trial.seed: trial for trial in trials if not trial.without}
    without: dict[str, list[Trial]] = {}
    for trial in trials:
        if trial.without and trial.seed in whole:
            without.setdefault(trial.without, []).append(trial)
    rows = []
    for stage, these in without.items():
        gained = sum(whole[one.seed].right and not one.right for one in these)
        lost = sum(one.right and not whole[one.seed].right for one in these)
        rows.append(
            StageWorth(stage, len(these) if stage in UNSEEN else len(whole), len(these), gained, lost)
        )
    return sorted(rows, key=lambda row: (row.worth, row.stage))


def parts(rows: Sequence[StageWorth], cases: int) -> list[str]:
    """Return the page's paragraphs and its table, Markdown."""
    body = [
        (
            row.stage.replace("_", " "),
            str(row.changed),
            str(row.gained),
            str(row.lost),
            f"{100.0 * row.worth:+.2f} %",
            f"{row.p:.2f}",
            row.stays,
        )
        for row in rows
    ]
    head = ("stage", "left out of", "gained", "lost", "worth", "p", f"worth {100.0 * WORTH:.1f} %")
    return [f"{cases} cases. {ABOUT}", markdown_table(head, body)]

"""Counts over blind cases: verdicts, targets, confusion matrix."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from spool_evaluation.results.proportion import Proportion

#: Share of the true value within which a fitted parameter counts as recovered.
RECOVERED = 0.10
#: The gap that is left counts as closed up to this many times the noise floor.
CLOSED = 1.3


@dataclass(frozen=True, slots=True)
class BlindVerdict:
    """Verdict of the workflow on one blind case, with its truth.

    Attributes:
        seed, kind, hidden, accepted: of the case; see :mod:`spool_blind.case`.
        factor: size of what is hidden over the size that was drawn.
        verdict: what was said; "refused" where the record was.
        candidates: the class that was named together with "unexplained".
        confidence: 0 to 1.
        truth, found: values of the parameters by "effect.parameter"; SI.
        before, after, floor: held-out gap and noise floor, rms over rms; ``None`` where unknown.
        seconds: taken by the workflow.
        processor_seconds: of them spent computing, which other work on the machine does not change.
        visible: remainder after the base over the noise floor; ``None`` where nothing is hidden.
        evidence, threshold: of the likelihood-ratio test that knows what is hidden.
        condition: excitation, spring, rate and so on, for looking up.
        message: why it was refused.
        changed_by: stages of the selection that changed the choice.
    """

    seed: int
    kind: str
    hidden: str
    accepted: tuple[str, ...]
    factor: float
    verdict: str
    candidates: tuple[str, ...] = ()
    confidence: float | None = None
    truth: dict[str, float] = field(default_factory=dict)
    found: dict[str, float] = field(default_factory=dict)
    before: float | None = None
    after: float | None = None
    floor: float | None = None
    seconds: float = 0.0
    processor_seconds: float = 0.0
    visible: float | None = None
    evidence: float | None = None
    threshold: float | None = None
    condition: str = ""
    message: str = ""
    changed_by: tuple[str, ...] = ()

    @property
    def right(self) -> bool:
        """Whether the verdict is one of those accepted; out of the catalogue a part may be unexplained."""
        said = frozenset(self.verdict.split("+"))
        if self.kind == "out_of_catalogue":
            return "unexplained" in said
        return any(said == frozenset(one.split("+")) for one in self.accepted)

    @property
    def errors(self) -> dict[str, float]:
        """Relative errors of the parameters that are known and were found."""
        return {
            name: self.found[name] / true - 1.0
            for name, true in self.truth.items()
            if name in self.found and true != 0.0
        }

    def to_dict(self) -> dict[str, Any]:
        """Return what the JSON file holds of it."""
        return {**asdict(self), "right": self.right, "errors": self.errors}


@dataclass(frozen=True, slots=True)
class Target:
    """Target of the study: a proportion and what is wanted of it."""

    name: str
    wanted: str
    share: Proportion
    met: bool

    @property
    def answer(self) -> str:
        """yes, no, or unknown where no case asked."""
        return ("yes" if self.met else "no") if self.share.of else "unknown"


def share_of(rows: Sequence[BlindVerdict], right: Callable[[BlindVerdict], bool]) -> Proportion:
    """Return how many of ``rows`` are ``right``."""
    return Proportion(sum(right(row) for row in rows), len(rows))


def targets(rows: Sequence[BlindVerdict]) -> list[Target]:
    """Return the study's questions with their answers."""

    def of(kind: str) -> list[BlindVerdict]:
        return [row for row in rows if row.kind == kind]

    named = [row for row in rows if row.kind in ("effect", "pair") and row.right]
    errors = [error for row in named for error in row.errors.values()]
    judged = [row for row in rows if row.right and row.kind != "out_of_catalogue" and row.after and row.floor]
    wrong = share_of(of("none"), lambda row: not row.right)
    single, pairs = share_of(of("effect"), lambda row: row.right), share_of(of("pair"), lambda row: row.right)
    outsiders = share_of(of("out_of_catalogue"), lambda row: row.right)
    recovered = Proportion(sum(abs(error) <= RECOVERED for error in errors), len(errors))
    closed = share_of(judged, lambda row: (row.after or 0.0) <= CLOSED * (row.floor or 0.0))
    return [
        Target("one effect, named right", "at least 98 %", single, (single.value or 0.0) >= 0.98),
        Target("nothing hidden, a false name", "at most 1 %", wrong, (wrong.value or 0.0) <= 0.01),
        Target(
            "two effects, both named and nothing else", "at least 95 %", pairs, (pairs.value or 0.0) >= 0.95
        ),
        Target(
            "out-of-catalogue effects not given a name alone",
            "at least 80 %",
            outsiders,
            (outsiders.value or 0.0) >= 0.80,
        ),
        Target("parameters within 10 %", "all", recovered, recovered.count == recovered.of),
        Target("gap after at most 1.3 times the floor", "all", closed, closed.count == closed.of),
    ]


def confusion(
    rows: Sequence[BlindVerdict],
) -> tuple[list[str], list[str], np.ndarray[Any, np.dtype[np.int64]]]:
    """Return (hidden, verdicts, counts) of cases with one thing hidden or none; pairs as "pair"."""

    def hidden_of(row: BlindVerdict) -> str:
        return "pair" if row.kind == "pair" else row.hidden

    def verdict_of(row: BlindVerdict) -> str:
        said = row.verdict.split("+")
        if row.kind == "pair":
            return (
                "right pair"
                if row.right
                else "part of it"
                if set(said) < set(row.hidden.split("+"))
                else "other"
            )
        if len(said) == 1:
            return row.verdict
        return "unexplained" if row.kind == "out_of_catalogue" and row.right else "more than one"

    order = {"none": 0, "effect": 1, "pair": 2, "out_of_catalogue": 3}
    names = sorted({(order[row.kind], hidden_of(row)) for row in rows})
    hidden = [name for _, name in names]
    last = ("more than one", "unexplained", "right pair", "part of it", "other", "refused", "failed")
    said = {verdict_of(row) for row in rows}
    verdicts = [name for name in hidden if name in said and name not in last]
    verdicts += sorted(said - set(verdicts) - set(last)) + [name for name in last if name in said]
    counts = np.zeros((len(hidden), len(verdicts)), dtype=np.int64)
    for (name, verdict), count in Counter((hidden_of(row), verdict_of(row)) for row in rows).items():
        counts[hidden.index(name), verdicts.index(verdict)] = count
    return hidden, verdicts, counts

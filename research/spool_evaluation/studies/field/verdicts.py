"""Counts over field cases: right, over-cautious, false, missed; by what is hidden and by nuisance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from matplotlib.figure import Figure
from spool_blind.field.case import Importance
from spool_gap.catalogue import EFFECTS, group_of

from spool_evaluation.results.page import Proportion, Target

UNEXPLAINED, NONE = "unexplained", "none"
REFUSED, FAILED = "refused", "failed"
#: Laws of no catalogue that are linear.
LINEAR = ("spring_surge", "oil_chamber")
#: Ids of groups of effects, as verdicts have them.
GROUPS = frozenset(entry.group.replace(" ", "_") for entry in EFFECTS.values())
RIGHT, OVER_CAUTIOUS, FALSE, MISSED, NO_VERDICT = "right", "over-cautious", "false", "missed", "no verdict"
OUTCOMES = (RIGHT, OVER_CAUTIOUS, FALSE, MISSED, NO_VERDICT)
#: The workflow's task, by what matters in the record.
NOTHING, ONE, TWO, OUTSIDE, UNIMPORTANT = (
    "nothing hidden", "one effect", "two effects", "out-of-catalogue law", "not of importance",
)  # fmt: skip
QUESTIONS = (NOTHING, ONE, TWO, OUTSIDE, UNIMPORTANT)
#: Names of the channels' truth in the catalogue, where they differ.
CATALOGUE_NAMES = {"gain_error": "spool_gain_error", "delay": "spool_delay", "full_scale": "saturation_limit"}
#: Numbers of a drag that warms: an exponential's rate is that of its beginning, a line's that of all.
DRIFT_RATE, DRIFT_TIME = "damping_drift.damping_drift_rate", "damping_drift.damping_drift_time"
#: Standard deviations of a 95 % interval.
Z_95 = 1.96


@dataclass(frozen=True, slots=True)
class ChainFault:
    """Nuisance of the measuring chain, as it was drawn or as it was told."""

    id: str
    channel: str
    size: float | None
    unit: str


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Why a verdict is wrong.

    Attributes:
        reason: see :mod:`spool_evaluation.studies.field.instrument`.
        advantage: evidence of the truth less that of the answer; ``None`` where no truth was fitted.
        again: verdict with both among the fits, empty where no truth was fitted.
    """

    reason: str
    advantage: float | None = None
    again: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldVerdict:
    """Verdict of the workflow on one field case, with its truth.

    Attributes:
        seed, kind, hidden, accepted: of the case; see :class:`~spool_blind.field.case.FieldCase`.
        verdict: the verdict given; "refused" where the record was refused, "failed" where no verdict came.
        candidates: the class that was named together with "unexplained".
        confidence: 0 to 1.
        truth: values of the parameters by "effect.parameter"; SI.
        found: the fitted ones with their standard deviations, ``None`` where that is not known.
        before, after, floor: held-out gap and noise floor, rms over rms; ``None`` where unknown.
        seconds: taken by the workflow.
        processor_seconds: of them spent computing, which other work on the machine does not change.
        condition: excitation, spring, rate and so on, for looking up.
        message: why it was refused.
        window: of its seed; see :mod:`spool_blind.field.case`.
        importance: of each hidden effect.
        nuisances, told: of the measuring chain, drawn and as the workflow told them.
        sampled: kind of the loggers' filters, see ``FieldCase.sampled``; empty in rows of older versions.
        explained: effects of each explanation that has a name, the most probable first.
        signs: what the confidence went by.
        diagnosis: why it is wrong, where that was asked for.
    """

    JSON_PROPERTIES: ClassVar = ("outcome", "question")

    seed: int
    kind: str
    hidden: str
    accepted: tuple[str, ...]
    verdict: str
    candidates: tuple[str, ...] = ()
    confidence: float | None = None
    truth: dict[str, float] = field(default_factory=dict)
    found: dict[str, tuple[float, float | None]] = field(default_factory=dict)
    before: float | None = None
    after: float | None = None
    floor: float | None = None
    seconds: float = 0.0
    processor_seconds: float = 0.0
    condition: str = ""
    message: str = ""
    window: str
    importance: dict[str, Importance]
    nuisances: tuple[ChainFault, ...]
    told: tuple[ChainFault, ...] = ()
    sampled: str = ""
    explained: tuple[tuple[str, ...], ...] = ()
    signs: dict[str, float | None] = field(default_factory=dict)
    diagnosis: Diagnosis | None = None

    @property
    def said(self) -> frozenset[str]:
        """Return the names of the verdict, without ``none``."""
        return frozenset(self.verdict.split("+")) - {NONE}

    @property
    def outcome(self) -> str:
        """One of ``OUTCOMES``.

        Over-cautious: the names are right, and the verdict reports a false remainder; or it names a group
        for several names that hold the right one. False: a name of what is not there. Missed: names are
        missing, and none is false.
        """
        if self.verdict in (REFUSED, FAILED):
            return NO_VERDICT
        right = self._right
        names = self.said - {UNEXPLAINED}
        if self.said in right:
            return RIGHT
        if names & GROUPS:
            return OVER_CAUTIOUS if self.set_right else FALSE
        if UNEXPLAINED in self.said:
            if frozenset({UNEXPLAINED}) in right and self.kind == "out_of_catalogue":
                return RIGHT
            if names in right:
                return OVER_CAUTIOUS
        return FALSE if names - frozenset().union(*right) else MISSED

    @property
    def _right(self) -> list[frozenset[str]]:
        return [frozenset(one.split("+")) - {NONE} for one in self.accepted]

    @property
    def explanations(self) -> list[frozenset[str]]:
        """Names of each explanation; of the verdict where nothing else is known."""
        return [frozenset(one) for one in self.explained] or [self.said - {UNEXPLAINED}]

    @property
    def set_right(self) -> bool:
        """Whether the truth is among the explanations."""
        return self.verdict not in (REFUSED, FAILED) and any(one in self._right for one in self.explanations)

    @property
    def anomaly_right(self) -> bool:
        """Whether a law of no catalogue that is linear was told as a resonance of no known place."""
        told = any(one.id == "extra_mode" for one in self.told)
        return self.hidden in LINEAR and told and self.outcome != FALSE

    @property
    def first_right(self) -> bool:
        """Whether the most probable explanation is the truth."""
        return self.verdict not in (REFUSED, FAILED) and self.explanations[0] in self._right

    @property
    def group_right(self) -> bool:
        """Whether the most probable explanation is of the right group on the machine."""
        said = group_of(self.explanations[0])
        return self.verdict not in (REFUSED, FAILED) and any(said == group_of(one) for one in self._right)

    @property
    def single(self) -> bool:
        """Whether one explanation alone is given, with a name."""
        return len(self.explanations) == 1 and bool(self.explanations[0])

    @property
    def question(self) -> str:
        """One of ``QUESTIONS``."""
        matter = [name for name, one in self.importance.items() if one.matters]
        if not self.importance:
            return NOTHING
        if not matter:
            return UNIMPORTANT
        if self.kind == "out_of_catalogue":
            return OUTSIDE
        return ONE if len(matter) == 1 else TWO

    @property
    def names_right(self) -> bool:
        """Whether all names are right, whatever remainder the verdict reports besides."""
        return self.outcome in (RIGHT, OVER_CAUTIOUS)

    @property
    def within(self) -> dict[str, bool]:
        """Whether the 95 % interval of each parameter that is known and was found holds the truth."""
        if not self.names_right:
            return {}
        return {
            name: abs(self.found[name][0] - true) <= Z_95 * deviation
            for name, true in self.truth.items()
            if name in self.found
            and self._comparable(name)
            and (deviation := self.found[name][1]) is not None
        }

    def _comparable(self, name: str) -> bool:
        """Whether ``name`` means the same in truth and result: a rate belongs to its time constant."""
        return name != DRIFT_RATE or (DRIFT_TIME in self.truth) == (DRIFT_TIME in self.found)


def by_parameter(truth: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return true values by "effect.parameter", in the names of the catalogue."""
    return {
        f"{effect}.{CATALOGUE_NAMES.get(name, name)}": value
        for effect, values in truth.items()
        for name, value in values.items()
    }


def counted(rows: Iterable[FieldVerdict]) -> dict[str, Proportion]:
    """Return how many of ``rows`` end in each outcome."""
    listed = list(rows)
    return {
        outcome: Proportion(sum(row.outcome == outcome for row in listed), len(listed))
        for outcome in OUTCOMES
    }


def by_nuisance(rows: Sequence[FieldVerdict]) -> dict[str, list[FieldVerdict]]:
    """Return the rows with each nuisance, by its id; first those without any, last by logger's filter."""
    groups = {"no nuisance": [row for row in rows if not row.nuisances]}
    groups["any nuisance"] = [row for row in rows if row.nuisances]
    for name in sorted({one.id for row in rows for one in row.nuisances}):
        groups[name] = [row for row in rows if any(one.id == name for one in row.nuisances)]
    for kind in sorted({row.sampled for row in rows} - {""}):
        groups[f"logger's filter: {kind}"] = [row for row in rows if row.sampled == kind]
    return groups


def told_of(rows: Sequence[FieldVerdict], name: str) -> tuple[Proportion, Proportion]:
    """Return in how many records the nuisance ``name`` was told: of those with it, and of those without."""
    there = [row for row in rows if row.verdict not in (REFUSED, FAILED)]
    having = [row for row in there if any(one.id == name for one in row.nuisances)]
    without = [row for row in there if row not in having]

    def told(these: Sequence[FieldVerdict]) -> Proportion:
        return Proportion(sum(any(one.id == name for one in row.told) for row in these), len(these))

    return told(having), told(without)


def field_targets(rows: Sequence[FieldVerdict]) -> list[Target]:
    """Return the study's questions with their answers."""

    def share(question: str, right: Callable[[FieldVerdict], bool]) -> Proportion:
        these = [row for row in rows if row.question == question]
        return Proportion(sum(right(row) for row in these), len(these))

    def asked(question: str, least: float, share: Proportion) -> Target:
        return Target(question, f"at least {least:.0%}", share, (share.value or 0.0) >= least)

    effects = [row for row in rows if row.question in (ONE, TWO)]
    alone = [row for row in effects if row.single]
    held = Proportion(sum(row.set_right for row in effects), len(effects))
    grouped = Proportion(sum(row.group_right for row in effects), len(effects))
    sure = Proportion(sum(row.set_right for row in alone), len(alone))
    first = share(TWO, lambda row: row.first_right)
    inside = [one for row in rows for one in row.within.values()]
    cover = Proportion(sum(inside), len(inside))
    false = share(NOTHING, lambda row: row.outcome == FALSE)
    unnamed = share(OUTSIDE, lambda row: row.outcome != FALSE)
    said = share(OUTSIDE, lambda row: row.outcome == RIGHT or row.anomaly_right)
    return [
        asked("one effect of importance, its name right", 0.95, share(ONE, lambda row: row.names_right)),
        asked("two effects of importance, both names right", 0.85, share(TWO, lambda row: row.names_right)),
        asked("effects of importance, the explanations hold the truth", 0.95, held),
        asked("effects of importance, the right group", 0.95, grouped),
        asked("effects of importance, a single name that is right", 0.95, sure),
        asked("effects of importance, a single name is given", 0.75, Proportion(len(alone), len(effects))),
        asked("two effects of importance, both in the first explanation", 0.80, first),
        Target("nothing hidden, a false name", "at most 1%", false, (false.value or 0.0) <= 0.01),
        asked("nothing hidden, `none` said", 0.95, share(NOTHING, lambda row: row.outcome == RIGHT)),
        asked("out-of-catalogue laws not given a name alone", 0.95, unnamed),
        asked("out-of-catalogue laws said to be unexplained, or linear ones a resonance", 0.85, said),
        Target(
            "95 % intervals that hold the truth", "92% to 98%", cover, 0.92 <= (cover.value or 0.0) <= 0.98
        ),
    ]


#: Verdicts of a decile from which its share says anything.
ENOUGH = 20


@dataclass(frozen=True, slots=True)
class Decile:
    """Decile of the confidences from ``low`` to ``low`` + 0.1: their ``mean``, and the ``share`` right."""

    low: float
    mean: float
    share: Proportion

    @property
    def agrees(self) -> bool:
        """Whether the mean confidence lies within the interval of the share right."""
        low, high = self.share.interval
        return low <= self.mean <= high


@dataclass(frozen=True, slots=True)
class Brier:
    """Brier scores of ``count`` verdicts: mean square of confidence less outcome, 0 is best.

    ``base_rate`` is the score of who always says the share that is right.
    """

    verdicts: str
    count: int
    score: float
    base_rate: float


def deciles(rows: Sequence[FieldVerdict]) -> list[Decile]:
    """Return the deciles that have verdicts, the least confident first."""
    found = []
    for tenth in range(10):
        these = [row for row in _sure(rows) if min(9, int(10.0 * (row.confidence or 0.0) + 1e-9)) == tenth]
        if these:
            mean = sum(row.confidence or 0.0 for row in these) / len(these)
            share = Proportion(sum(row.outcome == RIGHT for row in these), len(these))
            found.append(Decile(tenth / 10.0, mean, share))
    return found


def brier_scores(rows: Sequence[FieldVerdict]) -> list[Brier]:
    """Return the scores of all verdicts, and by kind of verdict."""
    kinds = {
        "all": _sure(rows),
        "`none`": [row for row in _sure(rows) if row.verdict == NONE],
        "`unexplained`": [row for row in _sure(rows) if row.verdict == UNEXPLAINED],
        "names": [row for row in _sure(rows) if row.said and UNEXPLAINED not in row.said],
        "names with `unexplained`": [
            row for row in _sure(rows) if UNEXPLAINED in row.said and len(row.said) > 1
        ],
    }
    return [_brier(name, these) for name, these in kinds.items() if these]


def _brier(name: str, rows: Sequence[FieldVerdict]) -> Brier:
    hits = [float(row.outcome == RIGHT) for row in rows]
    base = sum(hits) / len(hits)
    pairs = zip(rows, hits, strict=True)
    score = sum(((row.confidence or 0.0) - hit) ** 2 for row, hit in pairs) / len(hits)
    return Brier(name, len(hits), score, base * (1.0 - base))


def _sure(rows: Sequence[FieldVerdict]) -> list[FieldVerdict]:
    return [row for row in rows if row.confidence is not None]


def reliability_figure(rows: Sequence[FieldVerdict]) -> Figure:
    """Return the reliability diagram: share right over mean confidence, with 95 % intervals and counts."""
    figure = Figure(figsize=(4.6, 4.2), layout="constrained")
    axis = figure.subplots()
    axis.plot([0.0, 1.0], [0.0, 1.0], color="0.6", linewidth=1.0, linestyle="--")
    for decile in deciles(rows):
        low, high = decile.share.interval
        value = decile.share.value or 0.0
        axis.plot([decile.mean, decile.mean], [low, high], color="tab:blue", linewidth=1.5)
        axis.plot(decile.mean, value, "o", color="tab:blue")
        axis.annotate(str(decile.share.of), (decile.mean, high), ha="center", va="bottom", fontsize=8)
    axis.set_xlim(0.0, 1.02)
    axis.set_ylim(0.0, 1.08)
    axis.set_xlabel("confidence, mean of a decile")
    axis.set_ylabel("share right")
    return figure

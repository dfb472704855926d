"""Instrument of the field study: why a verdict is wrong, inside the run that gave it.

Everything that the search fitted is kept. The truth (its effects, from the true numbers) is fitted in the
same predictions by the same fits, with the measuring chain that was drawn, with that of the answer, and
without any, also from the answer's numbers. The answer is fitted as often, also from the true numbers. Then
the same decision is made again, with these fits among the others: as if the search had missed nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table
from spool_blind.field.case import FieldCase
from spool_blind.hidden import NONE
from spool_core.errors import InputError
from spool_estimator.identification.chain import CHAIN_PARTS
from spool_estimator.identification.record import Record
from spool_gap.catalogue import EFFECTS
from spool_gap.evidence.analyse import Run
from spool_gap.likelihood.search import Key
from spool_gap.likelihood.structure import DELAY, GAIN, Structure, structure_of
from spool_gap.likelihood.structure_fit import DECISIVE, StructureFit
from spool_sim.valve import Valve

from spool_evaluation.results.page import markdown_table, write_page
from spool_evaluation.studies.field.verdicts import (
    NO_VERDICT,
    OUTSIDE,
    RIGHT,
    UNEXPLAINED,
    ChainFault,
    Diagnosis,
    FieldVerdict,
    by_parameter,
)

PAGE, TITLE = "field_diagnosis.md", "Why verdicts of the field study are wrong"
SATURATION = "sensor_saturation"
NEVER, MINIMUM, CHAIN, OVERRULED, LIKELIHOOD, REFUSED, DETECTOR, LAW = (
    "never fitted", "wrong minimum", "wrong chain", "overruled", "likelihood", "refused", "detector",
    "law of no catalogue",
)  # fmt: skip
MEANINGS = {
    NEVER: "with the truth among the fits the verdict is right; the search never fitted its effects",
    CHAIN: "the same, but the search fitted these effects with another measuring chain only",
    MINIMUM: "the same, but the search fitted the true structure and ended in another minimum",
    OVERRULED: "the truth is decisively more likely, and the rules of the decision choose another verdict",
    LIKELIHOOD: "the answer is as likely as the truth, or likelier",
    REFUSED: "the record was refused, or its analysis failed",
    DETECTOR: "only whether a sensor clips is wrong: no fit decides that",
    LAW: "the hidden law is in no catalogue: there is no true structure to fit",
}
#: Option that the message names where cells are empty.
EMPTY = "--empty-as-gap"


def diagnosed(case: FieldCase, row: FieldVerdict, run: Run | None) -> Diagnosis | None:
    """Return why ``row``, the verdict on ``case`` by ``run``, is wrong; ``None`` where it is right."""
    if row.outcome == RIGHT:
        return None
    if row.outcome == NO_VERDICT or run is None:
        return Diagnosis(REFUSED)
    if row.question == OUTSIDE:
        return Diagnosis(LAW)
    if (row.said - {UNEXPLAINED}) ^ (frozenset(row.hidden.split("+")) - {NONE}) == {SATURATION}:
        return Diagnosis(DETECTOR)
    search = run.search
    with run.apart():
        known = set(search.fits)
        answer = search.of_each_set[_as_fitted(run.decided().fit.structure.effects)].structure
        truth = true_structure(case, run)
        true = _fitted(run, truth, answer)
        said = _fitted(run, answer, truth)
        decision = run.decided()
        again = run.words(decision, run.judged(decision)).verdict
    lead = true.evidence - said.evidence
    same = replace(row, verdict=again, explained=()).outcome == RIGHT
    return Diagnosis(reason(known, true.structure.key, lead, right_again=same), lead, again)


def reason(known: Collection[Key], truth: Key, lead: float, *, right_again: bool) -> str:
    """Return the class of a wrong verdict.

    Args:
        known: structures that the search had fitted.
        truth: the likeliest structure with the true effects.
        lead: evidence of the truth less that of the answer, both fitted alike.
        right_again: the same decision is right with both among the fits.
    """
    if not right_again:
        return OVERRULED if lead > DECISIVE else LIKELIHOOD
    if all(effects != truth[0] for effects, _ in known):
        return NEVER
    return MINIMUM if truth in known else CHAIN


def true_structure(case: FieldCase, run: Run) -> Structure:
    """Return what was hidden in ``case`` with the parts of its measuring chain, and its numbers."""
    numbers = {name.partition(".")[2]: value for name, value in by_parameter(case.truth).items()}
    if "forward_force" in numbers:
        numbers["coulomb_force"] = 0.5 * (numbers["forward_force"] + numbers["backward_force"])
    numbers |= {
        "spring_stiffness": case.plant["stiffness"],
        "viscous_coefficient": case.plant["damping"],
        GAIN: case.chain.gain - 1.0,
        DELAY: case.chain.delay,
    }
    faults = [ChainFault(one.id, one.channel, one.size, one.unit) for one in case.nuisances]
    for fault in faults:
        if fault.id == "extra_mode" and fault.size is not None:
            numbers |= {f"{channel}_mode_frequency": fault.size for channel in _channels(fault)}
    hidden = [name for name in case.hidden.split("+") if name in EFFECTS and EFFECTS[name].terms]
    parts = dict.fromkeys(key for fault in faults for key in _keys(fault))
    valve = run.predictions.parts[0].valve
    return structure_of(run.base, valve, sorted(_as_fitted(hidden)), tuple(parts), numbers)


def diagnosis_page(rows: Sequence[FieldVerdict], out: Path, command: str) -> Path:
    """Print a table of the wrong verdicts among ``rows`` and write the page into ``out``."""
    counts = Counter(row.diagnosis.reason for row in rows if row.diagnosis)
    table = Table("reason", "cases", "meaning", box=None, pad_edge=False)
    for name, meaning in MEANINGS.items():
        table.add_row(name, str(counts[name]), meaning)
    Console(width=140).print(table)
    page = write_page(out / PAGE, TITLE, command, _parts(rows, counts))
    print(f"{page}: each wrong verdict with its reason")
    return page


def stretches_as_told(record: Path, valve_file: Path) -> tuple[list[Record], Valve]:
    """Return the stretches of the files of a case, read as `./spool gap` does and as its message says.

    Raises:
        InputError: the record is refused.
    """
    # slow to load, and counting needs none of their kernels
    from spool_bag.importing.bag_import import import_record  # noqa: PLC0415
    from spool_bag.importing.choices import choices  # noqa: PLC0415
    from spool_estimator.identification.record import LARGEST  # noqa: PLC0415
    from spool_report.records.record_loading import load_recordings, stretches_of  # noqa: PLC0415
    from spool_report.requests import Selection  # noqa: PLC0415

    selection = Selection(longest=LARGEST)
    try:
        recordings, valve = load_recordings([record], str(valve_file), selection)
    except InputError as error:
        if EMPTY not in str(error):
            raise
        bag = record.with_name("record_bag")
        import_record([record], bag, how=choices(empty_as_gap=True))
        recordings, valve = load_recordings([bag], str(valve_file), selection)
    return stretches_of(recordings), valve


def _fitted(run: Run, one: Structure, other: Structure) -> StructureFit:
    """Return the likeliest fit with the effects of ``one``, also with numbers and chain of ``other``."""
    shared = [unknown.name for unknown in one.base_unknowns] + [GAIN, DELAY]
    with_numbers = one.moved({name: other.values[name] for name in shared})
    chains = dict.fromkeys((one.parts, other.parts, ()))
    starts = [start.having(start.effects, parts, _numbers(other, parts, one)) for parts in chains
              for start in (one, with_numbers)]  # fmt: skip
    for start in starts:
        run.search.finish(start)
    effects = frozenset(one.effects)
    same = [fit for fit in run.search.fits.values() if frozenset(fit.structure.effects) == effects]
    return max(same, key=lambda fit: fit.evidence)


def _numbers(other: Structure, parts: Sequence[str], one: Structure) -> dict[str, float]:
    """Return the numbers of those of ``parts`` that ``other`` has and ``one`` has not."""
    names = [p.name for key in parts if key not in one.parts for p in CHAIN_PARTS[key].parameters]
    return {name: other.values[name] for name in names}


def _as_fitted(effects: Iterable[str]) -> frozenset[str]:
    """Return ``effects`` as they are fitted: forces of two directions as one, which is split afterwards."""
    return frozenset("coulomb_friction" if one == "asymmetric_friction" else one for one in effects)


def _parts(rows: Sequence[FieldVerdict], counts: Mapping[str, int]) -> list[str]:
    """Return the page's paragraphs and tables, Markdown."""
    found = [(row, row.diagnosis) for row in sorted(rows, key=lambda row: row.seed) if row.diagnosis]
    return [
        f"{len(found)} of {len(rows)} verdicts are wrong. In the same run the truth and the answer are "
        "fitted alike, each also from the other's numbers and with its measuring chain. Then the decision is "
        "made again.",
        markdown_table(
            ("reason", "cases", "meaning"),
            [(name, str(counts[name]), meaning) for name, meaning in MEANINGS.items()],
        ),
        markdown_table(
            (
                "seed",
                "hidden",
                "verdict",
                "decided again",
                "measuring chain",
                "reason",
                "advantage of the truth",
            ),
            [
                (
                    str(row.seed),
                    row.hidden,
                    row.verdict,
                    one.again or "-",
                    ", ".join(f"{fault.id} ({fault.channel})" for fault in row.nuisances) or "-",
                    one.reason,
                    "-" if one.advantage is None else f"{one.advantage:.0f}",
                )
                for row, one in found
            ],
        ),
    ]


def _channels(fault: ChainFault) -> tuple[str, ...]:
    return ("body", "spool") if fault.channel == "both" else (fault.channel,)


def _keys(fault: ChainFault) -> list[str]:
    """Return the parts of the measuring chain that ``fault`` stands for."""
    if fault.id == "gain_drift":
        return ["spool_gain_drift"]
    return [key for channel in _channels(fault) if (key := f"{channel}_{fault.id}") in CHAIN_PARTS]

"""Diagnosis of the field study: why a verdict was wrong, by the likelihood of the truth.

For each case with a wrong verdict two structures are fitted to its record by
:mod:`spool_gap.likelihood.structure_fit`: the true one, from the true numbers, and the one that was
chosen, from the numbers that were found. The true structure holds the effects and the filters, modes
and drifts of the measuring chain that were drawn.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table
from spool_blind.case import NONE
from spool_blind.field.case import UNEXPLAINED, make_field, write_field
from spool_core.errors import InputError
from spool_estimator.identification.record import Record
from spool_gap.catalogue import EFFECTS
from spool_gap.likelihood.kernel import motions_for
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.readings import readings_of
from spool_gap.likelihood.structure import CHAIN_PARTS, DELAY, GAIN, structure_of
from spool_gap.likelihood.structure_fit import LOOSENESS, StructureFit, fit_structure
from spool_sim.model import MODELS
from spool_sim.valve import Valve

from spool_evaluation.results.page import markdown_table, write_page
from spool_evaluation.studies.field.verdicts import NO_VERDICT, OUTSIDE, RIGHT, ChainFault, FieldVerdict
from spool_evaluation.studies.gap import BASE
from spool_evaluation.studies.workers import spread

PAGE = "field_diagnosis.md"
SATURATION = "sensor_saturation"
SEARCH, LIKELIHOOD, NUISANCE, DETECTOR, OPEN, LAW, NOTHING = (
    "search", "likelihood", "nuisance", "detector", "not identifiable", "law of no catalogue", "no verdict",
)  # fmt: skip
MEANINGS = {
    SEARCH: "the true structure is more likely than the chosen one, but was not found",
    LIKELIHOOD: "the chosen structure is more likely than the true one",
    NUISANCE: "the truth is more likely, and a fault of the measuring chain was reported that is not there",
    DETECTOR: "only whether a sensor clips is wrong: no fit decides that",
    OPEN: "both are equally likely: the evidence differs by 10 at most",
    NOTHING: "the record was refused, or its analysis failed",
    LAW: "the hidden law is in no catalogue: there is no true structure to fit",
}
#: Difference of the evidence (log likelihood less its penalty) up to which two structures are equally likely.
EQUAL = 10.0
#: Both structures are fitted from strong and from weak correction; the more likely fit counts.
STARTS = (LOOSENESS, LOOSENESS[2:])
#: s of a record that are fitted.
LONGEST = 30.0
#: Option that the message names where cells are empty.
EMPTY = "--empty-as-gap"


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Why a verdict is wrong.

    Attributes:
        row: the wrong verdict.
        reason: one of ``MEANINGS``.
        advantage: evidence of the true structure less that of the chosen one; ``None`` where none was fitted.
    """

    row: FieldVerdict
    reason: str
    advantage: float | None


def diagnose(rows: Sequence[FieldVerdict], out: Path, command: str, workers: int | None = None) -> Path:
    """Diagnose the wrong verdicts among ``rows``; print a table and write the page into ``out``."""
    wrong = [row for row in rows if row.outcome != RIGHT]
    found = sorted(spread(diagnosed, wrong, f"{len(wrong)} diagnoses", workers), key=lambda one: one.row.seed)
    counts = Counter(one.reason for one in found)
    table = Table("reason", "cases", "meaning", box=None, pad_edge=False)
    for reason, meaning in MEANINGS.items():
        table.add_row(reason, str(counts[reason]), meaning)
    Console(width=140).print(table)
    page = write_page(out / PAGE, "Why verdicts of the field study are wrong", command, _parts(rows, found))
    print(f"{page}: each wrong verdict with its reason")
    return page


def _parts(rows: Sequence[FieldVerdict], found: Sequence[Diagnosis]) -> list[str]:
    """Return the page's paragraphs and tables, Markdown."""
    counts = Counter(one.reason for one in found)
    return [
        f"{len(found)} of {len(rows)} verdicts are wrong. For each of them the true structure, from the true "
        "numbers, and the chosen one are fitted to the record by the likelihood of their prediction errors.",
        markdown_table(
            ("reason", "cases", "meaning"),
            [(reason, str(counts[reason]), meaning) for reason, meaning in MEANINGS.items()],
        ),
        markdown_table(
            ("seed", "hidden", "verdict", "measuring chain", "reason", "advantage of the truth"),
            [
                (
                    str(one.row.seed),
                    one.row.hidden,
                    one.row.verdict,
                    ", ".join(f"{fault.id} ({fault.channel})" for fault in one.row.nuisances) or "-",
                    one.reason,
                    "-" if one.advantage is None else f"{one.advantage:.0f}",
                )
                for one in found
            ],
        ),
    ]


def diagnosed(row: FieldVerdict) -> Diagnosis:
    """Return why the verdict of ``row`` is wrong."""
    if row.outcome == NO_VERDICT:
        return Diagnosis(row, NOTHING, None)
    if row.question == OUTSIDE:
        return Diagnosis(row, LAW, None)
    # A verdict that nuisances allow too need not be named; what matters has to be.
    hidden = frozenset(row.hidden.split("+")) - {NONE}
    said = row.said - {UNEXPLAINED}
    if said ^ hidden == {SATURATION}:
        return Diagnosis(row, DETECTOR, None)
    case = make_field(row.seed)
    with tempfile.TemporaryDirectory() as folder:
        predictions, valve = _predictions(*write_field(case, Path(folder)))
    true_numbers = {
        **_numbers(row.truth),
        "spring_stiffness": case.plant["stiffness"],
        "viscous_coefficient": case.plant["damping"],
        GAIN: case.chain.gain - 1.0,
        DELAY: case.chain.delay,
    }
    truth = _fitted(predictions, valve, hidden, row.nuisances, true_numbers)
    found = {name: value for name, (value, _) in row.found.items()}
    chosen = _fitted(predictions, valve, said, row.told, _numbers(found))
    advantage = truth.evidence - chosen.evidence
    return Diagnosis(row, reason(row, advantage), advantage)


def reason(row: FieldVerdict, advantage: float) -> str:
    """Return the reason; ``advantage`` is the evidence of the truth less that of the chosen structure."""
    if abs(advantage) <= EQUAL:
        return OPEN
    if advantage < 0.0:
        return LIKELIHOOD
    drawn = {fault.id for fault in row.nuisances}
    return NUISANCE if {fault.id for fault in row.told} - drawn else SEARCH


def stretches_as_told(record: Path, valve_file: Path) -> tuple[list[Record], Valve]:
    """Return the stretches of the files of a case, read as `./spool gap` does and as its message says.

    Raises:
        InputError: the record is refused.
    """
    # slow to load, and counting needs none of their kernels
    from spool_bag.importing.bag_import import import_record  # noqa: PLC0415
    from spool_bag.importing.choices import choices  # noqa: PLC0415
    from spool_estimator.identification.record import LARGEST  # noqa: PLC0415
    from spool_tools.operations.record_loading import Selection, load_recordings, stretches_of  # noqa: PLC0415

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


def _predictions(record: Path, valve_file: Path) -> tuple[Predictions, Valve]:
    """Return the predictions of the longest stretch of the files of a case."""
    stretches, valve = stretches_as_told(record, valve_file)
    longest = max(stretches, key=lambda one: one.duration)
    part = longest.part(0, min(longest.body.size, round(LONGEST / longest.sample_period)))
    one = Prediction(readings_of(part), valve, motions_for(MODELS[BASE]))
    return Predictions([one]), valve


def _numbers(named: Mapping[str, float]) -> dict[str, float]:
    """Return numbers by parameter from those by "effect.parameter"."""
    return {name.partition(".")[2]: value for name, value in named.items()}


def _fitted(
    predictions: Predictions,
    valve: Valve,
    names: frozenset[str],
    faults: Sequence[ChainFault],
    numbers: Mapping[str, float],
) -> StructureFit:
    """Return the fit of the structure with the effects ``names`` and the parts that ``faults`` stand for."""
    effects = tuple(sorted(name for name in names if name in EFFECTS and EFFECTS[name].terms))
    parts = tuple(dict.fromkeys(key for fault in faults for key in _keys(fault)))
    start = structure_of(MODELS[BASE], valve, effects, parts, numbers)
    start = start.moved(
        {
            f"{channel}_mode_frequency": fault.size
            for fault in faults
            for channel in _channels(fault)
            if fault.id == "extra_mode" and fault.size is not None
        }
    )
    named = frozenset(names & {GAIN, DELAY})
    return max(
        (fit_structure(predictions, start, steps, named=named) for steps in STARTS),
        key=lambda one: one.evidence,
    )


def _channels(fault: ChainFault) -> tuple[str, ...]:
    return ("body", "spool") if fault.channel == "both" else (fault.channel,)


def _keys(fault: ChainFault) -> list[str]:
    """Return the parts of the measuring chain that ``fault`` stands for."""
    if fault.id == "gain_drift":
        return ["spool_gain_drift"]
    return [key for channel in _channels(fault) if (key := f"{channel}_{fault.id}") in CHAIN_PARTS]

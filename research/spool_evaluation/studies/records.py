"""Study of the sample records: fitted as ``./spool fit`` does, against the parameters that made them.

Their simulator is not the one of this suite, so that an error of the simulation shows here: in the coverage
study truth and fit share one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from spool_core.errors import InputError
from spool_estimator.identification.fit_result import FitSettings
from spool_report.outputs import write_json
from spool_report.ranking import fit_and_validate
from spool_report.records.record_loading import Selection, load_data
from spool_sim.model import MODELS

from spool_evaluation.results.page import markdown_table, write_page
from spool_evaluation.studies.estimation import Estimated
from spool_evaluation.studies.workers import spread

#: From where the command is given.
BAGS = Path("bags")
NAME = "estimation_records"
TITLE = "Fits of the sample records"
ABOUT = (
    "The [sample records](../../bags/README.md) come from another simulator. A quarter of each is held out, "
    "as in `./spool fit`; in the last fit the model has friction that is not there. What follows: "
    "[does it hold?](../methods/estimation.md#does-it-hold)"
)


@dataclass(frozen=True, slots=True)
class Sample:
    """A bag, the shipped valve and the model that it is fitted with, and what made it.

    Attributes:
        truth: as in bags/README.md, N/m, N s/m and N.
    """

    bag: str
    valve: str
    model: str
    truth: Mapping[str, float]


def _truth(stiffness: float, viscous: float, friction: float) -> dict[str, float]:
    return {"spring_stiffness": stiffness, "viscous_coefficient": viscous, "coulomb_force": friction}


SAMPLES = (
    Sample("practice_01", "4weh10_soft", "fluid", _truth(1632.0, 4.0, 0.0)),
    Sample("practice_03", "4weh10_soft", "coulomb", _truth(1632.0, 4.0, 0.5)),
    Sample("practice_04", "4weh10_stiff", "coulomb", _truth(5846.0, 8.2, 0.3)),
    # Friction is fitted that is not there.
    Sample("practice_01", "4weh10_soft", "coulomb", _truth(1632.0, 4.0, 0.0)),
)


@dataclass(frozen=True, slots=True)
class SampleEstimate(Estimated):
    """Estimate of a parameter in one fit of ``bag``."""

    JSON_PROPERTIES: ClassVar = ("score",)

    bag: str = ""


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[SampleEstimate]:  # noqa: ARG001 - not drawn
    """Fit the first ``cases`` samples of ``bags/``; ``out`` gets the table as Markdown and JSON.

    Raises:
        InputError: the bags are not here.
    """
    if not BAGS.is_dir():
        raise InputError(f"study records: no folder {BAGS} here: call it from the root of the repository")
    places = range(len(SAMPLES[:cases]))
    rows = [row for _, found in sorted(spread(judge, places, "sample records", workers)) for row in found]
    write_json(out / f"{NAME}.json", rows)
    command = f"./spool study records --cases {len(places)} --out DIR"
    write_page(out / f"{NAME}.md", TITLE, command, [ABOUT, table(rows)])
    print(table(rows))
    return rows


def judge(place: int) -> tuple[int, list[SampleEstimate]]:
    """Return ``place`` and the rows of ``SAMPLES[place]``."""
    sample = SAMPLES[place]
    data = load_data([BAGS / sample.bag], sample.valve, Selection())
    fit = fit_and_validate(data, MODELS[sample.model], FitSettings()).fit
    return place, [
        SampleEstimate(
            sample.model,
            quantity.name,
            quantity.unit,
            sample.truth[quantity.name],
            quantity.value,
            quantity.standard_deviation,
            sample.bag,
        )
        for quantity in fit.parameters
    ]


def table(rows: Sequence[SampleEstimate]) -> str:
    """Return the rows as Markdown; two digits of each standard deviation decide what is shown."""
    body = []
    for row in rows:
        digits = max(0, 1 - math.floor(math.log10(row.deviation)))
        score = f"{row.score:+.1f}".replace("-0.0", "0.0")
        numbers = (f"{row.truth:g} {row.unit}", f"{row.value:.{digits}f}", f"{row.deviation:.{digits}f}")
        body.append((f"`{row.bag}`", row.model, row.quantity, *numbers, score))
    head = ("bag", "model fitted", "parameter", "truth", "found", "standard deviation", "error, in these")
    return markdown_table(head, body)

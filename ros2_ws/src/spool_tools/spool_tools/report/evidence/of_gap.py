"""Evidence of a gap analysis: base model and what was found, beside the records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from spool_core.quantity import Quantity
from spool_estimator.identification.record import Record
from spool_gap.force.force_record import ForceRecord
from spool_gap.result import GapResult
from spool_gap.simulation.point import DELAY, GAIN
from spool_sim.model import Model
from spool_sim.valve.description import Valve

from spool_tools.report.estimates.runs import Numbers

from . import confidence_ellipse as ellipse_picture
from .exhibit import Exhibit, LeftOut, made
from .of_accelerations import AccelerationEvidence
from .of_forces import BASE, FOUND, force_exhibits


def gap_exhibits(
    result: GapResult, base: Model, valve: Valve, records: Sequence[Record]
) -> list[Exhibit | LeftOut]:
    """Return the evidence of ``result``, an analysis of ``records`` of two accelerometers.

    The records are shown as they were measured: what the analysis took out of a channel is still in them.
    """
    before = _numbers(BASE, base, base.values_for(valve), result.base)
    after = _numbers(FOUND, result.model, result.model.values_for(valve), result.parameters)
    shown = AccelerationEvidence(records, valve, (before, after)).exhibits()
    return [*shown, _ellipse(result)]


def gap_force_exhibits(result: GapResult, records: Sequence[ForceRecord]) -> list[Exhibit | LeftOut]:
    """Return the evidence of ``result``, an analysis of force ``records``."""
    return [*force_exhibits(records, result.curves), _ellipse(result)]


def _numbers(name: str, model: Model, values: Mapping[str, float], found: Sequence[Quantity]) -> Numbers:
    own = {quantity.name: quantity.value for quantity in found}
    full = {**values, **{key: value for key, value in own.items() if key in values}}
    return Numbers(name, model, full, own.get(GAIN, 0.0), own.get(DELAY, 0.0))


def _ellipse(result: GapResult) -> Exhibit | LeftOut:
    return made(
        ellipse_picture.TITLE,
        lambda: ellipse_picture.confidence_ellipse(
            ellipse_picture.ellipse_of(result.parameters, result.correlated, result.correlation)
        ),
    )

"""Evidence of a fit: its model beside the records that were fitted."""

from __future__ import annotations

from collections.abc import Sequence

from spool_estimator.identification.fit_result import SPOOL_DELAY, SPOOL_GAIN, Fit
from spool_estimator.identification.record import Record
from spool_sim.valve.description import Valve

from spool_tools.report.estimates.runs import Numbers

from . import confidence_ellipse as ellipse_picture
from .exhibit import Exhibit, LeftOut, made
from .of_accelerations import AccelerationEvidence


def fit_exhibits(found: Fit, valve: Valve, records: Sequence[Record]) -> list[Exhibit | LeftOut]:
    """Return the evidence of ``found``, fitted to ``records``."""
    side = Numbers(
        found.model.name.replace("_", " "),
        found.model,
        found.values,
        found.sensor.get(SPOOL_GAIN, 0.0),
        found.sensor.get(SPOOL_DELAY, 0.0),
    )
    ellipse = made(
        ellipse_picture.TITLE,
        lambda: ellipse_picture.confidence_ellipse(
            ellipse_picture.ellipse_of(found.parameters, found.observable, found.correlation)
        ),
    )
    return [*AccelerationEvidence(records, valve, (side,)).exhibits(), ellipse]

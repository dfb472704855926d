"""Evidence of a replay: drift of each parameter as the monitor judged it, and the record beside the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from spool_core.errors import InputError
from spool_core.uncertainty import Z_95
from spool_estimator.estimate import Estimate
from spool_estimator.identification.record import Record
from spool_estimator.refit import Refit
from spool_monitor.drift.drift_trace import DriftTrace
from spool_monitor.events.event import Event, EventState
from spool_sim.model import load_model
from spool_sim.valve.description import Valve

from spool_tools.report.estimates.runs import Numbers

from . import confidence_ellipse as ellipse_picture
from .campbell import Frequency
from .drift import Mark, drift, title_of
from .exhibit import Exhibit, LeftOut, made
from .of_accelerations import AccelerationEvidence

#: The estimator's model, and how the reader knows its numbers.
MODEL, NAME = "coulomb", "model of the last estimate"


@dataclass(frozen=True, slots=True)
class Replayed:
    """What a replay of one valve leaves for its evidence.

    Attributes:
        name: of the valve in the record.
        valve: its description.
        records: stretches of the record, spread over its time where it is long.
        trace: of the drift tests.
        events: of the monitor.
        latest: estimate, ``None`` where there is none.
        refits: where they were asked for.
        first: stamp of the record's start, ns.
    """

    name: str
    valve: Valve
    records: Sequence[Record]
    trace: DriftTrace
    events: Sequence[Event]
    latest: Estimate | None
    refits: Sequence[Refit]
    first: int


def replay_exhibits(one: Replayed) -> list[Exhibit | LeftOut]:
    """Return the evidence of one valve: its drifts first, then the record beside the model."""
    marks = [
        Mark((event.stamp - one.first) * 1e-9, event.kind.replace("_", " "), event.state is EventState.RAISED)
        for event in one.events
    ]
    units = {} if one.latest is None else {q.name: q.unit for q in one.latest.parameters}
    drifts = [
        made(title_of(name), partial(drift, name, units.get(name, ""), points, one.first, marks))
        for name, points in one.trace.points.items()
    ]
    if not drifts:
        drifts = [LeftOut("Drift of the parameters", "the estimator gave no estimate in this record")]
    shown = AccelerationEvidence(one.records, one.valve, _sides(one), _frequencies(one)).exhibits()
    return [*drifts, *shown, made(ellipse_picture.TITLE, partial(_ellipse, one))]


def _sides(one: Replayed) -> tuple[Numbers, ...]:
    if one.latest is None:
        return ()
    known = {q.name: q.value for q in one.latest.parameters if np.isfinite(q.value)}
    model = load_model(MODEL)
    own = {name: value for name, value in known.items() if name in {p.name for p in model.parameters}}
    if "spring_stiffness" not in own or "viscous_coefficient" not in own:
        return ()
    return (Numbers(NAME, model, {**model.values_for(one.valve), **own}),)


def _frequencies(one: Replayed) -> dict[str, Frequency] | None:
    """Return the estimated natural frequency over time, in the time of the records."""
    if not one.records:
        return None
    begin = min(entry.start for entry in one.records)
    rows = np.array([(stamp - begin, *rest) for stamp, *rest in one.trace.natural if np.isfinite(rest[0])])
    if not rows.size:
        return None
    return {"estimated": Frequency(1e-9 * rows[:, 0], rows[:, 1], Z_95 * np.nan_to_num(rows[:, 2]))}


def _ellipse(one: Replayed) -> Exhibit:
    for found in reversed(one.refits):
        if found.fitted:
            correlation = np.reshape(found.correlations, (len(found.fitted),) * 2)
            return ellipse_picture.confidence_ellipse(
                ellipse_picture.ellipse_of(tuple(found.parameters), tuple(found.fitted), correlation)
            )
    raise InputError("the online estimates hold no covariance of both; --refits does, or ./spool fit")

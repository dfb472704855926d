"""All pictures that a fit, a gap analysis or a replay allows, by kind of record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from spool_core.errors import InputError
from spool_core.events.event import Event, EventState
from spool_core.uncertainty import Z_95, Quantity
from spool_estimator.estimate import Estimate
from spool_estimator.identification.fit_result import SPOOL_DELAY, SPOOL_GAIN, Fit
from spool_estimator.identification.free_run import excitation_limit
from spool_estimator.identification.record import Record
from spool_gap.likelihood.structure import DELAY, GAIN
from spool_gap.result import GapResult
from spool_monitor.drift_trace import DriftTrace
from spool_report.evidence import drifts, motion
from spool_report.evidence.exhibit import Exhibit, LeftOut, Mark, made
from spool_report.evidence.spectra import CAMPBELL_TITLE, Frequency, campbell, constant, rows_of, spectrogram
from spool_sim.model import Model, load_model
from spool_sim.valve import Valve

#: Times the natural frequency that a spectrum over time shows at least, and of the excitation's limit.
HARMONICS, BEYOND = 4.0, 1.2

#: Names of both sides.
BASE, FOUND = "base model", "with what was found"

#: The estimator's model, and how the reader knows its numbers.
MODEL, NAME = "coulomb", "model of the last estimate"


@dataclass(slots=True)
class AccelerationEvidence:
    """Evidence of ``records`` of one ``valve``; ``sides`` are one or two models, base first.

    ``frequencies`` gives the natural frequencies to draw over time; without it those of ``sides`` are drawn.
    """

    records: Sequence[Record]
    valve: Valve
    sides: Sequence[motion.Numbers]
    frequencies: Mapping[str, Frequency] | None = None

    def exhibits(self) -> list[Exhibit | LeftOut]:
        """Return every picture, or why it is left out, in the order in which an expert looks."""
        return [
            made(CAMPBELL_TITLE, self._campbell),
            made(motion.TRANSMISSIBILITY_TITLE, self._transmissibility),
            made(motion.LOOPS_TITLE, self._loops),
        ]

    def _campbell(self) -> Exhibit:
        rows = motion.of_one_rate(self.records)
        limit = max(excitation_limit(entry) for entry in rows)
        highest = max(BEYOND * min(limit, 400.0), HARMONICS * self.valve.natural_frequency)
        shown = spectrogram(rows_of(rows), rows[0].sample_period, highest)
        of_sides = {
            side.name: constant(side.natural_frequency, shown)
            for side in self.sides
            if np.isfinite(side.natural_frequency)
        }
        return campbell(shown, self.frequencies or of_sides)

    def _loops(self) -> Exhibit:
        self._need_a_model()
        return motion.force_loops(motion.loops_of(self.records, self.sides))

    def _need_a_model(self) -> None:
        if not self.sides:
            raise InputError("no model of this valve is known from the record")

    def _transmissibility(self) -> Exhibit:
        self._need_a_model()
        return motion.transmissibility(motion.runs_of(self.records, self.valve, self.sides))


def fit_exhibits(found: Fit, valve: Valve, records: Sequence[Record]) -> list[Exhibit | LeftOut]:
    """Return the evidence of ``found``, fitted to ``records``."""
    side = motion.Numbers(
        found.model.name.replace("_", " "),
        found.model,
        found.values,
        found.sensor.get(SPOOL_GAIN, 0.0),
        found.sensor.get(SPOOL_DELAY, 0.0),
        found.observation,
    )
    return AccelerationEvidence(records, valve, (side,)).exhibits()


def gap_exhibits(
    result: GapResult, base: Model, valve: Valve, records: Sequence[Record]
) -> list[Exhibit | LeftOut]:
    """Return the evidence of ``result``, an analysis of ``records`` of two accelerometers.

    The records are shown as they were measured: what the analysis took out of a channel is still in them.
    """
    before = _numbers(BASE, base, base.values_for(valve), result.base)
    after = _numbers(FOUND, result.model, result.model.values_for(valve), result.parameters)
    return AccelerationEvidence(records, valve, (before, after)).exhibits()


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
        first: stamp of the record's start, ns.
    """

    name: str
    valve: Valve
    records: Sequence[Record]
    trace: DriftTrace
    events: Sequence[Event]
    latest: Estimate | None
    first: int


def replay_exhibits(one: Replayed) -> list[Exhibit | LeftOut]:
    """Return the evidence of one valve: its drifts first, then the record beside the model."""
    marks = [
        Mark((event.stamp - one.first) * 1e-9, event.kind.replace("_", " "), event.state is EventState.RAISED)
        for event in one.events
    ]
    units = {} if one.latest is None else {q.name: q.unit for q in one.latest.parameters}
    shown = [
        made(
            drifts.title_of(name), partial(drifts.drift, name, units.get(name, ""), points, one.first, marks)
        )
        for name, points in one.trace.points.items()
    ]
    if not shown:
        shown = [LeftOut("Drift of the parameters", "the estimator gave no estimate in this record")]
    return [*shown, *AccelerationEvidence(one.records, one.valve, _sides(one), _frequencies(one)).exhibits()]


def _numbers(
    name: str, model: Model, values: Mapping[str, float], found: Sequence[Quantity]
) -> motion.Numbers:
    own = {quantity.name: quantity.value for quantity in found}
    full = {**values, **{key: value for key, value in own.items() if key in values}}
    return motion.Numbers(name, model, full, own.get(GAIN, 0.0), own.get(DELAY, 0.0))


def _sides(one: Replayed) -> tuple[motion.Numbers, ...]:
    if one.latest is None:
        return ()
    known = {q.name: q.value for q in one.latest.parameters if np.isfinite(q.value)}
    model = load_model(MODEL)
    own = {name: value for name, value in known.items() if name in {p.name for p in model.parameters}}
    if "spring_stiffness" not in own or "viscous_coefficient" not in own:
        return ()
    return (motion.Numbers(NAME, model, {**model.values_for(one.valve), **own}),)


def _frequencies(one: Replayed) -> dict[str, Frequency] | None:
    """Return the estimated natural frequency over time, in the time of the records."""
    if not one.records:
        return None
    begin = min(entry.start for entry in one.records)
    rows = np.array([(stamp - begin, *rest) for stamp, *rest in one.trace.natural if np.isfinite(rest[0])])
    if not rows.size:
        return None
    return {"estimated": Frequency(1e-9 * rows[:, 0], rows[:, 1], Z_95 * np.nan_to_num(rows[:, 2]))}

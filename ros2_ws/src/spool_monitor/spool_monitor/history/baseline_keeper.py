"""Baselines of one valve, version by version: learned, confirmed, taken up again after a restart."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from pydantic import TypeAdapter, ValidationError
from spool_core.errors import InputError
from spool_estimator.estimate import Estimate, State

from spool_monitor.alarms.alarm import AlarmRefusedError, Operator
from spool_monitor.detection import Detection
from spool_monitor.drift.baseline import Baseline, HealthyValue

from .baseline_record import BaselineRecord, BaselineStage

#: Versions that are kept.
KEPT = 10

_RECORDS = TypeAdapter(list[BaselineRecord])
_NOT_MEASURED = (math.nan, math.nan)


@dataclass(slots=True)
class BaselineKeeper:
    """Keeper of the baselines: keeps what the monitor's :class:`Detection` learned, and give it back to it.

    Nothing is taken up or kept before the valve is known (:meth:`identify`), since a baseline belongs to one
    valve and its oil.

    Attributes:
        records: the versions there are, the newest last, :data:`KEPT` at most.
        current: the one that is compared with, ``None`` while it is learned.
        anew: whether somebody asked to learn anew, so that a restart goes on with that.

    """

    detection: Detection
    records: list[BaselineRecord] = field(default_factory=list, init=False)
    current: BaselineRecord | None = field(default=None, init=False)
    anew: bool = field(default=False, init=False)
    _valve: tuple[str, str] | None = field(default=None, init=False)
    _band: tuple[float, float] = field(default=_NOT_MEASURED, init=False)

    def identify(self, valve_id: str, oil: str = "") -> bool:
        """Say which valve it is and what oil it runs on; return whether a kept baseline was taken up.

        Raises:
            InputError: the newest baseline is another valve's or of another oil; both are named. It is not
                used, learning goes on.

        """
        if self._valve == (valve_id, oil):
            return False
        if self._valve is not None and self.current is not None:
            self._start_over()
        self._valve = (valve_id, oil)
        if not self.records or self.anew:
            return False
        self.records[-1].check_valve(valve_id, oil)
        self._use(self.records[-1])
        return True

    def update(self, estimate: Estimate) -> bool:
        """Take note of an estimate that the monitor has seen; return whether there is something to keep."""
        if self.current is None and estimate.state is State.TRACKING and estimate.oil_temperature.known:
            celsius = estimate.oil_temperature.value
            low, high = self._band
            self._band = (celsius, celsius) if math.isnan(low) else (min(low, celsius), max(high, celsius))
        if self._valve is None:
            return False
        values = healthy_values(self.detection)
        if self.current is None:
            if not values:
                return False
            valve_id, oil = self._valve
            version = max((one.version for one in self.records), default=0) + 1
            self.current = BaselineRecord(
                valve_id, oil, self._band, version, BaselineStage.LEARNED, estimate.stamp, values=values
            )
            self.records = [*self.records, self.current][-KEPT:]
            self.anew = False
            return True
        if len(values) > len(self.current.values):  # what takes longer to learn joins later
            self._change(replace(self.current, values=values))
            return True
        return False

    def learn(self) -> None:
        """Forget what is compared with and learn anew; the kept versions stay."""
        self.anew = True
        self._start_over()

    def freeze(self, operator: Operator) -> BaselineRecord:
        """Confirm what was learned; return it.

        Raises:
            AlarmRefusedError: nothing is learned yet, or it is frozen already.

        """
        if self.current is None:
            raise AlarmRefusedError("baseline: it is still being learned, so there is nothing to freeze")
        if self.current.stage is BaselineStage.FROZEN:
            raise AlarmRefusedError(
                f"baseline: version {self.current.version} was frozen by {self.current.who} already"
            )
        return self._change(
            replace(self.current, stage=BaselineStage.FROZEN, who=operator.who, comment=operator.comment)
        )

    def restore(self, version: int) -> BaselineRecord:
        """Compare with an older version again; return it.

        Raises:
            AlarmRefusedError: there is no such version, or the valve is not known yet.
            InputError: it is another valve's.

        """
        found = next((one for one in self.records if one.version == version), None)
        if found is None:
            there = ", ".join(str(one.version) for one in self.records) or "none"
            raise AlarmRefusedError(f"baseline: no version {version}; there are: {there}")
        if self._valve is None:
            raise AlarmRefusedError("baseline: the valve is not known yet")
        found.check_valve(*self._valve)
        # The newest is what a restart takes up.
        self.records = [*(one for one in self.records if one is not found), found]
        self.anew = False
        self._use(found)
        return found

    def dump(self) -> dict[str, Any]:
        """Return what :meth:`load` takes, as JSON can hold it."""
        records = [_serialised({**asdict(one), "stage": one.stage.value}) for one in self.records]
        return {"anew": self.anew, "records": records}

    def load(self, content: Any) -> None:
        """Take up what :meth:`dump` gave; it is used once the valve is known.

        Raises:
            InputError: ``content`` is something else.

        """
        try:
            records = _RECORDS.validate_python(content["records"])
            self.records, self.anew = records[-KEPT:], bool(content["anew"])
        except (ValidationError, TypeError, KeyError) as error:
            raise InputError(f"the kept baseline can't be read: {str(error).splitlines()[0]}") from error

    def _use(self, record: BaselineRecord) -> None:
        self.current = record
        take_up(self.detection, record.values)

    def _change(self, record: BaselineRecord) -> BaselineRecord:
        self.records = [record if one is self.current else one for one in self.records]
        self.current = record
        return record

    def _start_over(self) -> None:
        self.current, self._band = None, _NOT_MEASURED
        relearn(self.detection)


def healthy_values(detection: Detection) -> tuple[HealthyValue, ...]:
    """Return what was learned so far, nothing before every parameter of the model is."""
    if not all(one.baseline.frozen for one in detection.parameters.values()):
        return ()
    values = [
        replace(
            _healthy_value(detection, name, drift.baseline),
            referred=drift.referred,
            temperature=drift.temperature,
        )
        for name, drift in detection.parameters.items()
    ]
    learned = [(name, start) for name, start in detection.learned.items() if start.frozen]
    return (*values, *(_healthy_value(detection, name, start) for name, start in learned))


def _healthy_value(detection: Detection, name: str, start: Baseline) -> HealthyValue:
    return HealthyValue(
        name, detection.units[name], start.value, start.spread, start.mean, start.deviation, start.count,
        start.correlation,
    )  # fmt: skip


def take_up(detection: Detection, values: tuple[HealthyValue, ...]) -> None:
    """Let ``detection`` compare with ``values``; what they lack is learned."""
    relearn(detection)
    for kept in values:
        drift = detection.parameters.get(kept.name)
        if drift is not None:
            drift.baseline.restore(kept)
            drift.referred, drift.temperature = kept.referred, kept.temperature
        elif kept.name in detection.learned:
            detection.learned[kept.name].restore(kept)


def relearn(detection: Detection) -> None:
    """Let ``detection`` forget every start value."""
    for drift in detection.parameters.values():
        drift.reset()
        drift.baseline.restart()
        drift.referred, drift.temperature = False, math.nan
    for start in detection.learned.values():
        start.restart()


def _serialised(value: Any) -> Any:
    """Return ``value`` as JSON can hold it; NaN becomes a word that a float is read from."""
    if isinstance(value, dict):
        return {key: _serialised(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_serialised(item) for item in value]
    return "nan" if isinstance(value, float) and math.isnan(value) else value

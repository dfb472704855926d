"""Alarm store of one valve: what happened to its alarms, what operators do, what is kept over a restart."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Concatenate, ParamSpec

from pydantic import TypeAdapter, ValidationError
from spool_core.errors import InputError
from spool_core.uncertainty import Quantity

from spool_monitor.alarm import Alarm, AlarmRefusedError, Operator, Transition, acknowledge, expire, follow
from spool_monitor.detectors import latching_kinds
from spool_monitor.event import Condition, Event, EventState, Facts, condition_name

Given = ParamSpec("Given")
_ALARM = TypeAdapter(Alarm)


@dataclass(slots=True)
class AlarmStore:
    """Every alarm that a valve can have, by its name; fed with the monitor's events.

    ``latching``: kinds that stay until somebody resets them. Stamps are in ns, those of operators and of
    :meth:`advance` from one clock.
    """

    latching: tuple[str, ...] = field(default_factory=latching_kinds)
    alarms: dict[str, Alarm] = field(default_factory=dict, init=False)
    _conditions: tuple[Condition, ...] = field(default=(), init=False)

    def expect(self, conditions: Iterable[Condition]) -> None:
        """Know the valve's conditions before one of them is raised."""
        self._conditions = tuple(conditions)
        for condition in self._conditions:
            self._of(condition.kind, condition.source)

    def update(self, event: Event) -> Transition:
        """Take one event of the monitor."""
        return self._keep(follow(self._of(event.kind, event.source), event))

    def advance(self, stamp: int) -> list[Transition]:
        """End the shelves and times out of service that are over at ``stamp`` (ns); return them."""
        timed = [alarm for alarm in self.alarms.values() if alarm.shelved_until or alarm.serviced_until]
        transitions = [expire(alarm, stamp) for alarm in timed]
        return [self._keep(transition) for transition in transitions if transition.changed]

    def acknowledge(self, which: str, operator: Operator, occurrence: int = 0) -> list[Transition]:
        """Acknowledge; see :meth:`operate` and :func:`~spool_monitor.alarm.acknowledge`."""
        transitions = self.operate(which, acknowledge, operator, occurrence)
        for condition in self._conditions:
            condition.acknowledged = self.alarms[condition.name].acknowledged
        return transitions

    def operate(
        self,
        which: str,
        change: Callable[Concatenate[Alarm, Given], Transition],
        *given: Given.args,
        **named: Given.kwargs,
    ) -> list[Transition]:
        """Change the alarm named ``which``, all whose names begin with it, or all (empty) that allow it.

        ``change`` is what an operator can do, as ``spool_monitor.alarm`` has it; then what else that takes.

        Raises:
            AlarmRefusedError: there is no such alarm, or none of them can; nothing is changed.

        """
        chosen = [
            alarm for name, alarm in self.alarms.items() if not which or f"{name}/".startswith(f"{which}/")
        ]
        if not chosen:
            raise AlarmRefusedError(f"no alarm {which!r}; there are: {', '.join(sorted(self.alarms))}")
        transitions, refusals = [], []
        for alarm in chosen:
            try:
                transitions.append(change(alarm, *given, **named))
            except AlarmRefusedError as refusal:
                refusals.append(refusal)
        if not transitions:
            if len(refusals) == 1:
                raise refusals[0]
            raise AlarmRefusedError(f"all {len(refusals)} alarms refuse this: {refusals[0]}, ...")
        return [self._keep(transition) for transition in transitions]

    @property
    def shown(self) -> list[Alarm]:
        """Alarms that are not normal, those waiting for an operator first, then by severity and age."""
        listed = [alarm for alarm in self.alarms.values() if alarm.state.name != "NORMAL"]
        return sorted(
            listed, key=lambda one: (one.hidden, one.acknowledged, -one.severity, one.raised_at, one.name)
        )

    def restore(self, conditions: Iterable[Condition]) -> None:
        """Activate those of ``conditions`` whose alarms are active, so that their end is seen too."""
        for condition in conditions:
            alarm = self.alarms.get(condition.name)
            if alarm is not None and alarm.active and condition.active is None:
                facts = Facts() if alarm.event is None else alarm.event.facts
                condition.restore(alarm.severity, alarm.cause, facts)
                condition.acknowledged = alarm.acknowledged

    def dump(self) -> list[dict[str, Any]]:
        """Return what :meth:`load` takes, as JSON can hold it."""
        return [serialised(asdict(alarm)) for alarm in self.alarms.values()]

    def load(self, content: Any) -> None:
        """Take up what :meth:`dump` gave, of whatever version; ``latching`` is as it is set now.

        Raises:
            InputError: ``content`` is no list of alarms, or some of them can't be read; the others are
                taken up.

        """
        self._take(content, lambda _: True)

    def join(self, content: Any) -> None:
        """Take up what another store dumped, where it was changed later than here.

        Raises:
            InputError: as :meth:`load`.

        """

        def later(alarm: Alarm) -> bool:
            own = self.alarms.get(alarm.name)
            if own is None or own == Alarm(own.kind, own.source, own.latching):
                return True
            return alarm.changed_at > own.changed_at

        self._take(content, later)

    def _take(self, content: Any, wanted: Callable[[Alarm], bool]) -> None:
        if not isinstance(content, list):
            raise InputError("the kept alarms can't be read: they are not a list")
        unreadable = []
        for entry in content:
            try:
                alarm = _ALARM.validate_python(entry)
                if alarm.event is None:
                    alarm = replace(alarm, event=_earlier_event(alarm, entry))
            except (ValidationError, TypeError, KeyError) as error:
                unreadable.append(str(error).splitlines()[0])
                continue
            alarm = replace(alarm, source=self._source(alarm))
            if wanted(alarm):
                latching = alarm.kind in self.latching
                self.alarms[alarm.name] = replace(
                    alarm, latching=latching, latched=alarm.latched and latching
                )
        if unreadable:
            raise InputError(
                f"{len(unreadable)} of {len(content)} of the kept alarms can't be read: {unreadable[0]}"
            )

    def _source(self, alarm: Alarm) -> str:
        """Return the source of ``alarm``: of its last fault where an earlier version kept one for many."""
        longer = [one.source for one in self.alarms.values() if one.name.startswith(f"{alarm.name}/")]
        if alarm.name in self.alarms or not longer:
            return alarm.source
        facts = Facts() if alarm.event is None else alarm.event.facts
        known = {alarm.cause, facts.parameter, facts.subject}
        return next((one for one in longer if known & {*one.split("/")}), longer[0])

    def _of(self, kind: str, source: str) -> Alarm:
        name = condition_name(kind, source)
        if name not in self.alarms:
            self.alarms[name] = Alarm(kind, source, latching=kind in self.latching)
        return self.alarms[name]

    def _keep(self, transition: Transition) -> Transition:
        self.alarms[transition.after.name] = transition.after
        return transition


def serialised(value: Any) -> Any:
    """Return ``value`` as JSON can hold it; a float that is not finite becomes a word."""
    if isinstance(value, dict):
        return {key: serialised(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [serialised(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _earlier_event(alarm: Alarm, entry: Any) -> Event | None:
    """Return the event of an alarm that an earlier version kept: its sentence and its number."""
    if not entry.get("message"):  # this version keeps none
        return None
    value = math.nan if entry["value"] is None else entry["value"]
    return Event(
        alarm.changed_at,
        alarm.kind,
        EventState.RAISED if alarm.active else EventState.CLEARED,
        alarm.severity,
        alarm.cause,
        Quantity("", entry["unit"], value),
        alarm.source,
        alarm.code,
        text=entry["message"],
    )

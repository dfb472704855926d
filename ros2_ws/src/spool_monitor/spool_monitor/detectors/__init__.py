"""Detectors: one class and one registry entry each; with the event kinds and limits their files declare."""

from __future__ import annotations

from dataclasses import replace

from spool_core.discovery import classes_in, objects_in
from spool_core.errors import InputError

from spool_monitor.detectors.base import (
    BASELINE_TIME,
    FALSE_ALARM_INTERVAL,
    JUDGEMENT_TEXTS,
    MINIMUM_BODY,
    NATURAL_FREQUENCY,
    Detector,
    Judgement,
    Moment,
    MonitorLimit,
    MonitorSettings,
    NotJudged,
)
from spool_monitor.event import EventKind, Namur

__all__ = [
    "DETECTORS",
    "JUDGEMENT_TEXTS",
    "KINDS",
    "LIMITS",
    "Detector",
    "Judgement",
    "Moment",
    "MonitorLimit",
    "MonitorSettings",
    "check_settings",
    "detectors",
    "event_kind",
    "latching_kinds",
]

_FOUND: list[type[Detector]] = [*classes_in(__package__, Detector), NotJudged]

DETECTORS: dict[str, type[Detector]] = {
    entry.name: entry for entry in sorted(_FOUND, key=lambda entry: (entry.rank, entry.name))
}

#: Limits of several detectors stand in the module `base`, which is not searched.
_SHARED = (NATURAL_FREQUENCY, MINIMUM_BODY, FALSE_ALARM_INTERVAL, BASELINE_TIME)

LIMITS: dict[str, MonitorLimit] = {
    limit.name: limit for limit in (*_SHARED, *objects_in(__package__, MonitorLimit))
}


def _kinds() -> dict[str, EventKind]:
    """Return the kinds in the order of their numbers, each with the causes of all files that share it."""
    kinds: dict[str, EventKind] = {}
    for kind in sorted(objects_in(__package__, EventKind), key=lambda kind: kind.code):
        known = kinds.get(kind.name, replace(kind, causes=()))
        assert replace(known, causes=()) == replace(kind, causes=()), kind.name
        causes = sorted((*known.causes, *kind.causes), key=lambda cause: cause.code)
        kinds[kind.name] = replace(known, causes=tuple(causes))
    return kinds


KINDS: dict[str, EventKind] = _kinds()

#: Number of a kind that is not listed.
UNLISTED = 900


def event_kind(name: str) -> EventKind:
    """Return the kind called ``name``; one that a later version kept or sent is unlisted."""
    return KINDS.get(name) or EventKind(name, UNLISTED, Namur.OUT_OF_SPECIFICATION)


def latching_kinds() -> tuple[str, ...]:
    """Return the names of the kinds whose alarms stay until they are reset."""
    return tuple(kind.name for kind in KINDS.values() if kind.latching)


def detectors(settings: MonitorSettings) -> tuple[Detector, ...]:
    """Return one of each, in the order in which a moment is shown to them."""
    return tuple(entry(settings) for entry in DETECTORS.values())


def check_settings(settings: MonitorSettings) -> None:
    """Refuse limits that do not exist or contradict each other.

    Raises:
        InputError: they are named.

    """
    unknown = [name for name in settings.given if name not in LIMITS]
    if unknown:
        raise InputError(f"no limit {unknown[0]!r}; there are: {', '.join(LIMITS)}")
    for entry in DETECTORS.values():
        entry.check(settings)

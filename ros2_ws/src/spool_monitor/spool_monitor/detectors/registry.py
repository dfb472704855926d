"""Finds every detector in this folder."""

from __future__ import annotations

from spool_stream.discovery import classes_in

from spool_monitor.settings import MonitorSettings

from .base import Detector

DETECTORS: dict[str, type[Detector]] = {
    entry.name: entry
    for entry in sorted(classes_in(__package__, Detector), key=lambda entry: (entry.rank, entry.name))
}


def detectors(settings: MonitorSettings) -> tuple[Detector, ...]:
    """Return one of each, in the order in which a moment is shown to them."""
    return tuple(entry(settings) for entry in DETECTORS.values())

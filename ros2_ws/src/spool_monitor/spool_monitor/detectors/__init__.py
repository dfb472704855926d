"""Detectors: one file, one class, one registry entry each; with the event kinds and limits they declare."""

from __future__ import annotations

from spool_monitor.detectors.base import MonitorLimit, MonitorSettings

from .base import CHANNELS, ESTIMATE, JUDGEMENT_TEXTS, LINE, SIGNALS, Detector, Judgement, Moment
from .registry import DETECTORS, KINDS, LIMITS, check_settings, detectors, event_kind, latching_kinds

__all__ = [
    "CHANNELS",
    "DETECTORS",
    "ESTIMATE",
    "JUDGEMENT_TEXTS",
    "KINDS",
    "LIMITS",
    "LINE",
    "SIGNALS",
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

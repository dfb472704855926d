"""Detectors: one file, one class, one registry entry each."""

from __future__ import annotations

from .base import ESTIMATE, JUDGEMENT_TEXTS, LINE, SIGNALS, Detector, Finding, Judgement, Moment
from .registry import DETECTORS, detectors

__all__ = [
    "DETECTORS",
    "ESTIMATE",
    "JUDGEMENT_TEXTS",
    "LINE",
    "SIGNALS",
    "Detector",
    "Finding",
    "Judgement",
    "Moment",
    "detectors",
]

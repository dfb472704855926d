"""Detectors: one file, one class, one registry entry each."""

from __future__ import annotations

from .base import JUDGEMENT_TEXTS, Detector, Finding, Judgement, Moment
from .registry import DETECTORS, detectors

__all__ = ["DETECTORS", "JUDGEMENT_TEXTS", "Detector", "Finding", "Judgement", "Moment", "detectors"]

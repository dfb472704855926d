"""Finds every detector in this folder."""

from __future__ import annotations

import importlib
import inspect
import pkgutil

from ..settings import MonitorSettings
from .base import Detector


def _find() -> dict[str, type[Detector]]:
    package = importlib.import_module(__package__)
    found: list[type[Detector]] = []
    for module_info in pkgutil.iter_modules(package.__path__):
        if module_info.name in ("base", "registry"):
            continue
        module = importlib.import_module(f"{__package__}.{module_info.name}")
        found += [
            entry
            for entry in vars(module).values()
            if isinstance(entry, type)
            and issubclass(entry, Detector)
            and not inspect.isabstract(entry)
            and entry.__module__ == module.__name__
        ]
    return {entry.name: entry for entry in sorted(found, key=lambda entry: (entry.rank, entry.name))}


DETECTORS: dict[str, type[Detector]] = _find()


def detectors(settings: MonitorSettings) -> tuple[Detector, ...]:
    """Return one of each, in the order in which a moment is shown to them."""
    return tuple(entry(settings) for entry in DETECTORS.values())

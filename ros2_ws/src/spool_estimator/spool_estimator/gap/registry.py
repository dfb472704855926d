"""Finds every effect in the folder ``catalogue``."""

from __future__ import annotations

import importlib
import pkgutil

from spool_stream.errors import InputError

from .effect import Effect


def _find() -> dict[str, Effect]:
    package = importlib.import_module(f"{__package__}.catalogue")
    found: dict[str, Effect] = {}
    for module_info in sorted(pkgutil.iter_modules(package.__path__), key=lambda info: info.name):
        module = importlib.import_module(f"{package.__name__}.{module_info.name}")
        for entry in vars(module).values():
            if isinstance(entry, type) and issubclass(entry, Effect) and entry.__module__ == module.__name__:
                found[entry.id] = entry()
    return found


EFFECTS: dict[str, Effect] = _find()


def effect(name: str) -> Effect:
    """Return the effect called ``name``.

    Raises:
        InputError: no such effect.
    """
    if name not in EFFECTS:
        raise InputError(f"effects: unknown effect '{name}'; known are {', '.join(EFFECTS)}")
    return EFFECTS[name]

"""Finds every effect in the folder ``catalogue``."""

from __future__ import annotations

from spool_stream.discovery import classes_in
from spool_stream.errors import InputError

from .effect import Effect

EFFECTS: dict[str, Effect] = {entry.id: entry() for entry in classes_in(f"{__package__}.catalogue", Effect)}


def effect(name: str) -> Effect:
    """Return the effect called ``name``.

    Raises:
        InputError: no such effect.
    """
    if name not in EFFECTS:
        raise InputError(f"effects: unknown effect '{name}'; known are {', '.join(EFFECTS)}")
    return EFFECTS[name]

"""Registry of the effects in the folder ``catalogue``."""

from __future__ import annotations

from spool_stream.discovery import classes_in
from spool_stream.errors import InputError

from .effect import Effect

EFFECTS: dict[str, Effect] = {entry.id: entry() for entry in classes_in(f"{__package__}.catalogue", Effect)}

#: Ids of the laws of dry friction: of these a machine has one.
FRICTIONS = frozenset(name for name, entry in EFFECTS.items() if entry.is_friction)


def effect(name: str) -> Effect:
    """Return the effect called ``name``.

    Raises:
        InputError: no such effect.
    """
    if name not in EFFECTS:
        raise InputError(f"effects: unknown effect '{name}'; known are {', '.join(EFFECTS)}")
    return EFFECTS[name]

"""Registry of the effects in the folder ``catalogue``, and of the nuisances that a record shows by itself."""

from __future__ import annotations

from spool_core.discovery import classes_in
from spool_core.errors import InputError
from spool_estimator.identification.nuisances import BiasDrift, Hum, RecordNuisance, Spikes

from .effect import Effect

#: Nuisances that a record shows without a model, in the order in which they are looked for.
RECORD_NUISANCES: tuple[RecordNuisance, ...] = (Spikes(), Hum(), BiasDrift())
#: Every effect by its id, in their order.
EFFECTS: dict[str, Effect] = {
    entry.id: entry()
    for entry in sorted(classes_in(f"{__package__}.catalogue", Effect), key=lambda one: str(one.id))
}

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

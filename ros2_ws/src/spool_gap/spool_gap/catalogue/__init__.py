"""Effects that the analysis can name, each one declaration, in files by family; nuisances of records."""

from __future__ import annotations

from collections.abc import Iterable

from spool_core.discovery import objects_in
from spool_core.errors import InputError
from spool_estimator.identification.nuisances import BiasDrift, Hum, RecordNuisance, Spikes

from spool_gap.effect import Effect

#: Nuisances that a record shows without a model, in the order in which they are looked for.
RECORD_NUISANCES: tuple[RecordNuisance, ...] = (Spikes(), Hum(), BiasDrift())
#: Every effect by its id, in their order.
EFFECTS: dict[str, Effect] = {
    entry.id: entry for entry in sorted(objects_in(__package__, Effect), key=lambda entry: entry.id)
}

#: Ids of the laws of dry friction: of these a machine has one.
FRICTIONS = frozenset(name for name, entry in EFFECTS.items() if entry.is_friction)


def group_of(effects: Iterable[str]) -> str:
    """Return the groups on the machine of ``effects``, joined by ``+``; empty where these have none."""
    return "+".join(sorted({EFFECTS[name].group for name in effects if name in EFFECTS}))


def effect(name: str) -> Effect:
    """Return the effect called ``name``.

    Raises:
        InputError: no such effect.
    """
    if name not in EFFECTS:
        raise InputError(f"effects: unknown effect '{name}'; known are {', '.join(EFFECTS)}")
    return EFFECTS[name]

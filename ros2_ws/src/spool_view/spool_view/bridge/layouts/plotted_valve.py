"""Valve as layouts show it: its namespace and the numbers of its model in their order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from spool_bag.reading.reader import BagReader

#: Parameters where no estimate says what the model has: those of the default model.
DEFAULT_PARAMETERS = ("spring_stiffness", "viscous_coefficient", "coulomb_force")


@dataclass(frozen=True, slots=True)
class PlottedValve:
    """Valve: ``name`` is its namespace, ``parameters`` those of its estimates, in their order."""

    name: str
    parameters: tuple[str, ...] = DEFAULT_PARAMETERS


def recorded_valves(reader: BagReader, names: Sequence[str]) -> list[PlottedValve]:
    """Return the valves ``names`` of a bag with the parameters that their first estimate has."""
    found = []
    for name in names:
        topic = f"/{name}/estimate"
        estimate = next(iter(reader.messages(topic)), None) if topic in reader.topics else None
        own = tuple(one.name for one in estimate.parameters) if estimate is not None else DEFAULT_PARAMETERS
        found.append(PlottedValve(name, own))
    return found

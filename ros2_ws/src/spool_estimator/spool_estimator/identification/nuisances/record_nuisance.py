"""Nuisances that a record shows without any model, and what it is without them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from spool_sim.valve.description import Valve

from spool_estimator.identification.record import Record

from .nuisance import Nuisance


@dataclass(frozen=True, slots=True)
class Cleaned:
    """Records freed of a nuisance, and what was found.

    Attributes:
        records: as many as were given, of the same lengths.
        found: in which channels, and how large.
    """

    records: tuple[Record, ...]
    found: tuple[Nuisance, ...] = ()


class RecordNuisance(ABC):
    """Nuisance that is found in the readings themselves: one class in one file of this folder.

    Attributes:
        id: of the nuisance.
        order: smaller ones are looked for first.
    """

    id: ClassVar[str]
    order: ClassVar[int] = 0

    @abstractmethod
    def clean(self, records: Sequence[Record], valve: Valve) -> Cleaned:
        """Return ``records`` of ``valve`` without it, and what was found; as given where there is none."""

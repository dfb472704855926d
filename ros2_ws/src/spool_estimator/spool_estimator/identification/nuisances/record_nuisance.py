"""Nuisance of a record: what it adds to a channel, and how it is fitted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from spool_sim.valve import Valve

from spool_estimator.identification.record import Record


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


@dataclass(frozen=True, slots=True)
class Nuisance:
    """Nuisance of the measuring chain that was found: no part of the valve, and never of the verdict.

    Attributes:
        id: of its kind.
        channel: ``body``, ``spool`` or ``both``.
        size: how large it is, in ``unit``, with its standard ``deviation`` (NaN where that is not known).
        check: what to look at on the measuring chain.
        corrected: it is left out of what is compared.
    """

    id: str
    channel: str
    size: float
    unit: str
    check: str
    deviation: float = float("nan")
    corrected: bool = False

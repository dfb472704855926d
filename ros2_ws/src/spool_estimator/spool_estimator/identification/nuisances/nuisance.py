"""Nuisance of a measuring chain: what is told of one that was found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Nuisance:
    """Nuisance of the measuring chain that was found: no part of the valve, and never of the verdict.

    Attributes:
        id: of its kind.
        channel: ``body``, ``spool`` or ``both``.
        size: how large it is, in ``unit``, with its standard ``deviation`` (NaN where that is not known).
        check: what to look at on the measuring chain.
        corrected: it was taken out of the record before anything was fitted.
    """

    id: str
    channel: str
    size: float
    unit: str
    check: str
    deviation: float = float("nan")
    corrected: bool = False

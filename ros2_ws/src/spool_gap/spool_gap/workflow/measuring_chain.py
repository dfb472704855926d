"""Measuring chain: records freed of what sensors and loggers did, before and while effects are named."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

from spool_estimator.identification.nuisances.record_nuisance import Nuisance
from spool_estimator.identification.record import Record
from spool_sim.valve import Valve

from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.registry import CHAIN, RECORD_NUISANCES

#: Times that a record is corrected by what a selection finds and is analysed afresh, at most: two nuisances,
#: and one of them again, whose size was off as long as the other one was there.
MOST_CORRECTIONS = 3


@dataclass(frozen=True, slots=True)
class Chain:
    """Records as far as they are corrected.

    Attributes:
        records, holdout: to fit, and to hold out.
        found: nuisances, told once for each channel with their sizes in all.
        corrections: how often a selection found one.
    """

    records: tuple[Record, ...]
    holdout: tuple[Record, ...]
    found: tuple[Nuisance, ...] = ()
    corrections: int = 0

    @property
    def open(self) -> bool:
        """Whether a further correction may be made."""
        return self.corrections < MOST_CORRECTIONS

    def corrected(self, hypothesis: Hypothesis) -> Chain:
        """Return this without the nuisances that ``hypothesis`` has."""
        records, holdout, found = self.records, self.holdout, list(self.found)
        for name in nuisances_of(hypothesis):
            effect, values = CHAIN[name], hypothesis.point.values
            records = tuple(effect.corrected(record, values) for record in records)
            holdout = tuple(effect.corrected(record, values) for record in holdout)
            found.append(effect.found(values, hypothesis.fitted.deviations))
        return Chain(records, holdout, _together(found), self.corrections + 1)


def cleaned(
    records: Sequence[Record], holdout: Sequence[Record], valve: Valve, clipped: Collection[str] = ()
) -> Chain:
    """Return ``records`` and ``holdout`` without what they show of a measuring chain without a model.

    Channels that are ``clipped`` stay as they are: what is taken off a flat top leaves none to be seen. Where
    one is, no filter is looked for: its inverse spreads a clipped top over its neighbours.
    """
    everything: tuple[Record, ...] = (*records, *holdout)
    found: list[Nuisance] = []
    for nuisance in RECORD_NUISANCES:
        result = nuisance.clean(everything, valve)
        everything = tuple(map(partial(_kept, clipped), everything, result.records))
        found += [entry for entry in result.found if entry.channel not in clipped]
    corrections = MOST_CORRECTIONS if clipped else 0
    return Chain(everything[: len(records)], everything[len(records) :], tuple(found), corrections)


def _kept(channels: Collection[str], before: Record, after: Record) -> Record:
    """Return ``after`` with its ``channels`` as ``before``."""
    return replace(
        after,
        body=before.body if "body" in channels else after.body,
        spool=before.spool if "spool" in channels else after.spool,
    )


def nuisances_of(hypothesis: Hypothesis) -> tuple[str, ...]:
    """Return the nuisances among the effects of ``hypothesis``."""
    return tuple(name for name in hypothesis.effects if name in CHAIN)


def _together(found: Sequence[Nuisance]) -> tuple[Nuisance, ...]:
    """Return ``found`` with the sizes of what stands in it twice added up."""
    sums: dict[tuple[str, str], Nuisance] = {}
    for entry in found:
        key = entry.id, entry.channel
        known = sums.get(key)
        sums[key] = entry if known is None else replace(entry, size=known.size + entry.size)
    return tuple(sums.values())

"""Spool valves from Python: read records, identify valves, compare friction laws, find what a model lacks.

    import spool

    record = spool.read("record.csv", unit="g")
    valve = spool.valve("4weh10_soft")
    fit = spool.fit(record, valve, model="coulomb")
    print(fit.summary())

Numbers are in SI units. Each result has ``summary()``, ``save()`` and ``to_dict()``, which equals the JSON of
the command of the same name, and shows itself in a notebook. Every function raises ``InputError`` for
input that cannot be used; its message is one line that names what is wrong, where, and what to do.

Libraries that load slowly are imported by the functions that need them.
"""

from __future__ import annotations

from spool_core.errors import InputError

from spool.analysis import compare, fit, gap, replay
from spool.fleet_store import Fleet, fleet
from spool.record import Record, read, simulate, valve
from spool.results import Comparison, Fit, Gap, Picture, Quality, Replay, Result

__all__ = [
    "Comparison",
    "Fit",
    "Fleet",
    "Gap",
    "InputError",
    "Picture",
    "Quality",
    "Record",
    "Replay",
    "Result",
    "compare",
    "fit",
    "fleet",
    "gap",
    "read",
    "replay",
    "simulate",
    "valve",
]

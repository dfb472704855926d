"""Spool valves from Python: read records, identify valves, compare friction laws, find what a model lacks.

    import spool

    record = spool.read("record.csv", unit="g")
    valve = spool.valve("4weh10_soft")
    fit = spool.fit(record, valve, model="coulomb")
    print(fit.summary())

Numbers are in SI units, oil temperatures in deg C. Each result has ``summary()``, ``save()`` and
``to_dict()``, which equals the JSON of the command of the same name, and shows itself in a notebook. Every
function raises ``InputError`` for input that cannot be used; its message is one line that names what is
wrong, where, and what to do.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from spool_core.errors import InputError
from spool_report.outputs import package_version

if TYPE_CHECKING:
    from spool.analysis import compare, fit, fit_setups, gap, replay, what_if
    from spool.fleet_store import Fleet, fleet
    from spool.record import Record, export_fmu, read, simulate, valve
    from spool.results import Comparison, Fit, Gap, Picture, Quality, Replay, Result, SetUpsFit, WhatIf

    __version__: str

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
    "SetUpsFit",
    "WhatIf",
    "compare",
    "export_fmu",
    "fit",
    "fit_setups",
    "fleet",
    "gap",
    "read",
    "replay",
    "simulate",
    "valve",
    "what_if",
]


def __dir__() -> list[str]:
    """Return the interface, for completion in notebooks."""
    return [*__all__, "__version__"]


def __getattr__(name: str) -> Any:
    """Look up the version, or load a part of the interface: its libraries take a moment."""
    if name == "__version__":
        return package_version()
    if name in __all__:
        for part in ("fleet_store", "results", "record", "analysis"):
            if found := getattr(import_module(f"spool.{part}"), name, None):
                return found
    raise AttributeError(f"module 'spool' has no attribute {name!r}")

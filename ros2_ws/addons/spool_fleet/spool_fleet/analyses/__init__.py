"""Analyses of one record of one valve; each module declares one as ``ANALYSIS``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any

from spool_core.errors import InputError
from spool_core.text import did_you_mean
from spool_sim.valve import Valve

if TYPE_CHECKING:  # slow to load
    from spool_report.runs.record_replay import ReplaySettings

Rows = dict[str, list[list[Any]]]
#: deg C to which viscous coefficients of different records are referred: that of ISO 3448's grades.
REFERENCE = 40.0
REFERRED = "viscous_coefficient_at_40C"


@dataclass(frozen=True, slots=True)
class Subject:
    """Record that is analysed: the valve ``namespace`` of the bag at ``path``, described by ``valve_file``.

    ``valve_file`` is a file or a shipped valve's name; ``None``: the bag describes its valve. ``settings``
    are those of a replay; ``None``: the shipped ones.
    """

    path: Path
    namespace: str
    valve_file: str | None = None
    settings: ReplaySettings | None = None


@dataclass(frozen=True, slots=True)
class Analysis:
    """Analysis by ``name``: ``run`` returns rows by table, without the columns that say which record it is.

    ``run`` raises InputError with the reason where the record does not allow it.
    """

    name: str
    run: Callable[[Subject], Rows] = field(compare=False)
    line: str = ""


@cache
def analyses() -> dict[str, Analysis]:
    """Return every analysis that a module of this folder declares as ``ANALYSIS``, by name."""
    modules = [import_module(f"{__name__}.{found.name}") for found in iter_modules(__path__)]
    found = [module.ANALYSIS for module in modules if hasattr(module, "ANALYSIS")]
    return {one.name: one for one in sorted(found, key=lambda one: str(one.name))}


def chosen(text: str) -> tuple[str, ...]:
    """Return the names in ``text``, separated by commas.

    Raises:
        InputError: there is no such analysis.
    """
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    for name in names:
        if name not in analyses():
            known = ", ".join(analyses())
            raise InputError(f"--analysis {name}: known are {known}{did_you_mean(name, list(analyses()))}")
    if not names:
        raise InputError(f"--analysis: name one or more of {', '.join(analyses())}")
    return names


def parameter(analysis: str, model: str, name: str, quantity: dict[str, Any]) -> list[Any]:
    """Return a row of the table ``parameters`` from a quantity as JSON has it."""
    return [analysis, model, name, quantity.get("value"), quantity.get("std"), quantity.get("unit", "")]


def referred(analysis: str, model: str, valve: Valve, quantity: dict[str, Any]) -> list[list[Any]]:
    """Return the row of a viscous coefficient at ``REFERENCE``; given is that at the valve's temperature.

    There is none where the valve names no oil, or its law does not reach so far.
    """
    try:
        ratio = valve.dynamic_viscosity_at(REFERENCE) / valve.dynamic_viscosity
    except InputError:
        return []
    scaled = {name: ratio * quantity[name] for name in ("value", "std") if quantity[name] is not None}
    return [parameter(analysis, model, REFERRED, {**quantity, **scaled})]

"""Completion of values on the command line: names that the suite ships."""

from __future__ import annotations


def valve_names(incomplete: str) -> list[str]:
    """Return the shipped valves that begin so."""
    from spool_sim.valve.description import shipped_valves  # noqa: PLC0415 - slow to load, as below

    return [name for name in shipped_valves() if name.startswith(incomplete)]


def model_names(incomplete: str) -> list[str]:
    """Return the models that begin so."""
    from spool_sim.model import MODELS  # noqa: PLC0415

    return [name for name in MODELS if name.startswith(incomplete)]


def excitation_names(incomplete: str) -> list[str]:
    """Return the excitations that begin so."""
    from spool_sim.excitation.presets import PRESETS  # noqa: PLC0415

    return [name for name in PRESETS if name.startswith(incomplete)]

"""The estimator of a running valve, and its settings."""

from __future__ import annotations

import zlib
from typing import Any

from spool_sim.valve import Valve

from spool_estimator.identification.oil import oil_law
from spool_estimator.stream_estimator import Estimator, EstimatorSettings

__all__ = ["PHASES", "Estimator", "phase_of", "settings_for"]

#: How many phases the estimates of several valves are spread over.
PHASES = 10


def phase_of(name: str) -> int:
    """Return a phase that spreads the estimates of many valves; the same name always has the same.

    ``name`` is the valve's namespace, with or without the slash in front.
    """
    return zlib.crc32(name.strip("/").encode()) % PHASES


def settings_for(valve: Valve, **changes: Any) -> EstimatorSettings:
    """Return the settings that a valve's description gives, with ``changes`` by name."""
    return EstimatorSettings(
        moving_mass=valve.moving_mass,
        oil=oil_law(valve),
        **{
            "spring_stiffness": valve.spring_stiffness,
            "viscous_coefficient": valve.likely_viscous_coefficient,
            **changes,
        },
    )

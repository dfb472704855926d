"""Scenario of the demonstration: two valves, a resonance passage and a friction drift each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from spool_sim.excitation.kinds import from_mapping

#: Shares of the run: the machine runs steadily, passes the resonance, runs steadily while friction drifts.
PASSAGE = (0.38, 0.5, 0.62)
DRIFT = (0.63, 0.10)


@dataclass(frozen=True, slots=True)
class DemoValve:
    """Valve of the demonstration.

    ``steady_speed`` and ``resonant_speed`` (rpm) of the shaft that shakes it; ``drift`` is the quantity that
    changes, from its start value to ``drift_target`` (SI unit).
    """

    name: str
    valve_file: str
    coulomb_force: float
    steady_speed: float
    resonant_speed: float
    drift: str
    drift_target: float
    story: str

    def excitation(self, seconds: float) -> dict[str, Any]:
        """Return the excitation of a run of ``seconds`` s as it stands in the YAML file."""
        begin, middle, end = (share * seconds for share in PASSAGE)
        profile = [
            [0.0, self.steady_speed],
            [begin, self.steady_speed],
            [middle, self.resonant_speed],
            [end, self.steady_speed],
        ]
        return {
            "kind": "machine_orders",
            "speed_profile": profile,
            "orders": [[1.0, 8.0], [2.0, 2.0]],
            "broadband_rms": 1.5,
        }

    def write_excitation(self, folder: Path, seconds: float) -> Path:
        """Write the excitation as a YAML file that the simulator node takes; return its path."""
        mapping = self.excitation(seconds)
        from_mapping(mapping)
        path = folder / f"excitation_{self.name}.yaml"
        path.write_text(yaml.safe_dump(mapping, sort_keys=False), encoding="utf-8")
        return path


VALVES = (
    DemoValve(
        name="valve_1",
        valve_file="4weh10_soft",
        coulomb_force=0.1,
        steady_speed=1500.0,
        resonant_speed=900.0,
        drift="coulomb_force",
        drift_target=0.35,
        story="dirty oil: Coulomb friction rises from 0.10 to 0.35 N",
    ),
    DemoValve(
        name="valve_2",
        valve_file="4weh10_stiff",
        coulomb_force=0.1,
        steady_speed=1080.0,
        resonant_speed=1720.0,
        drift="viscous_coefficient",
        drift_target=1.6,
        story="wear: the viscous coefficient falls from 2.65 to 1.60 N s/m",
    ),
)

"""Check of a valve file: what follows from it, what looks wrong, and whether a record agrees."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spool_core.errors import InputError
from spool_estimator.plausibility import ValveCheck
from spool_sim.valve import FILM, OPTIONAL, STEEL, Valve, read_mapping, shipped_valves, valve_from_mapping

#: Hz: 35 times the stiffest of the paper's table 2 (29 Hz): a mass or a stiffness in another unit is more
#: likely than such springs, and a factor of 1000 between units moves a frequency by 32.
HIGHEST_FREQUENCY = 1000.0
#: kg: below it nothing but a pilot's pin moves, a steel cylinder of 3 mm diameter and 10 mm length.
LIGHTEST = STEEL * 0.25 * math.pi * 0.003**2 * 0.010
#: Share of the land's diameter: 13 times that of the paper's valve (15 um of 20 mm); leakage grows with the
#: third power of the clearance, so such a land seals nothing.
WIDEST_SHARE = 0.01


@dataclass(slots=True)
class ValveVerdict:
    """Verdict on a valve file; ``valve`` is ``None`` where its numbers cannot be used, ``wrong`` says why."""

    file: str
    valve: Valve | None
    wrong: list[str] = field(default_factory=list)
    shown: dict[str, Any] | None = None

    def dictionary(self) -> dict[str, Any]:
        """Return the verdict as JSON has it."""
        valve = self.valve
        known = valve is not None and valve.knows(*FILM)
        return {
            "file": self.file,
            "id": valve.id if valve else None,
            "natural_frequency_Hz": valve.natural_frequency if valve else None,
            "damping_ratio": valve.damping_ratio if valve and known else None,
            "viscous_coefficient": valve.viscous_coefficient if valve and known else None,
            "not_given": [name for name in OPTIONAL if valve and not valve.knows(name)],
            "wrong": self.wrong,
            "record": self.shown,
        }


def judged(file: str) -> ValveVerdict:
    """Return what looks wrong in a valve's file, or a shipped valve's, by its numbers alone.

    Raises:
        InputError: no such file, unknown or needed keys that are missing.
    """
    path = shipped_valves().get(file, Path(file))
    if not path.exists():
        raise InputError(f"{file}: no such valve file; shipped ones are {', '.join(shipped_valves())}")
    mapping = read_mapping(path, "valve")
    needed = {name for name, one in Valve.model_fields.items() if one.is_required()}
    try:
        valve = valve_from_mapping(mapping, str(file))
    except InputError as error:
        if set(mapping) - set(Valve.model_fields) or needed - set(mapping):
            raise
        return ValveVerdict(file, None, [str(error).removeprefix(f"{file}: ")])
    return ValveVerdict(file, valve, _odd(valve))


def _odd(valve: Valve) -> list[str]:
    """Return what a valve can hardly have, beyond what no description may hold."""
    said = []
    frequency, mass = valve.natural_frequency, valve.moving_mass
    if frequency > HIGHEST_FREQUENCY:
        said.append(
            f"natural frequency: {frequency:.4g} Hz by moving_mass {mass:g} kg and spring_stiffness "
            f"{valve.spring_stiffness:g} N/m: no spring centres a spool so stiffly; the file takes kg and N/m"
        )
    if mass < LIGHTEST:
        said.append(f"moving_mass: {mass:g} kg is less than a pin of 3 mm; the file takes kg, not t")
    if valve.knows("spool_mass") and valve.spool_mass == mass:
        said.append(
            "moving_mass: it is spool_mass: oil and a third of the springs move with the spool; "
            "`./spool valve new` adds them"
        )
    if valve.knows("radial_clearance", "land_diameter"):
        clearance, diameter = valve.radial_clearance, valve.land_diameter
        if clearance > WIDEST_SHARE * diameter:
            said.append(
                f"radial_clearance: {1e6 * clearance:.4g} um is more than {100.0 * WIDEST_SHARE:g} % of the "
                "land's diameter, which seals nothing; did you write the diameter's, or another unit? "
                "the file takes m"
            )
    return said


def against_record(verdict: ValveVerdict, check: ValveCheck | None, record: Path) -> None:
    """Add what a record shows of the valve: its natural frequency, the spring that means, contradictions."""
    valve = verdict.valve
    shown = None if check is None else check.natural_frequency
    if valve is None or check is None or shown is None:
        verdict.shown = {"file": str(record), "natural_frequency_Hz": None}
        return
    stiffness = valve.moving_mass * (2.0 * math.pi * shown.middle) ** 2
    verdict.shown = {
        "file": str(record),
        "natural_frequency_Hz": {"value": shown.middle, "low": shown.low, "high": shown.high},
        "spring_stiffness": {"value": stiffness, "unit": "N/m"},
    }
    doubts = check.doubts()
    verdict.wrong += doubts
    if doubts and abs(shown.middle / valve.natural_frequency - 1.0) > 0.1:
        verdict.wrong.append(
            f"spring_stiffness: with moving_mass {valve.moving_mass:g} kg the record's frequency means "
            f"{stiffness:.4g} N/m, the file says {valve.spring_stiffness:g} N/m{_slip(stiffness, valve)}"
        )


#: Factors between units that are mistaken for each other, and what they mean for stiffness over mass.
_SLIPS: Mapping[float, str] = {
    1e3: "a factor of 1000: N/mm in place of N/m, or g in place of kg",
    1e6: "a factor of a million: N/mm in place of N/m, and g in place of kg",
    2.0: "a factor of 2: one spring's rate in place of that of both",
    0.5: "a factor of 1/2: both springs' rate counted twice",
}


def _slip(stiffness: float, valve: Valve) -> str:
    factor = stiffness / valve.spring_stiffness
    for known, text in _SLIPS.items():
        if abs(math.log(factor / known)) < 0.1:
            return f": {text}"
    return ""

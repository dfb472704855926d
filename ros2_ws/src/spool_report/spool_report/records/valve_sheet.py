"""Valve file: written from a data sheet, and checked against a record."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spool_core.errors import InputError
from spool_core.files import load_yaml
from spool_core.numbers import GRAVITY
from spool_core.text import did_you_mean
from spool_sim import valve as valves
from spool_sim.lubrication import fluid_friction_coefficient
from spool_sim.sensors import PAPER_CHAIN
from spool_sim.valve import Valve

if TYPE_CHECKING:
    from spool_estimator.plausibility import ValveCheck


_SHEET: Any = load_yaml((Path(__file__).parents[1] / "templates" / "valve_sheet.yaml").read_text("utf-8"))
#: One of each unit in SI, by kind of number; the first one is what a number without a unit has.
UNITS: Mapping[str, Mapping[str, float]] = _SHEET["units"]
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\S.*?)?\s*")


@dataclass(frozen=True, slots=True)
class Question:
    """Question for one number of a data sheet: ``key`` is the flag's, ``kind`` one of ``UNITS`` or a text.

    ``otherwise``: number from which this one follows, so that it need not be asked.
    """

    key: str
    kind: str
    text: str
    example: str
    needed: bool = False
    otherwise: str = ""

    @property
    def flag(self) -> str:
        """The option that answers it."""
        return "--" + self.key.replace("_", "-")


QUESTIONS = tuple(
    Question(**{**one, "text": one["text"].format(oils=", ".join(valves.OILS))})
    for one in _SHEET["questions"]
)

#: m/s, a spool at 60 Hz with a stroke of 9 mm exceeds it on average: the paper's conclusions.
SPEED = 0.5

#: Hz: 35 times the stiffest of the paper's table 2 (29 Hz): a mass or a stiffness in another unit is more
#: likely than such springs, and a factor of 1000 between units moves a frequency by 32.
HIGHEST_FREQUENCY = 1000.0
#: kg: below it nothing but a pilot's pin moves, a steel cylinder of 3 mm diameter and 10 mm length.
LIGHTEST = valves.STEEL * 0.25 * math.pi * 0.003**2 * 0.010
#: Share of the land's diameter: 13 times that of the paper's valve (15 um of 20 mm); leakage grows with the
#: third power of the clearance, so such a land seals nothing.
WIDEST_SHARE = 0.01


def number_of(question: Question, text: str) -> float:
    """Return the number in SI units (deg C) that ``text`` says, with or without a unit.

    Raises:
        InputError: no number, or a unit of something else.
    """
    units = UNITS[question.kind]
    if re.search(r"\d,\d", text):
        raise InputError(f"{question.flag}: {text!r} has a comma: write decimals as in '{question.example}'")
    found = _NUMBER.fullmatch(text)
    if found is None:
        raise InputError(f"{question.flag}: {text!r} is no number, write e.g. '{question.example}'")
    unit = " ".join((found[2] or next(iter(units))).split())
    if unit not in units:
        raise InputError(f"{question.flag}: unit {unit!r} is none of {', '.join(units)}")
    # Twelve digits: 15 um is 1.5e-05 m, not 1.4999999999999999e-05.
    return float(f"{float(found[1]) * units[unit]:.12g}")


def asked(
    given: Mapping[str, str], answer: Callable[[str], str], refuse: Callable[[str], None]
) -> dict[str, str]:
    """Return ``given`` with what ``answer`` says to a question for each missing number; empty: not known.

    ``refuse`` gets what is wrong with an answer, which is then asked for again.
    """
    answers = dict(given)
    for question in QUESTIONS:
        if question.key in answers or question.otherwise in answers:
            continue
        while question.key not in answers:
            text = answer(f"{question.text}, e.g. {question.example}").strip()
            if not text and not question.needed:
                break
            try:
                checked_answer(question, text)
            except InputError as error:
                refuse(str(error))
                continue
            answers[question.key] = text
    return answers


def checked_answer(question: Question, text: str) -> float | str:
    """Return what ``text`` says, a number in SI units.

    Raises:
        InputError: it is no answer to ``question``.
    """
    if question.key == "oil":
        try:
            return valves.known_oil(text)
        except InputError as error:
            raise InputError(f"--oil: {error}") from None
    if question.kind == "text":
        if not text:
            raise InputError(f"{question.flag}: name the valve, e.g. {question.example}")
        return text
    return number_of(question, text)


def described(answers: Mapping[str, str]) -> tuple[Valve, dict[str, str]]:
    """Return the valve that a data sheet describes, and by key how a number came about that it does not hold.

    Raises:
        InputError: a name is unknown, mass or stiffness is missing, a number is wrong, or no valve has it.
    """
    known = [one.key for one in QUESTIONS]
    unknown = next((key for key in answers if key not in known), None)
    if unknown is not None:
        hint = did_you_mean(unknown, known)
        raise InputError(f"valve new: {unknown!r} is unknown, known are {', '.join(known)}{hint}")
    said = {one.key: checked_answer(one, answers[one.key]) for one in QUESTIONS if answers.get(one.key)}
    numbers = {key: value for key, value in said.items() if isinstance(value, float)}
    how: dict[str, str] = {}
    if "id" not in said:
        raise InputError("valve new: the name is missing: give --id, e.g. --id press_left")
    _add_mass(numbers, how)
    _add_stiffness(numbers, how)
    oil = str(said["oil"]) if "oil" in said else None
    if oil is not None and "dynamic_viscosity" not in numbers and "oil_temperature" in numbers:
        kinematic = valves.OILS[oil].kinematic_viscosity(numbers["oil_temperature"])
        numbers["dynamic_viscosity"] = float(f"{1e-6 * kinematic * valves.DENSITY:.3g}")
        how["dynamic_viscosity"] = f"{valves.OILS[oil].source}, ASTM D341, {valves.DENSITY:g} kg/m^3"
    wanted = {key: value for key, value in numbers.items() if key in Valve.model_fields}
    mapping = {"id": said["id"], **wanted, **({"oil": oil} if oil else {})}
    return valves.valve_from_mapping(mapping, "valve new"), how


def file_text(valve: Valve, how: Mapping[str, str]) -> str:
    """Return the YAML file of ``valve`` with a comment to each line; what is not known is left to fill in."""
    given: dict[str, object] = {"id": valve.id, **valve.given, **({"oil": valve.oil} if valve.oil else {})}
    lines = [
        "# Valve, by `./spool valve new`. SI units; `./spool valve check` reports values that look wrong."
    ]
    for key, (unit, meaning) in _SHEET["comments"].items():
        entry = f"{key}: {given[key]!r}".replace("'", "") if key in given else f"# {key}:"
        origin = f" ({how[key]})" if key in how else ""
        lines.append(f"{entry:<30} # {', '.join(part for part in (unit, meaning) if part)}{origin}")
    return "\n".join(lines) + "\n"


def quantities(valve: Valve) -> Iterator[str]:
    """Yield a line for each quantity of ``valve``: name, value, unit and meaning."""
    yield f"valve {valve.id}"
    yield f"undamped natural frequency: {valve.natural_frequency:.4g} Hz"
    lacking = [name for name in (*valves.FILM, "oil_temperature") if not valve.knows(name)]
    if lacking:
        yield f"not given: {', '.join(lacking)}: fits do not need them, a simulation and the drag do"
        return
    yield f"damping ratio: {valve.damping_ratio:.3g}, by the oil alone, without dry friction"
    yield f"viscous coefficient: {valve.viscous_coefficient:.4g} N s/m at {valve.oil_temperature:g} deg C"
    if valve.knows("spool_mass"):
        yield (
            f"friction coefficient of the oil film: {friction_coefficient(valve):.3g} (drag at {SPEED:g} m/s "
            "divided by the spool's weight)"
        )
    yield (
        f"up to {valve.radial_clearance / 3.0 * 1e6:.3g} um of combined rms roughness the oil separates the "
        f"surfaces (fluid friction), up to {valve.radial_clearance * 1e6:.3g} um friction is mixed"
    )
    yield (
        "assumed accuracy of a measured acceleration: "
        f"{100.0 * PAPER_CHAIN.relative_uncertainty:.3g} % of the reading"
    )


def friction_coefficient(valve: Valve) -> float:
    """Return the fluid friction coefficient of ``valve`` at SPEED under its spool's weight, equation (6)."""
    return fluid_friction_coefficient(
        dynamic_viscosity=valve.dynamic_viscosity,
        speed=SPEED,
        area=math.pi * valve.land_diameter * valve.land_length,
        normal_load=valve.spool_mass * GRAVITY,
        film_thickness=valve.radial_clearance,
    )


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
        known = valve is not None and valve.knows(*valves.FILM)
        return {
            "file": self.file,
            "id": valve.id if valve else None,
            "natural_frequency_Hz": valve.natural_frequency if valve else None,
            "damping_ratio": valve.damping_ratio if valve and known else None,
            "viscous_coefficient": valve.viscous_coefficient if valve and known else None,
            "not_given": [name for name in valves.OPTIONAL if valve and not valve.knows(name)],
            "wrong": self.wrong,
            "record": self.shown,
        }


def judged(file: str) -> ValveVerdict:
    """Return what looks wrong in a valve's file, or a shipped valve's, by its numbers alone.

    Raises:
        InputError: no such file, unknown or needed keys that are missing.
    """
    mapping = valves.read_mapping(valves.valve_file(file), "valve")
    needed = {name for name, one in Valve.model_fields.items() if one.is_required()}
    try:
        valve = valves.valve_from_mapping(mapping, str(file))
    except InputError as error:
        if set(mapping) - set(Valve.model_fields) or needed - set(mapping):
            raise
        return ValveVerdict(file, None, [str(error).removeprefix(f"{file}: ")])
    # What a valve can hardly have, beyond what no description may hold.
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
    return ValveVerdict(file, valve, said)


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
        factor = stiffness / valve.spring_stiffness
        slip = next(
            (f": {text}" for known, text in _SHEET["slips"].items() if abs(math.log(factor / known)) < 0.1),
            "",
        )
        verdict.wrong.append(
            f"spring_stiffness: with moving_mass {valve.moving_mass:g} kg the record's frequency means "
            f"{stiffness:.4g} N/m, the file says {valve.spring_stiffness:g} N/m{slip}"
        )


def _add_mass(numbers: dict[str, float], how: dict[str, str]) -> None:
    if "moving_mass" in numbers:
        return
    if "spool_mass" not in numbers:
        raise InputError(
            "valve new: the mass is missing: give --moving-mass, or --spool-mass and --spring-mass"
        )
    spring, oil = numbers.get("spring_mass", 0.0), numbers.get("oil_mass", 0.0)
    numbers["moving_mass"] = float(f"{numbers['spool_mass'] + oil + spring / 3.0:.6g}")
    parts = [f"{1e3 * oil:.4g} g of oil" if oil else "no oil", f"{1e3 * spring:.4g} g / 3 of the springs"]
    how["moving_mass"] = f"spool, {parts[0]} and {parts[1] if spring else 'no springs'}"


def _add_stiffness(numbers: dict[str, float], how: dict[str, str]) -> None:
    if "spring_stiffness" in numbers:
        return
    if "spring_rate" in numbers:
        numbers["spring_stiffness"] = 2.0 * numbers["spring_rate"]
        how["spring_stiffness"] = (
            f"two springs of {numbers['spring_rate']:.4g} N/m, both at work in the centre"
        )
    elif "natural_frequency" in numbers:
        frequency = numbers["natural_frequency"]
        stiffness = numbers["moving_mass"] * (2.0 * math.pi * frequency) ** 2
        numbers["spring_stiffness"] = float(f"{stiffness:.4g}")
        how["spring_stiffness"] = f"moving_mass (2 pi {frequency:g} Hz)^2"
    else:
        raise InputError(
            "valve new: the stiffness is missing: give --spring-stiffness, --spring-rate or "
            "--natural-frequency"
        )

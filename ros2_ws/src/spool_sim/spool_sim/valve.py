"""Valve: its description in YAML, its oil, what follows from them by physics, and what is refused.

Viscosity by temperature follows ASTM D341 (Walther's law): log10(log10(nu + 0.7)) = A - B log10(T), with nu
in mm^2/s and T in K. The two catalogue points of an oil give A and B.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    field_validator,
    model_validator,
)
from spool_core.errors import InputError
from spool_core.files import file_of, read_yaml
from spool_core.numbers import GRAVITY
from spool_core.text import printable

CELSIUS_ZERO = 273.15
_OFFSET = 0.7

#: deg C over which catalogue points of hydraulic mineral oils may be extended.
LOWEST_TEMPERATURE, HIGHEST_TEMPERATURE = -40.0, 150.0
#: mm^2/s; below it ASTM D341 wants further terms.
LOWEST_VISCOSITY = 2.0

#: ISO 3448, table 1: the grade's number is the mid-point viscosity at 40 deg C, which may differ by 10 %.
#: That at 100 deg C is what ASTM D2270 gives for the viscosity index VISCOSITY_INDEX.
_GRADES = {10: 2.66, 15: 3.41, 22: 4.29, 32: 5.36, 46: 6.76, 68: 8.73, 100: 11.4}
#: Of the grades: solvent-refined mineral oils of the groups HL and HM (ISO 11158) have 95 to 105.
VISCOSITY_INDEX = 100
#: kg/m^3, density of mineral hydraulic oils, by which dynamic follows from kinematic viscosity: data sheets
#: say 840 to 890 at 15 deg C.
DENSITY = 870.0


@dataclass(frozen=True, slots=True)
class Oil:
    """Hydraulic oil by its catalogue points.

    Attributes:
        name: as in valve files.
        viscosity_40, viscosity_100: kinematic viscosity at 40 and 100 deg C, mm^2/s.
        source: where the points come from.
    """

    name: str
    viscosity_40: float
    viscosity_100: float
    source: str

    def kinematic_viscosity(self, temperature: float) -> float:
        """Return the kinematic viscosity, mm^2/s, at ``temperature`` (deg C).

        Raises:
            InputError: the temperature, or the viscosity there, is outside of what the law holds for.
        """
        if not LOWEST_TEMPERATURE <= temperature <= HIGHEST_TEMPERATURE:
            raise InputError(
                f"oil temperature: {temperature:g} deg C is out of range for {self.name}, "
                f"use {LOWEST_TEMPERATURE:g} to {HIGHEST_TEMPERATURE:g} deg C"
            )
        at_40, at_100 = _double_logarithm(self.viscosity_40), _double_logarithm(self.viscosity_100)
        low, high = math.log10(40.0 + CELSIUS_ZERO), math.log10(100.0 + CELSIUS_ZERO)
        share = (math.log10(temperature + CELSIUS_ZERO) - low) / (high - low)
        viscosity: float = 10.0 ** (10.0 ** (at_40 * (1.0 - share) + at_100 * share)) - _OFFSET
        if viscosity < LOWEST_VISCOSITY:
            raise InputError(
                f"oil temperature: at {temperature:g} deg C {self.name} has {viscosity:.2g} mm^2/s, "
                f"less than the {LOWEST_VISCOSITY:g} mm^2/s down to which ASTM D341 holds; use a lower one"
            )
        return viscosity


def _double_logarithm(viscosity: float) -> float:
    return math.log10(math.log10(viscosity + _OFFSET))


OILS: dict[str, Oil] = {
    oil.name: oil
    for oil in (
        Oil("HL68", 68.0, 8.7, "ISO VG 68 mineral oil, grade HL of DIN 51524-1: typical data sheet"),
        Oil("Azolla ZS22", 22.0, 4.3, "ISO VG 22 mineral oil, grade HM: maker's data sheet"),
        *(
            Oil(f"ISO VG {grade}", float(grade), at_100, f"ISO 3448 with viscosity index {VISCOSITY_INDEX}")
            for grade, at_100 in _GRADES.items()
        ),
    )
}

#: What may stand before a grade's number: of all these the viscosity index is about VISCOSITY_INDEX.
_GRADED = re.compile(r"(?:(?:iso)?vg|hlp?|(?:isol)?hm)?(\d+)")


def known_oil(text: str) -> str:
    """Return the name in ``OILS`` of what a label says: ``HLP 46``, ``VG46`` and ``iso vg 46`` are one grade.

    Raises:
        InputError: no such oil; what is suggested has the number that was given.
    """
    plain = re.sub(r"[\s_-]", "", text).lower()
    exact = next((name for name in OILS if plain == name.replace(" ", "").lower()), None)
    graded, numbers = _GRADED.fullmatch(plain), re.findall(r"\d+", plain)
    name = exact or (f"ISO VG {graded[1]}" if graded else "")
    if name in OILS:
        return name
    near = f"ISO VG {numbers[-1]}" if numbers else ""
    hint = f"; did you mean {near}?" if near in OILS else ""
    raise InputError(f"unknown oil {printable(text, 40)!r}, known are {', '.join(OILS)}{hint}")


#: Keys that a description may leave out, and what each is for: who needs one that is missing says so.
OPTIONAL: Mapping[str, str] = {
    "spool_mass": "the load on the sleeve",
    "land_diameter": "the drag of the oil",
    "land_length": "the drag of the oil",
    "radial_clearance": "the drag of the oil",
    "dynamic_viscosity": "the drag of the oil",
    "oil_temperature": "the temperature at which dynamic_viscosity holds",
}
#: Default of those keys. They have the type of what is given: no instance holds it, see ``Valve``.
_LEFT_OUT: Any = None
#: Keys that the drag follows from, pi d l mu / h.
FILM = ("land_diameter", "land_length", "radial_clearance", "dynamic_viscosity")
#: Share of critical damping where the film is not known: the start of a fit, in the geometric middle of the
#: valves of the paper's table 2 (0.04 to 0.24) and those that oil hardly damps any more (1).
LIKELY_DAMPING = 0.2

#: kg/m^3, density of steel (EN 10088-1 gives 7700 to 8000 for stainless steels, plain steels lie in between).
STEEL = 7850.0
#: Diameters: spools are some 4 to 10 long; four times the longest, of solid steel, is the heaviest believed.
LONGEST = 40.0
#: Share of a solid steel land that the lightest spool weighs: aluminium is a third of steel, a tube with thin
#: walls some tenth of that, and a third of it is left as a margin.
LIGHTEST = 0.01
#: Pa s: some 30 times ISO VG 680 at 40 deg C, one of the thickest grades of ISO 3448.
THICKEST = 20.0
#: m, sag under the spool's weight where no land is known: springs of 1.6 Hz, softer than any that centre a
#: spool (the softest of the paper's table 2 have 15 Hz, 1 mm).
LARGEST_SAG = 0.1

#: Units that people write instead, by key: name, value of one in SI.
_SLIPS: Mapping[str, tuple[tuple[str, float], ...]] = {
    "moving_mass": (("g", 1e-3),),
    "spool_mass": (("g", 1e-3),),
    "spring_stiffness": (("N/mm", 1e3),),
    "land_diameter": (("mm", 1e-3),),
    "land_length": (("mm", 1e-3),),
    "radial_clearance": (("um", 1e-6), ("mm", 1e-3)),
    "dynamic_viscosity": (("mPa s", 1e-3),),
}

#: Faults that one line of error names: chosen, it stays readable.
MOST_FAULTS = 10


def _refuse_boolean(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("must be a number, not a yes/no value")
    return value


# YAML 1.1 reads 15e-6 as text: text that is a number is taken as the number.
Number = Annotated[float, BeforeValidator(_refuse_boolean), Field(allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0.0)]
NotNegative = Annotated[Number, Field(ge=0.0)]


class Component(BaseModel):
    """Part of the machine that turns with the measured shaft and may shake the valve. Frozen.

    Attributes:
        name: one word, as events show it, e.g. ``pump``.
        ratio: its speed over the measured one.
        pistons: of a piston pump or motor, or teeth of a gear pump: pressure pulses per revolution.
        strokes, cylinders: of a combustion engine; it fires ``2 cylinders / strokes`` times per revolution.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(pattern=r"^[^\W\d_][\w-]*$", max_length=30)
    ratio: Annotated[Positive, Field(ge=0.01, le=100.0)] = 1.0
    pistons: Annotated[int, Field(ge=1, le=200)] | None = None
    strokes: Literal[2, 4] | None = None
    cylinders: Annotated[int, Field(ge=1, le=48)] | None = None

    @model_validator(mode="after")
    def _engine_or_pump(self) -> Component:
        if (self.strokes is None) != (self.cylinders is None):
            raise ValueError("strokes and cylinders describe an engine together: give both or neither")
        if self.pistons is not None and self.strokes is not None:
            raise ValueError("give pistons of a pump, or strokes and cylinders of an engine")
        return self

    @property
    def orders(self) -> dict[float, bool]:
        """Orders of its revolutions that it shakes with; whether each is its own and not any shaft's.

        A shaft shakes with 1 (unbalance) and 2 (misalignment, joints), a pump with its pistons, an engine of
        four strokes with halves, too, and with each firing; pulses come with their first two harmonics.
        """
        found = {1.0: False, 2.0: False}
        if self.strokes is not None and self.cylinders is not None:
            pulses = 2.0 * self.cylinders / self.strokes
            first = 2.0 / self.strokes
            found |= {first * number: False for number in range(1, round(2.0 * pulses / first) + 1)}
        else:
            pulses = float(self.pistons or 0)
        return found | {pulses * harmonic: True for harmonic in (1, 2, 3) if pulses}


class Valve(BaseModel):
    """A spool with its centring springs, its land and its oil. Frozen; SI units.

    ``id``, ``moving_mass`` and ``spring_stiffness`` are always there. Reading one of the others that was
    not given raises an :class:`InputError` that names it; ``knows`` tells beforehand.

    Attributes:
        id: name of the valve, the ``frame_id`` of its blocks.
        moving_mass: spool + oil + 1/3 of the springs, kg.
        spool_mass: spool alone, kg.
        spring_stiffness: equivalent of both centring springs, N/m.
        land_diameter, land_length: of the sealing land, m.
        radial_clearance: gap between spool and bore, m.
        dynamic_viscosity: Pa s, holds at ``oil_temperature``.
        oil: name of the viscosity-temperature law, or ``None``.
        oil_temperature: deg C.
        components: what turns with the machine's shaft; events name the one whose order shakes the valve.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str = Field(pattern=r"^[A-Za-z0-9_.\-]+$", max_length=100)
    moving_mass: Annotated[Positive, Field(ge=1e-4, le=1e5)]
    spool_mass: Annotated[Positive, Field(ge=1e-4, le=1e5)] = Field(default=_LEFT_OUT)
    spring_stiffness: Annotated[Positive, Field(ge=1.0, le=1e10)]
    land_diameter: Annotated[Positive, Field(ge=1e-4, le=1.0)] = Field(default=_LEFT_OUT)
    land_length: Annotated[Positive, Field(ge=1e-4, le=1.0)] = Field(default=_LEFT_OUT)
    radial_clearance: Annotated[Positive, Field(ge=1e-7, le=1e-3)] = Field(default=_LEFT_OUT)
    dynamic_viscosity: Annotated[Positive, Field(ge=1e-5, le=100.0)] = Field(default=_LEFT_OUT)
    oil: str | None = None
    oil_temperature: Annotated[Number, Field(ge=-60.0, le=250.0)] = Field(default=_LEFT_OUT)
    components: Annotated[tuple[Component, ...], Field(max_length=20)] = ()

    @field_validator("components")
    @classmethod
    def _own_names(cls, components: tuple[Component, ...]) -> tuple[Component, ...]:
        names = [one.name for one in components]
        if len(set(names)) < len(names):
            raise ValueError("two components have one name")
        return components

    @field_validator("oil")
    @classmethod
    def _known_oil(cls, oil: str | None) -> str | None:
        return None if oil is None else known_oil(oil)

    @model_validator(mode="after")
    def _fits_together(self) -> Valve:
        for name in OPTIONAL:
            if self.__dict__[name] is None:
                del self.__dict__[name]
        if self.knows("spool_mass") and self.spool_mass > self.moving_mass:
            raise ValueError("spool_mass is part of moving_mass and cannot be larger")
        known = self.knows("radial_clearance", "land_diameter")
        if known and self.radial_clearance >= 0.5 * self.land_diameter:
            raise ValueError("radial_clearance is larger than the spool's radius")
        said = implausible(self.given)
        if said:
            raise ValueError("; ".join(said))
        return self

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> float:
            """Say that an optional key is missing; only asked where it is."""
            if name in OPTIONAL:
                raise InputError(
                    f"valve '{self.id}': {name}: key is missing, {OPTIONAL[name]} needs it; add it"
                )
            return super().__getattr__(name)

    def knows(self, *names: str) -> bool:
        """Return whether all of the keys ``names`` were given."""
        return all(name in self.__dict__ for name in names)

    @property
    def given(self) -> dict[str, float]:
        """The numbers that were given, by key."""
        return {name: value for name, value in self.__dict__.items() if isinstance(value, float)}

    @property
    def viscous_coefficient(self) -> float:
        """Newton's drag in the annular gap, N s/m: pi d l mu / h (the paper's equations 7 and 12).

        Raises:
            InputError: a key that it follows from is missing.
        """
        viscosity = self.dynamic_viscosity  # before the gap: what oil it is, people know first
        return math.pi * self.land_diameter * self.land_length * viscosity / self.radial_clearance

    @property
    def likely_viscous_coefficient(self) -> float:
        """The same for a fit to start from: where the film is not known that of ``LIKELY_DAMPING``."""
        if self.knows(*FILM):
            return self.viscous_coefficient
        return 2.0 * LIKELY_DAMPING * math.sqrt(self.spring_stiffness * self.moving_mass)

    @property
    def likely_spool_mass(self) -> float:
        """``spool_mass``, kg; where it is not known ``moving_mass``, of which it is nearly all."""
        return self.spool_mass if self.knows("spool_mass") else self.moving_mass

    @property
    def oil_ratio_known(self) -> bool:
        """Whether viscosities at other temperatures follow from the description."""
        return self.oil is not None and self.knows("dynamic_viscosity", "oil_temperature")

    def dynamic_viscosity_at(self, temperature: float) -> float:
        """Return the dynamic viscosity, Pa s, at ``temperature`` (deg C) of the oil.

        ASTM D341 through the oil's catalogue points gives the ratio to the viscosity at ``oil_temperature``;
        at that temperature the value is exactly ``dynamic_viscosity``. The density is taken as constant.

        Raises:
            InputError: the valve names no oil, or a temperature is out of the law's range.
        """
        if self.oil is None:
            raise InputError(
                f"valve '{self.id}': oil: key is missing, viscosity at {temperature:g} deg C needs it; "
                f"add one of {', '.join(OILS)}"
            )
        oil, here, viscosity = OILS[self.oil], self.oil_temperature, self.dynamic_viscosity
        try:
            ratio = oil.kinematic_viscosity(temperature) / oil.kinematic_viscosity(here)
        except InputError as error:
            raise InputError(f"valve '{self.id}': {error}") from None
        return viscosity * ratio

    def at(self, temperature: float) -> Valve:
        """Return this valve with its oil at ``temperature`` (deg C).

        Raises:
            InputError: as :meth:`dynamic_viscosity_at`.
        """
        viscosity = self.dynamic_viscosity_at(temperature)
        return self.model_copy(update={"dynamic_viscosity": viscosity, "oil_temperature": temperature})

    @property
    def natural_frequency(self) -> float:
        """Undamped natural frequency, Hz."""
        return math.sqrt(self.spring_stiffness / self.moving_mass) / (2.0 * math.pi)

    @property
    def damping_ratio(self) -> float:
        """Share of critical damping, from viscous drag alone."""
        return self.viscous_coefficient / (2.0 * math.sqrt(self.spring_stiffness * self.moving_mass))


_COMPONENTS = TypeAdapter(tuple[Component, ...])


def valve_from_mapping(mapping: dict[str, Any], where: str = "valve") -> Valve:
    """Return the valve that ``mapping`` describes.

    Raises:
        InputError: unknown or missing key, value out of range; ``where`` and the key are named.
    """
    try:
        return Valve.model_validate(mapping)
    except ValidationError as error:
        guesses = unit_guesses(mapping, _out_of_range(error))
        said = str(one_line(error, where, tuple(Valve.model_fields)))
        raise InputError("; ".join([said, *guesses])) from None


def components_text(valve: Valve) -> str:
    """Return the components of ``valve`` as JSON, empty where it has none: what messages and bags hold."""
    return _COMPONENTS.dump_json(valve.components, exclude_none=True).decode() if valve.components else ""


def components_of(text: str, where: str) -> tuple[Component, ...]:
    """Return the components that ``text``, of :func:`components_text`, describes.

    Raises:
        InputError: it describes none; ``where`` is named.
    """
    try:
        return _COMPONENTS.validate_json(text) if text else ()
    except ValidationError as error:
        raise one_line(error, f"{where}: components", tuple(Component.model_fields)) from None


def load_valve(path: str | Path) -> Valve:
    """Return the valve that the YAML file describes.

    Raises:
        InputError: file unreadable, unknown or missing key, value out of range.
    """
    return valve_from_mapping(read_mapping(path, "valve"), str(path))


def shipped_valves() -> dict[str, Path]:
    """Return the valve files that come with the package, by name."""
    return {path.stem: path for path in sorted((Path(__file__).parent / "valves").glob("*.yaml"))}


def find_valve(name: str | Path) -> Valve:
    """Return the valve of a YAML file, or a shipped one by its name.

    Raises:
        InputError: neither, or the file is not a valve's description.
    """
    return load_valve(valve_file(name))


def valve_file(name: str | Path) -> Path:
    """Return the file of a shipped valve by its name, or the file that ``name`` names.

    Raises:
        InputError: there is neither.
    """
    shipped = shipped_valves()
    return shipped.get(str(name)) or file_of(name, "valve file", shipped)


def implausible(given: Mapping[str, float]) -> list[str]:
    """Return a sentence for each number that no spool valve has; empty where all can be.

    Bounds follow from the valve's own geometry, so that they hold for every size: the mass of a steel
    cylinder of the land's diameter, and the sag under the spool's own weight.

    Args:
        given: numbers of a description that lie within their bounds, by key; missing ones are not judged.
    """
    said = _masses(given)
    mass, stiffness = given["moving_mass"], given["spring_stiffness"]
    sag = mass * GRAVITY / stiffness
    if sag > given.get("land_length", LARGEST_SAG) and not said:
        said.append(
            f"spring_stiffness: {stiffness:g} N/m would give way by {sag:.2g} m under the "
            f"spool's own weight; did you write N/mm? the file takes N/m: {1e3 * stiffness:g}"
            + ("" if "land_diameter" in given else f"; or moving_mass in g? it takes kg: {mass / 1e3:g}")
        )
    viscosity = given.get("dynamic_viscosity", 0.0)
    if viscosity > THICKEST:
        said.append(
            f"dynamic_viscosity: {viscosity:g} Pa s is no hydraulic oil; did you write mPa s? "
            f"the file takes Pa s: {viscosity / 1e3:g}"
        )
    return said


def unit_guesses(mapping: Mapping[str, Any], refused: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return a guess for each refused number that another unit would explain.

    Args:
        mapping: keys and values as the file has them.
        refused: lowest and highest value allowed, by the key of each number that lies outside.
    """
    said = []
    for key, (lowest, highest) in refused.items():
        try:
            value = float(mapping[key])
        except (KeyError, TypeError, ValueError):
            continue
        for unit, factor in _SLIPS.get(key, ()):
            if lowest <= value * factor <= highest:
                said.append(f"{key}: did you write {unit}? that would be {value * factor:g}")
                break
    return said


def read_mapping(path: str | Path, what: str) -> dict[str, Any]:
    """Return the mapping that the YAML file ``path`` holds.

    Args:
        path: file to read.
        what: what the file describes, for the message ("valve", "excitation").

    Raises:
        InputError: as :func:`read_yaml`, or not a mapping with text keys.
    """
    content = read_yaml(path, what)
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise InputError(f"{path}: a {what} file is a list of 'key: value' lines, this one is not")
    return content


def one_line(error: ValidationError, where: str, known: tuple[str, ...] = ()) -> InputError:
    """Return the user's error for what pydantic found: every fault, with its key path, in one line.

    Args:
        error: what pydantic raised.
        where: file or parameter that was read.
        known: keys that are allowed, named when an unknown key was found.
    """
    faults = []
    for fault in error.errors(include_url=False):
        path = ".".join(str(part) for part in fault["loc"])
        if fault["type"] == "extra_forbidden":
            listed = f" (known: {', '.join(known)})" if known else ""
            faults.append(f"{path}: unknown key, remove or correct it{listed}")
        elif fault["type"] == "missing":
            faults.append(f"{path}: key is missing, add it")
        else:
            given = "" if isinstance(fault["input"], dict) else f", got {fault['input']!r}"
            given = given if len(given) <= 86 else f"{given[:83]}..."
            message = fault["msg"].removeprefix("Value error, ")
            said = f"{message[0].lower()}{message[1:]}{given}"
            faults.append(f"{path}: {said}" if path else said)
    if len(faults) > MOST_FAULTS:
        faults = [*faults[:MOST_FAULTS], f"and {len(faults) - MOST_FAULTS} more"]
    return InputError(f"{where}: {'; '.join(faults)}".replace("\n", " "))


def _out_of_range(error: ValidationError) -> dict[str, tuple[float, float]]:
    """Return the range allowed of each number that lies outside, by its key."""
    keys = [str(fault["loc"][0]) for fault in error.errors() if fault["type"].endswith("_than_equal")]
    found = {}
    for key in keys:
        limits = Valve.model_fields[key].metadata
        lowest = max((limit.ge for limit in limits if hasattr(limit, "ge")), default=-math.inf)
        highest = min((limit.le for limit in limits if hasattr(limit, "le")), default=math.inf)
        found[key] = (lowest, highest)
    return found


def _masses(given: Mapping[str, float]) -> list[str]:
    """Judge the masses by the land; where that is not known they are judged with the spring alone."""
    if "land_diameter" not in given:
        return []
    diameter = given["land_diameter"]
    area = 0.25 * math.pi * diameter**2
    heaviest = STEEL * area * LONGEST * diameter
    lightest = LIGHTEST * STEEL * area * given.get("land_length", 0.0)
    masses = {key: given[key] for key in ("moving_mass", "spool_mass") if key in given}
    said = [
        f"{key}: {mass:g} kg is less than {100.0 * LIGHTEST:g} % of its land in steel ({lightest:.2g} kg); "
        "the file takes kg"
        for key, mass in masses.items()
        if mass < lightest
    ]
    heavy = {key: mass for key, mass in masses.items() if mass > heaviest}
    if heavy:  # the moving mass may follow from the spool's, and then one slip makes both
        written = ", ".join(f"{key}: {mass:g} kg" for key, mass in heavy.items())
        meant = ", ".join(f"{key}: {mass / 1e3:g}" for key, mass in heavy.items())
        said.append(
            f"{written}: no spool of {1e3 * diameter:g} mm diameter (solid steel, {LONGEST:g} diameters "
            f"long: {heaviest:.3g} kg); did you write g? the file takes kg: {meant}; valve new takes "
            f"{list(heavy.values())[-1]:g}g"
        )
    return said

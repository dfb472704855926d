"""`./spool what-if`: the response of a valve under changed conditions, beside that of today."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.text import did_you_mean
from spool_core.uncertainty import LEFT_OUT, exact, named, number, percent, unit_text
from spool_monitor.channels import transfer
from spool_monitor.detectors.resonance import AMPLIFICATION_ON
from spool_report.records.simulation import find_excitation
from spool_report.terminal import progress
from spool_sim.excitation import MachineOrders, SteadySine, SteppedSine, SweptSine
from spool_sim.integration.composed_motion import ComposedMotion
from spool_sim.integration.periodic import TOLERANCE, sine_response
from spool_sim.model import Model, load_model
from spool_sim.valve import DENSITY, OILS, Valve, find_valve

#: Model of a valve without a model file: a description states mass, springs and film, and no dry friction.
DEFAULT_MODEL = "fluid"
#: m/s^2, of the paper's series and of the preset ``sweep``.
DEFAULT_AMPLITUDE = 10.0
#: Draws from the uncertainty: of 200 the fifth and the sixth from either end bound 95 %, and what scatters in
#: these bounds is a tenth of their distance.
DRAWS = 200
#: Frequencies of the first look, and how often the neighbourhood of a peak is halved: a peak of 1 % of
#: critical damping is read within 0.1 %.
POINTS, HALVINGS = 60, 4
#: Times the natural frequencies that are shown around them.
REACH = 4.0
#: Depth of the valley, relative to the peak, from which a peak is one: ten times what settling leaves.
LEAST_PEAK = 10.0 * TOLERANCE
#: Fall beside a peak, relative to it, from which the peak is the edge of a jump: halved spacings are finer.
CLIFF = 0.1
#: Excitation amplitudes, over the given one, at which the dependence on the amplitude is shown.
MULTIPLES = (0.25, 0.5, 1.0, 2.0, 4.0)
#: Spool over machine acceleration from which a speed is to be avoided: the monitor's limit for a resonance.
LIMIT = AMPLIFICATION_ON.default
#: Attribute of a valve that follows from the oil's viscosity.
DRAG = "likely_viscous_coefficient"


@dataclass(frozen=True, slots=True)
class WhatIfRequest:
    """Change and excitation to predict the response for.

    Attributes:
        valve: name or YAML file.
        model: name or YAML file; default: ``DEFAULT_MODEL``.
        spring_stiffness: N/m.
        changed: further parameters, each ``PARAMETER=VALUE``.
        oil: name of another oil.
        oil_temperature: deg C.
        mount_frequency, mount_damping: natural frequency (Hz) and damping ratio of a mount between machine
            and valve body; both or neither.
        excitation: preset or file of sines; in place of what follows.
        amplitude: peak acceleration of the machine, m/s^2.
        frequency_range: Hz, ``LOW:HIGH``.
        speed_range: rev/min, ``LOW:HIGH``.
        orders: of the shaft.
    """

    valve: str
    model: str | None = None
    spring_stiffness: float | None = None
    changed: Sequence[str] = ()
    oil: str | None = None
    oil_temperature: float | None = None
    mount_frequency: float | None = None
    mount_damping: float | None = None
    excitation: str | None = None
    amplitude: float | None = None
    frequency_range: str | None = None
    speed_range: str | None = None
    orders: str | None = None


@dataclass(frozen=True, slots=True)
class Drive:
    """Sines of the machine.

    Attributes:
        frequencies: Hz, shape (f,); ``None``: chosen around the natural frequencies.
        fixed: no frequencies may be added to them.
        speeds: lowest and highest, rev/min; ``None`` without a shaft.
        orders: with the amplitude of each, m/s^2; empty without a shaft.
        amplitude: of the curve over frequency, m/s^2: the largest.
        note: what of an excitation is left out, empty for nothing.
    """

    frequencies: Array | None
    fixed: bool
    speeds: tuple[float, float] | None
    orders: tuple[tuple[float, float], ...]
    amplitude: float
    note: str = ""


@dataclass(frozen=True, slots=True)
class Condition:
    """A valve on its mount.

    Attributes:
        values: of the model's parameters.
        sets: draws of them, shape (draws, p); none where the uncertainty is not known.
        mount: natural frequency (Hz) and damping ratio, ``None`` without one.
    """

    values: Mapping[str, float]
    sets: Array
    mount: tuple[float, float] | None = None

    def passed(self, frequency: float) -> complex:
        """Return the acceleration of the valve's body over the machine's at ``frequency`` (Hz).

        The mount is a separate base-excited oscillator; the spool is too light to act back on it.
        """
        if self.mount is None:
            return 1.0 + 0.0j
        natural = 2.0 * math.pi * self.mount[0]
        return complex(transfer(frequency, natural**2, 2.0 * self.mount[1] * natural))


@dataclass(frozen=True, slots=True)
class Curve:
    """Response over frequency at one amplitude; the first row of both tables is that of the best values.

    Attributes:
        frequency: Hz, shape (f,), rising.
        ratios: spool acceleration over the machine's, shape (1 + draws, f); NaN where it is not periodic.
        strokes: largest distance of the spool from the centre, m, same shape.
    """

    frequency: Array
    ratios: Array
    strokes: Array

    def peaks(self) -> list[int]:
        """Return the places of the resonances: above 1 and above the valleys on both sides."""
        row = self.ratios[0]
        found: list[int] = []
        for place in range(1, row.size - 1):
            top = row[place]
            if not (top > 1.0 and top >= row[place - 1] and top > row[place + 1]):
                continue
            sides = (row[:place][::-1], row[place + 1 :])
            if all(_valley(side, top) < (1.0 - LEAST_PEAK) * top for side in sides):
                found.append(place)
        return found

    def tops(self, place: int) -> tuple[Array, Array]:
        """Return frequency (Hz) and ratio of the peak around ``place`` of each row, shape (1 + draws,)."""
        low = place - int(np.argmax(np.diff(self.ratios[0, place::-1], append=np.inf) > 0.0))
        high = place + int(np.argmax(np.diff(self.ratios[0, place:], append=np.inf) > 0.0))
        part = self.ratios[:, low : high + 1]
        across, known = np.log(self.frequency[low : high + 1]), np.isfinite(part).all(axis=1)
        found = np.full((2, len(part)), math.nan)
        for row in np.flatnonzero(known):
            found[:, row] = _top(across, part[row])
        return np.exp(found[0]), found[1]


@dataclass(frozen=True, slots=True)
class Resonance:
    """Resonance, and the speed at which an order meets it.

    Attributes:
        frequency, low, high: Hz, with its 95 % interval.
        ratio: amplitude ratio there.
        order, speed: of the shaft, 1 and rev/min; ``None`` without a shaft.
        margin: distance of that speed from the nearest one of the range, over the latter (as API 617 defines
            the separation margin); 0 within the range.
        margin_low: the least margin within the 95 % interval.
    """

    frequency: float = field(metadata=named("frequency_Hz"))
    low: float = field(metadata=named("low_Hz"))
    high: float = field(metadata=named("high_Hz"))
    ratio: float = field(metadata=named("amplitude_ratio"))
    order: float | None = None
    speed: float | None = field(default=None, metadata=named("speed_rpm"))
    margin: float | None = None
    margin_low: float | None = None


@dataclass(frozen=True, slots=True)
class Span:
    """Span of speeds (rev/min) of an order, or of frequencies (Hz), whose upper bound passes ``LIMIT``."""

    low: float
    high: float
    unit: str
    order: float | None = None


@dataclass(frozen=True, slots=True)
class OrderResponse:
    """Response to one order over the speed, acting alone; bounds are of 95 %."""

    order: float
    amplitude: float = field(metadata=named("amplitude_m_s2"))
    speed: Array = field(metadata=named("speed_rpm"))
    amplitude_ratio: Array
    low: Array
    high: Array
    stroke: Array = field(metadata=named("stroke_m"))


@dataclass(frozen=True, slots=True)
class Response:
    """Response of one condition; bounds are of 95 %, NaN where they are not known.

    ``curves`` are what the machine excites: each order within its speeds, else the curve over frequency.
    """

    curves: tuple[Curve, ...] = field(metadata=LEFT_OUT)
    amplitude: float = field(metadata=named("amplitude_m_s2"))
    frequency: Array = field(metadata=named("frequency_Hz"))
    amplitude_ratio: Array
    low: Array
    high: Array
    stroke: Array = field(metadata=named("stroke_m"))
    stroke_low: Array = field(metadata=named("stroke_low_m"))
    stroke_high: Array = field(metadata=named("stroke_high_m"))
    resonances: tuple[Resonance, ...]
    avoid: tuple[Span, ...]
    orders: tuple[OrderResponse, ...]


@dataclass(frozen=True, slots=True)
class Changed:
    """Condition today and after the change, ``None`` where there is none, as a mount today."""

    before: float | None
    after: float | None
    unit: str


@dataclass(frozen=True, slots=True)
class Change:
    """Quantity before and after; ``factor`` is after over before, with its 95 % interval (paired draws)."""

    quantity: str
    unit: str
    before: float
    after: float
    factor: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class AmplitudeRow:
    """Largest response of the changed valve at another amplitude of the machine (m/s^2)."""

    amplitude: float = field(metadata=named("amplitude_m_s2"))
    frequency: float = field(metadata=named("frequency_Hz"))
    amplitude_ratio: float
    stroke: float = field(metadata=named("stroke_m"))


@dataclass(frozen=True, slots=True)
class WhatIf:
    """Response of a valve today and under changed conditions.

    Attributes:
        valve, model: names.
        changed: what differs from today, each with value before and after, by parameter, and the mount.
        limit: amplitude ratio from which a speed is to be avoided.
        draws: from the uncertainty; 0 where it is not known and there are no intervals.
        speeds: range of the shaft, rev/min.
        by_amplitude: dependence of the changed valve on the amplitude.
        depends_on_amplitude: whether that is more than what settling leaves.
        notes: what a reader should know, one line each.
    """

    JSON_PROPERTIES: ClassVar[tuple[str, ...]] = ("depends_on_amplitude", "sentence")

    valve: str
    model: str
    changed: Mapping[str, Changed]
    limit: float
    draws: int
    speeds: tuple[float, float] | None = field(metadata=named("speed_range_rpm"))
    before: Response
    after: Response
    changes: tuple[Change, ...]
    by_amplitude: tuple[AmplitudeRow, ...]
    notes: tuple[str, ...]

    @property
    def depends_on_amplitude(self) -> bool:
        """Whether the largest ratio depends on the amplitude of the machine."""
        ratios = [one.amplitude_ratio for one in self.by_amplitude]
        return not max(ratios) - min(ratios) <= LEAST_PEAK * max(ratios)

    @property
    def sentence(self) -> str:
        """The answer in short."""
        parts = [
            f"{one.quantity} from {number(one.before, 3)} to {number(one.after, 3)}{unit_text(one.unit)}"
            for one in self.changes
        ]
        shown = [_span(one) for one in self.after.avoid]
        what = "speeds" if self.speeds else "frequencies"
        ending = f"avoid these {what}: {', '.join(shown)}" if shown else f"there are no {what} to avoid"
        if not self.changed:
            return f"Nothing was changed; {ending} (ratio above {LIMIT:g})."
        return f"Changed: {'; '.join(parts)}. After the change, {ending} (ratio above {LIMIT:g})."


def what_if(request: WhatIfRequest) -> WhatIf:
    """Return the response today and under changed conditions.

    Raises:
        InputError: valve, model, change or excitation cannot be used.
    """
    valve, model = find_valve(request.valve), load_model(request.model or DEFAULT_MODEL)
    _refuse_time(model, valve)
    motion = ComposedMotion(model.terms)
    before, after, notes = _conditions(request, valve, model, motion)
    drive = _drive(request)
    if drive.note:
        notes.append(drive.note)
    frequencies = drive.frequencies
    if frequencies is None:
        frequencies = _grid(drive, [before, after])
    amplitudes = sorted({drive.amplitude, *(size for _, size in drive.orders)}, reverse=True)
    pairs = [(one, size) for one in (before, after) for size in amplitudes]
    if not drive.fixed:
        for _ in range(HALVINGS):
            looks = [_curve(motion, one, frequencies, size, best=True) for one, size in pairs]
            frequencies = _halved(frequencies, looks)
    with progress("simulating", len(pairs) * frequencies.size) as advance:
        curves = {
            (id(one), size): _curve(motion, one, frequencies, size, advance=advance) for one, size in pairs
        }
    responses = [
        _response({size: curves[id(one), size] for size in amplitudes}, drive) for one in (before, after)
    ]
    shown = np.unique(np.concatenate([one.frequency for one in responses[1].curves]))
    rows = tuple(_at_amplitude(motion, after, shown, scale * drive.amplitude) for scale in MULTIPLES)
    for name, one, response in zip(("today", "after the change"), (before, after), responses, strict=True):
        notes += _second_motion(motion, one, response, name)
    unsettled = sum(int(np.count_nonzero(np.isnan(one.amplitude_ratio))) for one in responses)
    if unsettled:
        notes.append(
            f"at {unsettled} of {2 * frequencies.size} points the motion never becomes periodic (chaotic, or "
            "too little damping): no number is given there"
        )
    return WhatIf(
        valve.id, model.name, _differences(motion, before, after), LIMIT, len(before.sets), drive.speeds,
        responses[0], responses[1], _changes(*responses), rows, tuple(notes),
    )  # fmt: skip


def _second_motion(motion: ComposedMotion, condition: Condition, response: Response, name: str) -> list[str]:
    """Return a note where a valve that was moved far has another periodic motion than one from rest."""
    far = float(np.nanmax(response.stroke, initial=0.0))
    if far == 0.0:
        return []
    other = _curve(motion, condition, response.frequency, response.amplitude, best=True, displaced=far)
    rows = other.ratios[0]
    apart = np.flatnonzero(np.abs(rows / response.amplitude_ratio - 1.0) > LEAST_PEAK)
    if not apart.size:
        return []
    low, high = (number(response.frequency[place], 3) for place in (apart[0], apart[-1]))
    return [
        f"{name}: between {low} and {high} Hz two motions are possible; shown is the one from rest. A blow "
        f"or a passage through the resonance may leave the valve in the other, with a ratio of up to "
        f"{number(float(rows[apart].max()), 3)}"
    ]


def bounds(rows: Array) -> tuple[Array, Array]:
    """Return the 95 % interval of draws, shape (draws, f), as two arrays of shape (f,).

    A draw without a number may lie on either side; bounds that this leaves open are NaN. Without draws all
    are.
    """
    if not len(rows):
        nothing = np.full(rows.shape[1], math.nan)
        return nothing, nothing
    ends = [
        np.quantile(np.where(np.isnan(rows), other, rows), share, axis=0, method="weibull")
        for share, other in ((0.025, -np.inf), (0.975, np.inf))
    ]
    low, high = (np.where(np.isfinite(end), end, math.nan) for end in ends)
    return low, high


def print_what_if(found: WhatIf, console: Console) -> None:
    """Show what changes, the resonances with their margins, and the speeds to avoid."""
    say: Callable[[str], None] = lambda text: console.print(  # noqa: E731
        text, markup=False, highlight=False, soft_wrap=True
    )
    say(found.sentence)
    for rows in (changed_rows(found), change_rows(found), resonance_rows(found), amplitude_rows(found)):
        if rows:
            table = Table(box=None, pad_edge=False)
            for place, column in enumerate(rows[0]):
                table.add_column(column, justify="left" if place == 0 else "right", no_wrap=True)
            for row in rows:
                table.add_row(*row.values())
            console.print(table)


def changed_rows(found: WhatIf) -> list[dict[str, str]]:
    """Return a row of text for everything that was changed."""
    return [
        {
            "changed": name.replace("_", " "),
            "today": _given(one.before, one.unit),
            "after": _given(one.after, one.unit),
        }
        for name, one in found.changed.items()
    ]


def change_rows(found: WhatIf) -> list[dict[str, str]]:
    """Return a row of text for each quantity that is compared."""
    return [
        {
            "quantity": one.quantity,
            "today": f"{number(one.before)}{unit_text(one.unit)}",
            "after": f"{number(one.after)}{unit_text(one.unit)}",
            "after / today": number(one.factor),
            "95 % interval": _interval(one.low, one.high),
        }
        for one in found.changes
    ]


def resonance_rows(found: WhatIf) -> list[dict[str, str]]:
    """Return a row of text for each resonance and each order that meets it."""
    rows = []
    for name, response in (("today", found.before), ("after", found.after)):
        for one in response.resonances:
            row = {
                "resonance": name,
                "frequency": f"{number(one.frequency)} Hz",
                "95 % interval": _interval(one.low, one.high),
                "ratio": number(one.ratio, 3),
            }
            if one.order is not None and one.speed is not None and one.margin is not None:
                row["order"] = exact(one.order)
                row["at speed"] = f"{number(one.speed)} rev/min"
                row["margin"] = "in the range" if one.margin == 0.0 else percent(one.margin)
            rows.append(row)
    return rows


def amplitude_rows(found: WhatIf) -> list[dict[str, str]]:
    """Return a row of text for each amplitude, empty where that does not matter."""
    if not found.depends_on_amplitude:
        return []
    return [
        {
            "machine amplitude": f"{number(one.amplitude, 3)} m/s²",
            "largest ratio": number(one.amplitude_ratio, 3),
            "at": f"{number(one.frequency, 3)} Hz",
            "largest stroke": f"{number(1e3 * one.stroke, 3)} mm",
        }
        for one in found.by_amplitude
    ]


def _interval(low: float, high: float) -> str:
    return f"{number(low)} to {number(high)}" if math.isfinite(low) and math.isfinite(high) else "unknown"


def _given(value: float | None, unit: str) -> str:
    return "none" if value is None else f"{exact(value)}{unit_text(unit)}"


def _span(one: Span) -> str:
    order = "" if one.order is None else f"order {exact(one.order)}: "
    return f"{order}{number(one.low, 3)} to {number(one.high, 3)} {one.unit}"


def _refuse_time(model: Model, valve: Valve) -> None:
    """Refuse forces that depend on time: no periodic response follows from them."""
    values = model.values_for(valve)
    for entry in model.terms:
        law = entry.uncompiled("force_law")
        given = [values[one.name] for one in entry.parameters]
        if law is not None and len({law(1e-3, 0.1, t, *given) for t in (0.0, 1.0, math.e)}) > 1:
            raise InputError(
                f"model '{model.name}': {entry.name} depends on time, so there is no periodic response: "
                "remove the term from the model"
            )


def _conditions(
    request: WhatIfRequest, valve: Valve, model: Model, motion: ComposedMotion
) -> tuple[Condition, Condition, list[str]]:
    values = model.true_values_for(valve)
    sets = np.tile([values[name] for name in motion.names], (DRAWS, 1))
    notes = []
    if model.uncertainty is None:
        sets = sets[:0]
        notes.append(
            "no intervals: the valve file and the shipped models state no uncertainty; pass --model with a "
            "file that fit or gap wrote by --save-model"
        )
    else:
        places = [motion.names.index(name) for name in model.uncertainty.parameters]
        sets[:, places] += model.uncertainty.deviations(DRAWS)
        lows, highs = ([getattr(one, end) for one in motion.parameters] for end in ("low", "high"))
        sets = np.clip(sets, lows, highs)
        held = [one for one in motion.names if one not in model.uncertainty.parameters]
        if held:
            notes.append(
                f"the intervals count {', '.join(held)} as exact: the model file states no deviation"
            )
    changed = {} if request.spring_stiffness is None else {"spring_stiffness": request.spring_stiffness}
    for text in request.changed:
        name, _, value = (part.strip() for part in text.partition("="))
        try:
            changed[name] = float(value)
        except ValueError:
            raise InputError(f"--set {text}: write it like mass=0.2, in SI units") from None
    for name, given in changed.items():
        model.parameter(name, "what-if").check(given, "what-if")
    after, after_sets = {**values}, sets.copy()
    viscosity = _viscosity_ratio(request, valve)
    drags = [one.name for one in motion.parameters if one.valve_attribute == DRAG]
    if viscosity != 1.0 and (both := sorted(set(drags) & set(changed))):
        raise InputError(f"--set {both[0]}: the oil changes it as well: set one of them")
    for name in drags:
        after[name] *= viscosity
        after_sets[:, motion.names.index(name)] *= viscosity
    for name, given in changed.items():
        after[name] = given
        after_sets[:, motion.names.index(name)] = given
    model.values_for(valve, after)  # within the bounds, also with other oil
    return Condition(values, sets), Condition(after, after_sets, _mount(request)), notes


def _mount(request: WhatIfRequest) -> tuple[float, float] | None:
    frequency, damping = request.mount_frequency, request.mount_damping
    if (frequency is None) != (damping is None):
        raise InputError("--mount-frequency, --mount-damping: a mount needs both: add the other one")
    if frequency is None or damping is None:
        return None
    if not 0.0 < frequency < math.inf or not 0.0 <= damping < math.inf:
        raise InputError(
            f"--mount-frequency {frequency:g} --mount-damping {damping:g}: use a frequency in Hz above 0 and "
            "a damping ratio of 0 or more"
        )
    return frequency, damping


def _viscosity_ratio(request: WhatIfRequest, valve: Valve) -> float:
    """Return the viscosity of the changed oil over that of the valve file.

    It is the ratio of the catalogue's viscosities, so that a drag which was fitted counts and not the film's
    dimensions. The density of all oils is taken as equal.
    """
    if request.oil is None and request.oil_temperature is None:
        return 1.0
    if request.oil is not None and request.oil not in OILS:
        raise InputError(
            f"--oil {request.oil}: unknown oil, known are {', '.join(OILS)}{did_you_mean(request.oil, OILS)}"
        )
    name = request.oil or valve.oil
    if name is None:
        raise InputError(
            f"--oil-temperature: valve '{valve.id}' names no oil: add oil to its file, or pass --oil"
        )
    temperature = valve.oil_temperature if request.oil_temperature is None else request.oil_temperature
    viscosity = OILS[name].kinematic_viscosity(temperature)
    if valve.oil is not None:
        return viscosity / OILS[valve.oil].kinematic_viscosity(valve.oil_temperature)
    return 1e-6 * DENSITY * viscosity / valve.dynamic_viscosity


def _drive(request: WhatIfRequest) -> Drive:
    given = (request.amplitude, request.frequency_range, request.speed_range, request.orders)
    if request.excitation is not None:
        if any(one is not None for one in given):
            raise InputError(
                "--excitation: it states amplitude, frequencies and speeds itself: leave out --amplitude, "
                "--frequency-range, --speed-range and --order"
            )
        return _drive_of(request.excitation)
    amplitude = DEFAULT_AMPLITUDE if request.amplitude is None else request.amplitude
    if not 0.0 < amplitude < math.inf:
        raise InputError(f"--amplitude {amplitude:g}: use a peak acceleration above 0, in m/s^2")
    if (request.speed_range is None) != (request.orders is None):
        raise InputError("--speed-range, --order: one needs the other: add it")
    frequencies = None
    if request.frequency_range is not None:
        frequencies = _spaced(*_range(request.frequency_range, "--frequency-range", "Hz"))
    if request.speed_range is None or request.orders is None:
        return Drive(frequencies, False, None, (), amplitude)
    try:
        orders = sorted({float(part) for part in request.orders.split(",")})
    except ValueError:
        orders = [math.nan]
    if not all(0.0 < order < math.inf for order in orders):
        raise InputError(f"--order {request.orders}: write numbers above 0 like 1,2,9")
    speeds = _range(request.speed_range, "--speed-range", "rev/min")
    return Drive(frequencies, False, speeds, tuple((order, amplitude) for order in orders), amplitude)


def _drive_of(name: str) -> Drive:
    """Return the sines of an excitation."""
    found = find_excitation(name)
    if isinstance(found, MachineOrders):
        speeds = [speed for _, speed in found.speed_profile if speed > 0.0]
        orders = tuple(one for one in found.orders if one[1] > 0.0)
        if speeds and orders:
            note = f"--excitation {name}: its broadband part is left out; each order acts alone"
            return Drive(
                None, False, (min(speeds), max(speeds)), orders, max(size for _, size in orders),
                note if found.broadband_rms > 0.0 else "",
            )  # fmt: skip
    elif isinstance(found, SteadySine | SteppedSine | SweptSine) and found.amplitude > 0.0:
        if isinstance(found, SteadySine):
            frequencies = np.array([found.frequency])
        elif isinstance(found, SteppedSine):
            frequencies = np.unique(found.steps)
        else:
            ends = found.start_frequency, found.stop_frequency
            frequencies = np.unique(_spaced(*ends))
        return Drive(frequencies, not isinstance(found, SweptSine), None, (), found.amplitude)
    raise InputError(
        f"--excitation {name}: what-if answers for one sine at a time: use a steady, stepped or swept sine "
        "or the orders of a machine; for other excitation compare two records of ./spool simulate"
    )


def _range(text: str, option: str, unit: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low = high = math.nan
    if not 0.0 < low < high < math.inf:
        raise InputError(f"{option} {text}: write LOW:HIGH in {unit}, like 10:60, both above 0")
    return low, high


def _grid(drive: Drive, conditions: Sequence[Condition]) -> Array:
    """Return the frequencies of the first look: around natural frequencies, and where the orders are."""
    natural = [
        math.sqrt(one.values["spring_stiffness"] / one.values["mass"]) / (2.0 * math.pi) for one in conditions
    ]
    natural += [one.mount[0] for one in conditions if one.mount is not None]
    ends = [min(natural) / REACH, max(natural) * REACH]
    if drive.speeds is not None:
        met = [order * speed / 60.0 for order, _ in drive.orders for speed in drive.speeds]
        ends = [min(*met, *ends), max(*met, *ends)]
    octaves = math.log2(ends[1] / ends[0]) / math.log2(REACH**2)
    return _spaced(ends[0], ends[1], max(POINTS, math.ceil(POINTS * octaves)))


def _spaced(start: float, stop: float, count: int = POINTS) -> Array:
    """Return frequencies in equal ratios, Hz."""
    return np.asarray(np.geomspace(start, stop, count), dtype=np.float64)


def _curve(
    motion: ComposedMotion,
    condition: Condition,
    frequencies: Array,
    amplitude: float,
    *,
    best: bool = False,
    displaced: float = 0.0,
    advance: Callable[[float], None] = lambda _done: None,
) -> Curve:
    """Return the response at a machine's ``amplitude`` (m/s^2); with ``best`` without draws.

    It starts with the spool ``displaced`` by so many m.
    """
    first = np.array([[condition.values[name] for name in motion.names]])
    sets = first if best else np.vstack([first, condition.sets])
    ratios, strokes = np.empty((2, len(sets), frequencies.size))
    for place, frequency in enumerate(frequencies.tolist()):
        passed = abs(condition.passed(frequency))
        found = sine_response(motion, condition.values, sets, frequency, amplitude * passed, displaced)
        ratios[:, place], strokes[:, place] = passed * np.abs(found.ratio), found.stroke
        advance(1.0)
    return Curve(frequencies, ratios, strokes)


def _halved(frequencies: Array, curves: Sequence[Curve]) -> Array:
    """Return ``frequencies`` with the middles of those around every peak."""
    places = {side for curve in curves for peak in curve.peaks() for side in (peak - 1, peak)}
    middles = [math.sqrt(frequencies[place] * frequencies[place + 1]) for place in places]
    return np.sort(np.append(frequencies, middles))


def _valley(side: Array, top: float) -> float:
    """Return the lowest value of ``side``, walking away from a peak until something exceeds ``top``."""
    higher = np.flatnonzero(side > top)
    return float(np.nanmin(side[: int(higher[0]) if higher.size else side.size], initial=math.inf))


def _top(across: Array, row: Array) -> tuple[float, float]:
    """Return place and height of the largest value of ``row``, between samples by a parabola."""
    place = int(np.argmax(row))
    near = slice(place - 1, place + 2)
    if not 0 < place < row.size - 1 or row[near].min() < (1.0 - CLIFF) * row[place]:
        return float(across[place]), float(row[place])
    a, b, c = np.polyfit(across[near] - across[place], row[near], 2).tolist()
    if not a < 0.0:
        return float(across[place]), float(row[place])
    shift = -b / (2.0 * a)
    return float(across[place] + shift), float(c + 0.5 * b * shift)


def _response(curves: Mapping[float, Curve], drive: Drive) -> Response:
    curve = curves[drive.amplitude]
    excited = [_within(curves[size], order, drive) for order, size in drive.orders] or [curve]
    low, high = bounds(curve.ratios[1:])
    stroke_low, stroke_high = bounds(curve.strokes[1:])
    orders = []
    for (order, size), one in zip(drive.orders, excited, strict=False):
        speed = 60.0 * one.frequency / order
        orders.append(
            OrderResponse(order, size, speed, one.ratios[0], *bounds(one.ratios[1:]), one.strokes[0])
        )
    resonances = [
        one
        for order, size in drive.orders or ((None, drive.amplitude),)
        for one in _resonances(curves[size], order, drive.speeds)
    ]
    avoid = [] if orders else _spans(curve.frequency, curve.ratios[0], high, "Hz", None)
    for row in orders:
        avoid += _spans(row.speed, row.amplitude_ratio, row.high, "rev/min", row.order)
    return Response(
        tuple(excited), drive.amplitude, curve.frequency, curve.ratios[0], low, high,
        curve.strokes[0], stroke_low, stroke_high, tuple(resonances), tuple(avoid), tuple(orders),
    )  # fmt: skip


def _within(curve: Curve, order: float, drive: Drive) -> Curve:
    """Return the part of ``curve`` that an order passes over the speeds."""
    assert drive.speeds is not None
    low, high = (order * speed / 60.0 for speed in drive.speeds)
    inside = curve.frequency[(curve.frequency > low) & (curve.frequency < high)]
    frequency = np.array([low, *inside, high])
    across, known = np.log(frequency), np.log(curve.frequency)
    ratios, strokes = (
        np.array([np.interp(across, known, row) for row in rows]) for rows in (curve.ratios, curve.strokes)
    )
    return Curve(frequency, ratios, strokes)


def _resonances(curve: Curve, order: float | None, speeds: tuple[float, float] | None) -> list[Resonance]:
    found = []
    for place in curve.peaks():
        frequency, ratio = curve.tops(place)
        low, high = (float(end[0]) for end in bounds(frequency[1:, np.newaxis]))
        one = Resonance(float(frequency[0]), low, high, float(ratio[0]))
        if order is not None and speeds is not None:
            margins = [_margin(60.0 * hz / order, speeds) for hz in (one.frequency, low, high)]
            # Inside the interval the speed may lie within the range though both ends lie beyond it.
            across = 60.0 * low / order < speeds[0] and 60.0 * high / order > speeds[1]
            least = math.nan if math.isnan(low) else 0.0 if across else min(margins[1:])
            one = replace(
                one, order=order, speed=60.0 * one.frequency / order, margin=margins[0], margin_low=least
            )
        found.append(one)
    return found


def _margin(speed: float, speeds: tuple[float, float]) -> float:
    nearest = min(max(speed, speeds[0]), speeds[1])
    return abs(speed - nearest) / nearest


def _spans(across: Array, best: Array, high: Array, unit: str, order: float | None) -> list[Span]:
    """Return where the upper bound, or the best value where there is none, passes ``LIMIT``."""
    rows = np.where(np.isnan(high), best, high)
    inside: NDArray[np.bool_] = rows >= LIMIT
    edges = np.flatnonzero(np.diff(np.concatenate(([False], inside, [False]))))
    found = []
    for first, stop in edges.reshape(-1, 2).tolist():
        ends = []
        for inner, outer in ((first, first - 1), (stop - 1, stop)):
            if 0 <= outer < rows.size and math.isfinite(rows[outer]):
                share = (rows[inner] - LIMIT) / (rows[inner] - rows[outer])
                ends.append(float(across[inner] + share * (across[outer] - across[inner])))
            else:
                ends.append(float(across[inner]))
        found.append(Span(ends[0], ends[1], unit, order))
    return found


def _changes(before: Response, after: Response) -> tuple[Change, ...]:
    rows = []
    for name, unit, pick in (
        (
            "largest amplitude ratio",
            "",
            lambda many: np.max([one.ratios.max(axis=1) for one in many], axis=0),
        ),
        ("its frequency", "Hz", _where_largest),
        (
            "largest stroke",
            "mm",
            lambda many: 1e3 * np.max([one.strokes.max(axis=1) for one in many], axis=0),
        ),
    ):
        pair = pick(before.curves), pick(after.curves)
        factors = pair[1] / pair[0]
        low, high = (float(end[0]) for end in bounds(factors[1:, np.newaxis]))
        rows.append(Change(name, unit, float(pair[0][0]), float(pair[1][0]), float(factors[0]), low, high))
    return tuple(rows)


def _where_largest(curves: Sequence[Curve]) -> Array:
    """Return the frequency (Hz) of the largest ratio of each row."""
    one = max(curves, key=lambda curve: float(curve.ratios[0].max()))
    return one.tops(int(np.argmax(one.ratios[0])))[0]


def _differences(motion: ComposedMotion, before: Condition, after: Condition) -> dict[str, Changed]:
    found = {
        one.name: Changed(before.values[one.name], after.values[one.name], one.unit)
        for one in motion.parameters
        if after.values[one.name] != before.values[one.name]
    }
    if after.mount is not None:
        found["mount_frequency"] = Changed(None, after.mount[0], "Hz")
        found["mount_damping"] = Changed(None, after.mount[1], "1")
    return found


def _at_amplitude(
    motion: ComposedMotion, condition: Condition, frequencies: Array, size: float
) -> AmplitudeRow:
    curve = _curve(motion, condition, frequencies, size, best=True)
    if np.isnan(curve.ratios[0]).all():
        return AmplitudeRow(size, math.nan, math.nan, math.nan)
    place = int(np.nanargmax(curve.ratios[0]))
    return AmplitudeRow(
        size, float(frequencies[place]), float(curve.ratios[0, place]), float(np.nanmax(curve.strokes[0]))
    )

"""`./spool what-if`: the response of a valve under changed conditions, beside that of today."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from rich.console import Console
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import exact, named, number, percent, unit_text
from spool_report.records.simulation import find_excitation
from spool_report.terminal import Table, progress
from spool_sim.excitation import MachineOrders, SteadySine, SteppedSine, SweptSine
from spool_sim.integration.composed_motion import ComposedMotion
from spool_sim.model import Model, load_model
from spool_sim.valve import DENSITY, OILS, Valve, find_valve, known_oil

from spool_design import frequency_response as sines
from spool_design.frequency_response import Condition, Drive, Response, curve_of
from spool_design.requests import WhatIfRequest

#: Model of a valve without a model file: a description states mass, springs and film, and no dry friction.
DEFAULT_MODEL = "fluid"
#: m/s^2, of the paper's series and of the preset ``sweep``.
DEFAULT_AMPLITUDE = 10.0
#: Draws from the uncertainty: of 200 the fifth and the sixth from either end bound 95 %, and what scatters in
#: these bounds is a tenth of their distance.
DRAWS = 200
#: Excitation amplitudes, over the given one, at which the dependence on the amplitude is shown.
MULTIPLES = (0.25, 0.5, 1.0, 2.0, 4.0)
#: Attribute of a valve that follows from the oil's viscosity.
DRAG = "likely_viscous_coefficient"


@dataclass(frozen=True, slots=True)
class Changed:
    """Condition today and after the change, ``None`` where there is none, as a mount today."""

    before: float | None
    after: float | None
    unit: str


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
    changes: tuple[sines.Change, ...]
    by_amplitude: tuple[AmplitudeRow, ...]
    notes: tuple[str, ...]

    @property
    def depends_on_amplitude(self) -> bool:
        """Whether the largest ratio depends on the amplitude of the machine."""
        ratios = [one.amplitude_ratio for one in self.by_amplitude]
        return not max(ratios) - min(ratios) <= sines.LEAST_PEAK * max(ratios)

    @property
    def sentence(self) -> str:
        """The answer in short."""
        parts = [
            f"{one.quantity} from {number(one.before, 3)} to {number(one.after, 3)}{unit_text(one.unit)}"
            for one in self.changes
        ]
        shown = [
            ("" if one.order is None else f"order {exact(one.order)}: ")
            + f"{number(one.low, 3)} to {number(one.high, 3)} {one.unit}"
            for one in self.after.avoid
        ]
        what = "speeds" if self.speeds else "frequencies"
        ending = f"avoid these {what}: {', '.join(shown)}" if shown else f"there are no {what} to avoid"
        if not self.changed:
            return f"Nothing was changed; {ending} (ratio above {sines.LIMIT:g})."
        return f"Changed: {'; '.join(parts)}. After the change, {ending} (ratio above {sines.LIMIT:g})."


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
    frequencies = sines.grid(drive, [before, after]) if drive.frequencies is None else drive.frequencies
    amplitudes = sorted({drive.amplitude, *(size for _, size in drive.orders)}, reverse=True)
    pairs = [(one, size) for one in (before, after) for size in amplitudes]
    if not drive.fixed:
        frequencies = sines.refined(motion, frequencies, pairs)
    with progress("simulating", len(pairs) * frequencies.size) as advance:
        curves = {
            (id(one), size): curve_of(motion, one, frequencies, size, advance=advance) for one, size in pairs
        }
    responses = [
        sines.response_of({size: curves[id(one), size] for size in amplitudes}, drive)
        for one in (before, after)
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
        valve.id, model.name, _differences(motion, before, after), sines.LIMIT, len(before.sets),
        drive.speeds, responses[0], responses[1], sines.changes_of(*responses), rows, tuple(notes),
    )  # fmt: skip


def _second_motion(motion: ComposedMotion, condition: Condition, response: Response, name: str) -> list[str]:
    """Return a note where a valve that was moved far has another periodic motion than one from rest."""
    far = float(np.nanmax(response.stroke, initial=0.0))
    if far == 0.0:
        return []
    other = curve_of(motion, condition, response.frequency, response.amplitude, best=True, displaced=far)
    rows = other.ratios[0]
    apart = np.flatnonzero(np.abs(rows / response.amplitude_ratio - 1.0) > sines.LEAST_PEAK)
    if not apart.size:
        return []
    low, high = (number(response.frequency[place], 3) for place in (apart[0], apart[-1]))
    return [
        f"{name}: between {low} and {high} Hz two motions are possible; shown is the one from rest. A blow "
        f"or a passage through the resonance may leave the valve in the other, with a ratio of up to "
        f"{number(float(rows[apart].max()), 3)}"
    ]


def print_what_if(found: WhatIf, console: Console) -> None:
    """Show what changes, the resonances with their margins, and the speeds to avoid."""
    console.print(found.sentence, markup=False, highlight=False, soft_wrap=True)
    for table in tables(found):
        table.show(console)


def tables(found: WhatIf) -> list[Table]:
    """Return what was changed, what changes, the resonances, and what the amplitude changes."""
    sizes = found.by_amplitude if found.depends_on_amplitude else ()
    every: dict[str, tuple[Sequence[str], Sequence[Sequence[str]]]] = {
        "What was changed": (
            ("changed", "today", "after"),
            [
                (name.replace("_", " "), _given(one.before, one.unit), _given(one.after, one.unit))
                for name, one in found.changed.items()
            ],
        ),
        "What changes": (
            ("quantity", "today", "after", "after / today", "95 % interval"),
            [
                (
                    one.quantity, number(one.before) + unit, number(one.after) + unit, number(one.factor),
                    _interval(one.low, one.high),
                )
                for one in found.changes
                for unit in (unit_text(one.unit),)
            ],
        ),
        "Resonances and margins": resonances(found),
        "Over the machine's amplitude": (
            ("machine amplitude", "largest ratio", "at", "largest stroke"),
            [
                (
                    f"{number(one.amplitude, 3)} m/s²", number(one.amplitude_ratio, 3),
                    f"{number(one.frequency, 3)} Hz", f"{number(1e3 * one.stroke, 3)} mm",
                )
                for one in sizes
            ],
        ),
    }  # fmt: skip
    return [Table(columns, rows, columns[1:], title) for title, (columns, rows) in every.items()]


def resonances(found: WhatIf) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return columns, and a row for each resonance and each order that meets it."""
    columns = ("resonance", "frequency", "95 % interval", "ratio", "order", "at speed", "margin")
    rows = []
    for name, response in (("today", found.before), ("after", found.after)):
        for one in response.resonances:
            met: tuple[str, ...] = ()
            if one.order is not None and one.speed is not None and one.margin is not None:
                margin = "in the range" if one.margin == 0.0 else percent(one.margin)
                met = (exact(one.order), f"{number(one.speed)} rev/min", margin)
            size = (f"{number(one.frequency)} Hz", _interval(one.low, one.high), number(one.ratio, 3))
            rows.append((name, *size, *met))
    return columns[: max(map(len, rows), default=0)], rows


def _interval(low: float, high: float) -> str:
    return f"{number(low)} to {number(high)}" if math.isfinite(low) and math.isfinite(high) else "unknown"


def _given(value: float | None, unit: str) -> str:
    return "none" if value is None else f"{exact(value)}{unit_text(unit)}"


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
    try:
        name = valve.oil if request.oil is None else known_oil(request.oil)
    except InputError as error:
        raise InputError(f"--oil: {error}") from None
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
        frequencies = sines.spaced(*_range(request.frequency_range, "--frequency-range", "Hz"))
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
            frequencies = np.unique(sines.spaced(found.start_frequency, found.stop_frequency))
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
    curve = curve_of(motion, condition, frequencies, size, best=True)
    if np.isnan(curve.ratios[0]).all():
        return AmplitudeRow(size, math.nan, math.nan, math.nan)
    place = int(np.nanargmax(curve.ratios[0]))
    return AmplitudeRow(
        size, float(frequencies[place]), float(curve.ratios[0, place]), float(np.nanmax(curve.strokes[0]))
    )

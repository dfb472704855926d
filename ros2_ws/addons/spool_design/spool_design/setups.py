"""File of several set-ups of one valve, and the joint fit of them, as JSON and as rows of text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from rich.console import Console
from spool_core.errors import InputError
from spool_core.text import did_you_mean
from spool_core.uncertainty import LEGEND, PLUS_MINUS, by_name, interval, number, percent
from spool_estimator.identification.determination import IDENTIFIABLE, ONE_SIDED, Determination, sentences
from spool_estimator.identification.fit_result import SPOOL_DELAY, SPOOL_GAIN
from spool_estimator.identification.setups import JointFit
from spool_report import fit_tables
from spool_report.ranking import ValidatedFit, natural_frequency
from spool_report.records.record_loading import FitData
from spool_report.terminal import Table
from spool_sim.model import Model
from spool_sim.valve import Number, Valve, one_line, valve_from_mapping

#: Fewer set-ups are what `fit` without `--setups` takes.
LEAST = 2


class Known(BaseModel):
    """What is known in one set-up, in the units of a valve file; ``added_mass``: kg over the valve's."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    spring_stiffness: Number | None = None
    added_mass: Number | None = Field(default=None, gt=-1e3, lt=1e3)
    dynamic_viscosity: Number | None = None
    oil: str | None = None
    oil_temperature: Number | None = None


class _SetUpEntry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str | None = Field(default=None, pattern=r"^[A-Za-z0-9_.\-]+$", max_length=50)
    records: tuple[Path, ...] = Field(min_length=1)
    known: dict[str, Any] = Field(default_factory=dict)


class _SetUpsFile(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    setups: tuple[dict[str, Any], ...]
    shared: tuple[str | dict[str, tuple[str, ...]], ...] = ()


@dataclass(frozen=True, slots=True)
class DescribedSetUp:
    """A set-up as a file describes it; ``valve`` has what is known here."""

    name: str
    records: tuple[Path, ...]
    known: Known
    valve: Valve


@dataclass(frozen=True, slots=True)
class FittedSetUps:
    """A joint fit with what it was made of; ``validated`` is empty where it has no result."""

    valve: Valve
    setups: tuple[DescribedSetUp, ...]
    data: tuple[FitData, ...]
    shared: Mapping[str, tuple[tuple[str, ...], ...]]
    joint: JointFit
    validated: tuple[ValidatedFit, ...]


def read_setups(
    content: Mapping[str, Any], where: str, folder: Path, valve: Valve, model: Model
) -> tuple[tuple[DescribedSetUp, ...], dict[str, tuple[tuple[str, ...], ...]]]:
    """Return the set-ups that ``content`` describes, and which of them share each parameter.

    Raises:
        InputError: unknown or missing key, value out of range, or what is shared and known does not fit.
    """
    try:
        file = _SetUpsFile.model_validate(dict(content))
    except ValidationError as error:
        raise one_line(error, where, tuple(_SetUpsFile.model_fields)) from None
    if len(file.setups) < LEAST:
        raise InputError(
            f"{where}: setups: a joint fit needs {LEAST} set-ups at least, here are {len(file.setups)}: add "
            "set-ups, or fit one without --setups"
        )
    setups: list[DescribedSetUp] = []
    for count, entry in enumerate(file.setups, 1):
        given = entry.get("name")
        place = f"{where}: set-up {count}" + (f" '{given}'" if isinstance(given, str) else "")
        try:
            one = _SetUpEntry.model_validate(entry)
        except ValidationError as error:
            raise one_line(error, place, tuple(_SetUpEntry.model_fields)) from None
        try:
            known = Known.model_validate(one.known)
        except ValidationError as error:
            raise one_line(error, f"{place}: known", tuple(Known.model_fields)) from None
        name = one.name or f"setup_{count}"
        if any(name == other.name for other in setups):
            raise InputError(f"{place}: another set-up has the name '{name}': give each its own")
        described = _valve_in(valve, known, f"{place}: known")
        setups.append(DescribedSetUp(name, tuple(folder / path for path in one.records), known, described))
    return tuple(setups), _shared(file.shared, setups, model, f"{where}: shared")


def _valve_in(valve: Valve, known: Known, where: str) -> Valve:
    """Return ``valve`` with what is known in a set-up.

    Raises:
        InputError: a value out of range, or the oil's viscosity does not follow.
    """
    given: dict[str, Any] = {
        name: valve.__dict__[name] for name in Valve.model_fields if valve.__dict__.get(name) is not None
    }
    if known.oil not in (None, valve.oil) and known.dynamic_viscosity is None:
        raise InputError(
            f"{where}: oil: '{known.oil}' is not the valve file's: add its dynamic_viscosity (Pa s) at "
            "oil_temperature (deg C)"
        )
    if known.oil_temperature is not None and known.dynamic_viscosity is None:
        try:
            given["dynamic_viscosity"] = valve.dynamic_viscosity_at(known.oil_temperature)
        except InputError as error:
            raise InputError(f"{where}: oil_temperature: {error}") from None
    given.update(known.model_dump(exclude_none=True, exclude={"added_mass"}))
    given["moving_mass"] += known.added_mass or 0.0
    return valve_from_mapping(given, where)


def _shared(
    entries: Sequence[str | Mapping[str, Sequence[str]]],
    setups: Sequence[DescribedSetUp],
    model: Model,
    where: str,
) -> dict[str, tuple[tuple[str, ...], ...]]:
    """Return by parameter which groups of set-ups share it.

    Raises:
        InputError: no such parameter or set-up, one set-up in two groups, or a parameter that one knows.
    """
    every = tuple(setup.name for setup in setups)
    found: dict[str, tuple[tuple[str, ...], ...]] = {}
    for entry in entries:
        for name, group in {entry: every}.items() if isinstance(entry, str) else entry.items():
            if name not in (SPOOL_GAIN, SPOOL_DELAY):
                model.parameter(name, where)
            if len(group) < LEAST:
                raise InputError(f"{where}: {name}: name {LEAST} set-ups at least, of {', '.join(every)}")
            for setup in group:
                if setup not in every:
                    raise InputError(
                        f"{where}: {name}: no set-up '{setup}', there are {', '.join(every)}"
                        f"{did_you_mean(setup, every)}"
                    )
                if any(setup in other for other in found.get(name, ())) or list(group).count(setup) > 1:
                    raise InputError(f"{where}: {name}: set-up '{setup}' is listed twice: list it once")
            known = [one.name for one in setups if one.known.spring_stiffness is not None]
            twice = [one for one in known if one in group and name == "spring_stiffness"]
            if twice:
                raise InputError(
                    f"{where}: {name}: set-up '{twice[0]}' has it among what is known: remove one of them"
                )
            found[name] = (*found.get(name, ()), tuple(group))
    return found


#: What the columns of single set-ups mean.
ALONE = (
    "alone: half width of the interval from one set-up by itself; 'no': by itself this set-up determines the "
    "parameter only together with others."
)


def to_dictionary(found: FittedSetUps) -> dict[str, Any]:
    """Return what ``fit --setups --json`` writes; NaN where something is not known."""
    joint = found.joint
    return {
        "valve": found.valve.id,
        "model": joint.model.name,
        "terms": [term.name for term in joint.model.terms],
        "converged": joint.converged,
        "stopped_early": joint.stopped_early,
        "reason": joint.reason,
        "shared": {name: [list(group) for group in groups] for name, groups in found.shared.items()},
        "parameters": by_name(joint.parameters),
        "combinations": by_name(joint.combinations),
        "not_observable": joint.not_observable,
        "determined": by_name(joint.determinations),
        "alone": {name: by_name(own) for name, own in joint.alone.items()},
        "correlation": {"parameters": joint.observable, "matrix": joint.correlation},
        "setups": {
            setup.name: {"known": setup.known.model_dump(exclude_none=True), **fit_tables.to_dictionary(one)}
            for setup, one in zip(found.setups, found.validated, strict=False)
        },
    }


def shown_name(name: str) -> str:
    """Return the name of a joint unknown for people: ``spring stiffness (soft, loaded)``."""
    return name.replace("_", " ").replace("[", " (").replace("]", ")")


def alone_text(one: Determination | None) -> str:
    """Return what one set-up determines of a parameter by itself; empty where it does not have it."""
    if one is None:
        return ""
    if one.verdict == IDENTIFIABLE and one.low is not None and one.high is not None:
        return number(0.5 * (one.high - one.low), 2)
    if one.verdict == ONE_SIDED:
        return f"≥ {number(one.low, 2)}" if one.low is not None else f"≤ {number(one.high or 0.0, 2)}"
    return "no"


def alone_of(found: FittedSetUps, name: str, setup: str) -> Determination | None:
    """Return what ``setup`` determines by itself of the joint unknown ``name``, ``None`` if it has none."""
    parameter, _, group = name.rstrip("]").partition("[")
    if group and setup not in group.split(", "):
        return None
    return next((one for one in found.joint.alone.get(setup, ()) if one.name == parameter), None)


def parameter_table(found: FittedSetUps) -> Table:
    """Return a row for each unknown: its value from all set-ups, and what each determines alone."""
    setups = [setup.name for setup in found.setups]
    columns = ("parameter", "value", PLUS_MINUS, "unit", *(f"{name} alone" for name in setups))
    rows = [
        (
            shown_name(quantity.name), shown.value, shown.half_width, quantity.unit,
            *(alone_text(alone_of(found, quantity.name, name)) for name in setups),
        )
        for quantity in (*found.joint.parameters, *found.joint.combinations)
        for shown in (interval(quantity.value, quantity.standard_deviation),)
    ]  # fmt: skip
    return Table(columns, rows, {*columns} - {"parameter", "unit"})


def quality_table(found: FittedSetUps) -> Table:
    """Return a row for each set-up: what is known in it, and how well the model holds."""
    rows = [
        (
            setup.name,
            ", ".join(
                f"{name.replace('_', ' ')} {value if isinstance(value, str) else number(value)}"
                for name, value in setup.known.model_dump(exclude_none=True).items()
            ),
            number(natural_frequency(one.fit)),
            percent(one.training_error, 3),
            percent(one.held_out_error, 3),
        )
        for setup, one in zip(found.setups, found.validated, strict=False)
    ]
    columns = ("set-up", "known", "natural frequency, Hz", "error fitted", "error held out")
    return Table(columns, rows, columns[2:], "Set-ups")


def headline(found: FittedSetUps) -> str:
    """Return what was fitted to what."""
    names = ", ".join(setup.name for setup in found.setups)
    return f"{found.joint.model.name} fitted to {len(found.setups)} set-ups of {found.valve.id}: {names}"


def print_setups(found: FittedSetUps, console: Console) -> None:
    """Show a joint fit, or why it has no result."""
    joint = found.joint
    if joint.reason is not None:
        console.print(f"no result: {joint.reason}", markup=False, highlight=False, soft_wrap=True)
        return
    console.print(headline(found), markup=False, highlight=False, soft_wrap=True)
    for line in sentences(joint.determinations):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    whole = parameter_table(found)
    Table(whole.columns[:4], [row[:4] for row in whole.rows], whole.numbers).show(console)
    alone = [(row[0], *row[4:]) for row in whole.rows]
    Table(("parameter", *whole.columns[4:]), alone, whole.numbers).show(console)
    quality_table(found).show(console)
    console.print(f"{LEGEND}. {ALONE}", markup=False, highlight=False, soft_wrap=True)
    if not joint.converged:
        console.print("NOT converged: do not use the numbers", markup=False)
    for setup, one in zip(found.setups, found.validated, strict=True):
        for warning in one.fit.warnings:
            text = f"warning: {setup.name}: {warning}"
            console.print(text, style="yellow", markup=False, highlight=False, soft_wrap=True)

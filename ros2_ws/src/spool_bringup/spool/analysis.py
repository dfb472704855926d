"""Analyses of records: what the commands of the same names do."""

from __future__ import annotations

import contextlib
import tempfile
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from spool_core.errors import InputError
from spool_core.system import expanded
from spool_core.text import did_you_mean
from spool_report.outputs import sources
from spool_report.requests import CompareRequest, FitRequest, GapRequest, Selection
from spool_report.runs.fit_run import compare_records, fit_records
from spool_sim.valve import read_mapping

from spool.errors import in_python, one_error
from spool.record import AnyRecord, AnyValve, listed, part_of, path_of, selected, valve_files
from spool.results import Comparison, Fit, Gap, Replay, SetUpsFit, WhatIf, keeping_backend

#: What ``gap`` takes for its kind.
KINDS = ("accelerations", "driven", "imposed")


@one_error
def fit(
    records: AnyRecord | Iterable[AnyRecord],
    valve: AnyValve | None = None,
    model: str | Path = "coulomb",
    *,
    holdout: Sequence[AnyRecord] = (),
    free: Sequence[str] = (),
    fix: Sequence[str] = (),
    force_free: bool = False,
    sensor_gain: bool = False,
    sensor_delay: bool = False,
    name: str | None = None,
    start: float = 0.0,
    stop: float | None = None,
    since: str | None = None,
    until: str | None = None,
    around: str | None = None,
) -> Fit:
    """Fit one model to records.

    Args:
        records: one or several of the same valve, which are one set of data.
        valve: description, name or file; default: the bag's own description.
        model: name or YAML file.
        holdout: records to judge errors by; default: pieces of ``records``.
        free: parameters to fit though the valve file gives them, ``"moving_mass"`` or ``"moving_mass=0.18"``.
        fix: parameters to hold, ``"coulomb_force=0.3"``, or as the valve file has them.
        force_free: hold nothing that the records do not determine.
        sensor_gain: fit the gain of the spool's sensor.
        sensor_delay: fit its delay.
        name, start, stop, since, until, around: part of the records, as of ``spool.read``; default: as read.

    Raises:
        InputError: records, valve, model or parameters cannot be used.
    """
    every = listed(records)
    part = part_of(every, name, start, stop, since, until, around)
    paths, held_out = [path_of(one) for one in every], _held_out(holdout)
    with valve_files([valve]) as (file,):
        request = FitRequest(
            records=paths, valve=file, model=str(model), free=_listed(free), fix=_listed(fix),
            holdout=held_out, force_free=force_free, sensor_gain=sensor_gain, sensor_delay=sensor_delay,
        )  # fmt: skip
        validated = fit_records(request, selected(part))
    for doubt in (*validated.data.doubts, *validated.fit.warnings):
        warnings.warn(in_python(doubt), stacklevel=3)
    return Fit(validated)


@one_error
def fit_setups(
    setups: str | Path | Mapping[str, Any],
    valve: AnyValve,
    model: str | Path = "coulomb",
    *,
    free: Sequence[str] = (),
    fix: Sequence[str] = (),
    force_free: bool = False,
    sensor_gain: bool = False,
    sensor_delay: bool = False,
) -> SetUpsFit:
    """Fit one model to records of several set-ups of one valve together.

    Example:
        >>> import spool
        >>> valve = spool.valve("4weh10_soft")
        >>> loaded = valve.model_copy(update={"moving_mass": 0.24})
        >>> setups = [
        ...     {"records": [spool.simulate(valve, "fluid", seconds=6)]},
        ...     {"records": [spool.simulate(loaded, "fluid", seconds=6)], "known": {"added_mass": 0.06}},
        ... ]
        >>> shared = ["mass", "spring_stiffness", "viscous_coefficient", "spool_gain"]
        >>> found = spool.fit_setups({"setups": setups, "shared": shared}, valve, "fluid")
        >>> round(found.parameters["mass"]["value"], 3)
        0.18

    Args:
        setups: YAML file of the set-ups, or its content; records may then be what ``spool.read`` returns.
        valve: description of the valve that all set-ups are of.
        model: name or YAML file.
        free, fix, force_free, sensor_gain, sensor_delay: as of ``spool.fit``, in each set-up.

    Raises:
        InputError: set-ups, records, valve, model or parameters cannot be used.
    """
    from spool_design.setups_run import SetUpsRequest, fit_setups_of  # noqa: PLC0415 - an add-on

    if isinstance(setups, Mapping):
        content, where, folder = _with_paths(setups), "spool.fit_setups", Path()
    else:
        file = expanded(setups)
        content, where, folder = read_mapping(file, "set-ups"), str(file), file.parent
    with valve_files([valve]) as (described,):
        request = FitRequest(
            valve=described, model=str(model), free=_listed(free), fix=_listed(fix), force_free=force_free,
            sensor_gain=sensor_gain, sensor_delay=sensor_delay,
        )  # fmt: skip
        found = fit_setups_of(SetUpsRequest(content, where, folder, request), Selection())
    for one in found.data:
        for doubt in one.doubts:
            warnings.warn(in_python(f"{one.name}: {doubt}"), stacklevel=3)
    return SetUpsFit(found)


@one_error
def compare(
    records: AnyRecord | Iterable[AnyRecord],
    valve: AnyValve | Sequence[AnyValve] | None = None,
    models: Sequence[str | Path] = (),
    *,
    together: bool = False,
    holdout: Sequence[AnyRecord] = (),
    sensor_gain: bool = False,
    sensor_delay: bool = False,
    name: str | None = None,
    start: float = 0.0,
    stop: float | None = None,
    since: str | None = None,
    until: str | None = None,
    around: str | None = None,
) -> Comparison:
    """Fit several models to records and rank them.

    Args:
        records: each is one series, as in the paper.
        valve: for all records, or one for each.
        models: names or YAML files; default: the paper's four, coulomb and stribeck.
        together: take all records as one set of data.
        holdout: records to judge errors by; default: pieces of ``records``.
        sensor_gain: fit the gain of the spool's sensor.
        sensor_delay: fit its delay.
        name, start, stop, since, until, around: part of the records, as of ``spool.read``; default: as read.

    Raises:
        InputError: records, valves or models cannot be used.
    """
    every = listed(records)
    part = part_of(every, name, start, stop, since, until, around)
    paths, held_out = [path_of(one) for one in every], _held_out(holdout)
    given: list[AnyValve] = []
    if valve is not None:
        given = list(valve) if isinstance(valve, (list, tuple)) else [cast("AnyValve", valve)]
    with valve_files(given) as files:
        request = CompareRequest(
            records=paths, valve=[str(file) for file in files], models=_listed(models), together=together,
            holdout=held_out, sensor_gain=sensor_gain, sensor_delay=sensor_delay,
        )  # fmt: skip
        found = compare_records(request, selected(part))
    return Comparison(*found)


@one_error
def gap(
    records: AnyRecord | Iterable[AnyRecord],
    valve: AnyValve | None = None,
    base: str | Path = "fluid",
    *,
    kind: str = "accelerations",
    holdout: Sequence[AnyRecord] = (),
    gain_tolerance: float = 0.05,
    delay_tolerance: float = 0.5e-3,
    mass: float | None = None,
    least_share: float = 0.0025,
    thorough: bool = False,
    profiles: bool = False,
    name: str | None = None,
    start: float = 0.0,
    stop: float | None = None,
    since: str | None = None,
    until: str | None = None,
    around: str | None = None,
) -> Gap:
    """Find where simulation and records disagree, name what is missing, add it, measure the gap again.

    Args:
        records: one or several of the same valve, which are one set of data.
        valve: description, name or file; default: the bag's own description.
        base: model that something may be missing from: name or YAML file.
        kind: ``accelerations``, ``driven`` (a force moves the mass) or ``imposed`` (it is the reaction).
        holdout: records to judge by; default: every other stretch.
        gain_tolerance: relative gain error of the spool's sensor that its data sheet allows.
        delay_tolerance: delay between the channels that is allowed, s.
        mass: mass that the force of a driven record moves, kg; default: fitted, or the valve's.
        least_share: share of the spool's acceleration, rms, that an effect must change to be named.
        thorough: search without a limit of time.
        profiles: work out the profile likelihood of each number of what is named.
        name, start, stop, since, until, around: part of the records, as of ``spool.read``; default: as read.

    Raises:
        InputError: records, valve or model cannot be used.
    """
    if kind not in KINDS:
        raise InputError(f"spool.gap: kind={kind!r} is none of {', '.join(KINDS)}{did_you_mean(kind, KINDS)}")
    every = listed(records)
    part = part_of(every, name, start, stop, since, until, around)
    paths, held_out = [path_of(one) for one in every], _held_out(holdout)
    with valve_files([valve]) as (file,):
        from spool_report.runs.gap_run import find_gap  # noqa: PLC0415

        request = GapRequest(
            records=paths, valve=file, base=str(base), holdout=held_out, kind=cast("Any", kind), mass=mass,
            gain_tolerance=gain_tolerance, delay_tolerance=delay_tolerance, least_share=least_share,
            thorough=thorough, profiles=profiles,
        )  # fmt: skip
        found = find_gap(request, selected(part))
    return Gap(found, sources([*paths, *held_out], found.valve))


@one_error
def replay(
    record: AnyRecord,
    valve: AnyValve | None = None,
    *,
    report: bool = False,
    baseline_time: float | None = None,
    state: str | Path | None = None,
    params_file: str | Path | None = None,
    since: str | None = None,
    until: str | None = None,
    around: str | None = None,
    language: str = "",
) -> Replay:
    """Run the live estimator and monitor over a record.

    Args:
        record: bag or file; a bag may hold several valves.
        valve: description, name or file; default: what the bag describes.
        report: draw the page that ``save("replay.html")`` writes.
        baseline_time: s in which the healthy valve is learned; default: the monitor's.
        state: folder that keeps each valve's baseline from record to record.
        params_file: parameter file of the nodes, with the limits of the plant; default: the shipped limits.
        since, until, around: span of a bag, as of ``spool.read``; default: as read.
        language: of alarms: ``en``, ``de`` or ``pl``.

    Raises:
        InputError: record or valve cannot be used.
    """
    path, part = path_of(record), part_of([record], None, 0.0, None, since, until, around)
    if part.name is not None or part.start or part.stop is not None:
        raise InputError(
            "spool.replay: it takes whole valves of a record: read it without name, start and stop"
        )
    with valve_files([valve]) as (file,), tempfile.TemporaryDirectory() as folder:
        from spool_report.requests import ReplayRequest  # noqa: PLC0415
        from spool_report.runs.record_replay import replay_bag  # noqa: PLC0415

        page = Path(folder) / "replay.html"
        request = ReplayRequest(
            record=path, valve=[] if file is None else [file], when=part.when, language=language,
            state=None if state is None else expanded(state),
            params_file=None if params_file is None else expanded(params_file),
        )  # fmt: skip
        with keeping_backend() if report else contextlib.nullcontext():
            found = replay_bag(request, page if report else None, baseline_time)
        return Replay(found, page.read_text(encoding="utf-8") if report else "")


@one_error
def what_if(
    valve: AnyValve,
    model: Fit | Gap | str | Path | None = None,
    *,
    spring_stiffness: float | None = None,
    changed: Mapping[str, float] | None = None,
    oil: str | None = None,
    oil_temperature: float | None = None,
    mount_frequency: float | None = None,
    mount_damping: float | None = None,
    excitation: str | Path | None = None,
    amplitude: float | None = None,
    frequency_range: tuple[float, float] | None = None,
    speed_range: tuple[float, float] | None = None,
    orders: Sequence[float] = (),
) -> WhatIf:
    """Predict the response of a valve under changed conditions, and compare it with today.

    Example:
        >>> import spool
        >>> found = spool.what_if("4weh10_soft", spring_stiffness=5846.0, speed_range=(600, 2400), orders=[1])
        >>> [round(one["frequency_Hz"], 1) for one in found.after["resonances"]]
        [28.2]
        >>> [round(one["low"]) for one in found.after["avoid"]]
        [1171]

    Args:
        valve: description, name or file.
        model: result of ``spool.fit`` or ``spool.gap``, name, or YAML file; a result or a file of one gives
            95 % intervals. Default: ``fluid``, which a valve file describes.
        spring_stiffness: both springs together, N/m.
        changed: other values of parameters in SI units, by name, such as ``{"mass": 0.2}``.
        oil: name of another oil.
        oil_temperature: deg C.
        mount_frequency, mount_damping: natural frequency (Hz) and damping ratio of an isolating mount.
        excitation: preset or YAML file of sines or machine orders, in place of what follows.
        amplitude: peak acceleration of the machine, m/s^2; default: 10.
        frequency_range: Hz; default: around the resonances.
        speed_range: of the shaft, rev/min.
        orders: of the shaft.

    Raises:
        InputError: valve, model, change or excitation cannot be used.
    """
    with valve_files([valve]) as (file,), tempfile.TemporaryDirectory() as folder:
        from spool_design.requests import WhatIfRequest  # noqa: PLC0415 - an add-on
        from spool_design.what_if import what_if as predict  # noqa: PLC0415

        given: object = model
        if isinstance(model, (Fit, Gap)):
            given = Path(folder) / "model.yaml"
            model.save_model(given)
        request = WhatIfRequest(
            valve=str(file), model=None if given is None else str(given), spring_stiffness=spring_stiffness,
            changed=[f"{name}={value!r}" for name, value in (changed or {}).items()],
            oil=oil, oil_temperature=oil_temperature,
            mount_frequency=mount_frequency, mount_damping=mount_damping,
            excitation=None if excitation is None else str(excitation), amplitude=amplitude,
            frequency_range=None if frequency_range is None else ":".join(map(str, frequency_range)),
            speed_range=None if speed_range is None else ":".join(map(str, speed_range)),
            orders=",".join(map(str, orders)) or None,
        )  # fmt: skip
        return WhatIf(predict(request))


def _with_paths(setups: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a file of set-ups with records as their paths."""
    entries = setups.get("setups")
    if not isinstance(entries, (list, tuple)):
        return dict(setups)
    changed = [
        {**entry, "records": [path_of(one) for one in listed(entry["records"])]}
        if isinstance(entry, Mapping) and entry.get("records")
        else entry
        for entry in entries
    ]
    return {**setups, "setups": changed}


def _held_out(holdout: AnyRecord | Sequence[AnyRecord]) -> list[Path]:
    none = isinstance(holdout, (list, tuple)) and not holdout
    return [] if none else [path_of(one) for one in listed(holdout)]


def _listed(given: str | Path | Sequence[str | Path]) -> list[str]:
    return [str(one) for one in ([given] if isinstance(given, (str, Path)) else given)]

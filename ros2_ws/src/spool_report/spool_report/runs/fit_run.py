"""`./spool fit` and `./spool compare`: one model or all of them fitted to records, and what is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from spool_core.errors import InputError
from spool_estimator.identification.fit import determined_before
from spool_estimator.identification.fit_result import FitSettings
from spool_report import fit_tables as tables
from spool_report.outputs import ResultFiles, write_file, write_json
from spool_report.ranking import FittedSeries, Ranking, ValidatedFit, fit_and_validate, no_worse, rank
from spool_report.records.record_loading import FitData, load_data
from spool_report.requests import CompareRequest, FitRequest, Selection
from spool_report.terminal import progress, warn
from spool_sim.model import Model, load_model
from spool_sim.valve import Valve

#: The paper's four models and the two that dry friction is usually told by.
DEFAULT_MODELS = ("fluid", "coulomb", "stribeck", "microwedge", "mixed", "coulomb_hydrodynamic")


def run_fit(request: FitRequest, selection: Selection, outputs: ResultFiles) -> int:
    """Fit a model and report the result; return 1 if there is none.

    Raises:
        InputError: records, valve, model or parameters cannot be used.
    """
    load_model(request.model)  # refused before the files are made
    wanted = outputs.within("fit", model=True)
    validated = fit_records(request, selection)
    for doubt in validated.data.doubts:
        warn(doubt)
    if wanted.json is not None:
        write_json(wanted.json, tables.to_dictionary(validated))
    console = Console()
    if validated.fit.reason is not None:
        console.print(f"no result: {validated.fit.reason}", markup=False, highlight=False, soft_wrap=True)
        return 1
    tables.print_fit(validated, console)
    if wanted.model is not None:
        save_fit(wanted.model, validated)
        print(f"{wanted.model}: the fitted model")
    if wanted.report is not None:
        from spool_report.fit_page import fit_page  # noqa: PLC0415 - matplotlib is needed here only

        with progress("drawing"):
            write_file(wanted.report, fit_page(validated), "--report")
        print(f"{wanted.report}: pictures and tables")
    return 0


def fit_records(request: FitRequest, selection: Selection) -> ValidatedFit:
    """Return a model fitted to records, with its errors on held-out data.

    Raises:
        InputError: records, valve, model or parameters cannot be used.
    """
    model = load_model(request.model)
    data = load_data(request.records, request.valve, selection, request.holdout)
    settings = replace(fit_settings(model, data.valve, request), check=True)
    with progress(f"fitting {model.name}", settings.allowed, at_most=True) as tell:
        return fit_and_validate(data, model, settings, tell)


def save_fit(path: Path, validated: ValidatedFit) -> None:
    """Write the fitted model as a YAML file that simulator and estimator load."""
    found = validated.fit
    name = f"{found.model.name[: tables.LONGEST_NAME]}_fitted"
    comment = f"{found.model.name}, fitted to {', '.join(map(str, validated.data.paths))}"
    correlated = (found.observable, found.correlation)
    tables.save_model(path, found.model, name, found.values, found.parameters, comment, correlated)


def fit_settings(model: Model, valve: Valve, request: FitRequest) -> FitSettings:
    """Return the settings of ``request``.

    Raises:
        InputError: no such parameter, not a number, out of range, or both free and fixed.
    """
    released = _named(request.free, model, "--free")
    held = _named(request.fix, model, "--fix")
    both = sorted(set(released) & set(held))
    if both:
        raise InputError(f"{both[0]}: given to --free and to --fix: use one of them")
    described = model.values_for(valve)
    return FitSettings(
        held={name: described[name] if value is None else value for name, value in held.items()},
        free=tuple(released),
        start={name: value for name, value in released.items() if value is not None},
        fit_gain=request.sensor_gain,
        fit_delay=request.sensor_delay,
        force_free=request.force_free,
    )


def run_compare(request: CompareRequest, selection: Selection, outputs: ResultFiles) -> int:
    """Fit every model to every record, and rank them; return 1 where none has a result.

    Raises:
        InputError: records, valves or models cannot be used.
    """
    chosen_models(request.models)  # refused before the files are made
    wanted = outputs.within("compare")
    series, ranking = compare_records(request, selection)
    for one in series:
        for doubt in one.data.doubts:
            warn(f"{one.data.name}: {doubt}")
    if wanted.json is not None:
        write_json(wanted.json, tables.comparison_dictionary(series, ranking))
    tables.print_comparison(series, ranking, Console())
    if wanted.report is not None and ranking.preferred is not None:
        from spool_report.fit_page import compare_page  # noqa: PLC0415 - matplotlib is needed here only

        with progress("drawing"):
            write_file(wanted.report, compare_page(series, ranking), "--report")
        print(f"{wanted.report}: pictures and tables")
    return 0 if ranking.preferred is not None else 1


def compare_records(request: CompareRequest, selection: Selection) -> tuple[list[FittedSeries], Ranking]:
    """Return every model fitted to every record, and their ranking.

    Raises:
        InputError: records, valves or models cannot be used.
    """
    settings = FitSettings(fit_gain=request.sensor_gain, fit_delay=request.sensor_delay)
    series = fit_all(load_series(request, selection), chosen_models(request.models), settings)
    return series, rank(series)


def chosen_models(models: Sequence[str]) -> list[Model]:
    """Return the models of these names, DEFAULT_MODELS if none is given.

    Raises:
        InputError: no such model, or one is given twice.
    """
    chosen = [load_model(name) for name in models or DEFAULT_MODELS]
    names = [model.name for model in chosen]
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise InputError(f"--models: '{doubled}' is listed {names.count(doubled)} times: list each once")
    return chosen


def load_series(request: CompareRequest, selection: Selection) -> list[FitData]:
    """Return each record as a separate series, or all as one set of data.

    Raises:
        InputError: records cannot be used, or the number of valves fits neither one nor each.
    """
    records, valves, together = request.records, request.valve, request.together
    if len(valves) > 1 and (together or len(valves) != len(records)):
        raise InputError(
            f"--valve was given {len(valves)} times for {len(records)} records: give it once for all"
            + ("" if together else " or once for each")
        )
    if together or len(records) == 1:
        return [load_data(records, valves[0] if valves else None, selection, request.holdout)]
    if request.holdout:
        raise InputError("--holdout: several records are separate series: pass --together, or one record")
    given = valves if len(valves) == len(records) else [*valves[:1], None][:1] * len(records)
    return [load_data([path], valve, selection) for path, valve in zip(records, given, strict=True)]


def fit_all(data: Sequence[FitData], models: Sequence[Model], settings: FitSettings) -> list[FittedSeries]:
    """Return every model fitted to every series, with what each determines at the model's start values."""
    series = []
    with progress("fitting", len(data) * len(models), steady=False) as advance:
        for one in data:
            validated = []
            for model in models:
                validated.append(fit_and_validate(one, model, settings))
                advance(1.0)
            validated = no_worse(one, validated, settings)
            known = [determined_before(one.fitted, model, one.valve) for model in models]
            series.append(
                FittedSeries(
                    one,
                    tuple(
                        replace(found, fit=replace(found.fit, determinations=own))
                        for found, own in zip(validated, known, strict=True)
                    ),
                )
            )
    return series


def _named(given: Sequence[str], model: Model, option: str) -> dict[str, float | None]:
    found: dict[str, float | None] = {}
    for text in given:
        name, mark, number = (part.strip() for part in text.partition("="))
        parameter = model.parameter(name, option)
        found[name] = None
        if mark:
            try:
                value = float(number)
            except ValueError:
                raise InputError(f"{option} {text}: {number!r} is not a number: write {name}=1.5") from None
            found[name] = parameter.check(value, option)
    return found

"""Fit of one model to records of one valve, with the files that come of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from spool_core.errors import InputError
from spool_estimator.identification.fit_result import FitSettings
from spool_sim.model import Model, load_model
from spool_sim.valve.description import Valve

from spool_tools.console.outputs import write_file, write_json
from spool_tools.console.progress import progress
from spool_tools.console.result_files import ResultFiles
from spool_tools.console.terminal import warn
from spool_tools.input.fit_data import load_data
from spool_tools.input.record_loading import Selection
from spool_tools.report.fit_tables import print_fit, to_dictionary
from spool_tools.report.model_file import LONGEST_NAME, save_model
from spool_tools.report.validated_fit import fit_and_validate


def run_fit(
    records: Sequence[Path],
    valve: str | None,
    model_name: str,
    selection: Selection,
    outputs: ResultFiles,
    *,
    held_out: Sequence[Path] = (),
    free: Sequence[str] = (),
    fixed: Sequence[str] = (),
    sensor_gain: bool = False,
    sensor_delay: bool = False,
) -> int:
    """Fit a model and say what came out; return 1 where nothing did.

    Raises:
        InputError: records, valve, model or parameters cannot be used.
    """
    model = load_model(model_name)
    wanted = outputs.within("fit", model=True)
    data = load_data(records, valve, selection, held_out)
    settings = fit_settings(model, data.valve, free, fixed, gain=sensor_gain, delay=sensor_delay)
    for doubt in data.doubts:
        warn(doubt)
    with progress(f"fitting {model.name}"):
        validated = fit_and_validate(data, model, settings)
    if wanted.json is not None:
        write_json(wanted.json, to_dictionary(validated))
    console = Console()
    if validated.fit.reason is not None:
        console.print(f"no result: {validated.fit.reason}", markup=False, highlight=False, soft_wrap=True)
        return 1
    print_fit(validated, console)
    if wanted.model is not None:
        name = f"{model.name[:LONGEST_NAME]}_fitted"
        comment = f"{model.name}, fitted to {', '.join(map(str, data.paths))}"
        save_model(wanted.model, model, name, validated.fit.values, validated.fit.parameters, comment)
        print(f"{wanted.model}: the fitted model")
    if wanted.report is not None:
        from spool_tools.report.fit_page import fit_page  # noqa: PLC0415 - matplotlib is needed here only

        with progress("drawing"):
            write_file(wanted.report, fit_page(validated), "--report")
        print(f"{wanted.report}: pictures and tables")
    return 0


def fit_settings(
    model: Model,
    valve: Valve,
    free: Sequence[str],
    fixed: Sequence[str],
    *,
    gain: bool = False,
    delay: bool = False,
) -> FitSettings:
    """Return the settings that ``--free`` and ``--fix`` ask for, each ``PARAMETER`` or ``PARAMETER=VALUE``.

    Raises:
        InputError: no such parameter, not a number, out of range, or both free and fixed.
    """
    released = _named(free, model, "--free")
    held = _named(fixed, model, "--fix")
    both = sorted(set(released) & set(held))
    if both:
        raise InputError(f"{both[0]}: given to --free and to --fix: use one of them")
    described = model.values_for(valve)
    return FitSettings(
        held={name: described[name] if value is None else value for name, value in held.items()},
        free=tuple(released),
        start={name: value for name, value in released.items() if value is not None},
        fit_gain=gain,
        fit_delay=delay,
    )


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

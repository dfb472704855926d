"""`./spool fit --setups`: one model fitted to several set-ups of one valve, and what is written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from spool_core.errors import InputError
from spool_estimator.identification.setups import SetUp, fit_setups
from spool_report.fit_tables import LONGEST_NAME, save_model
from spool_report.outputs import ResultFiles, check_output, write_file, write_json
from spool_report.ranking import validated
from spool_report.records.record_loading import FitData, load_data
from spool_report.requests import FitRequest, Selection
from spool_report.runs.fit_run import fit_settings
from spool_report.terminal import progress, warn
from spool_sim.model import load_model
from spool_sim.valve import Valve, find_valve, read_mapping

from spool_design.setups import DescribedSetUp, FittedSetUps, print_setups, read_setups, to_dictionary


@dataclass(frozen=True, slots=True)
class SetUpsRequest:
    """Request to fit one model to several set-ups.

    Attributes:
        content: what the file of the set-ups holds.
        where: name of the file, for messages.
        folder: that the paths of records start from.
        fit: model, the valve that all set-ups are of, and parameters; without records.
    """

    content: Mapping[str, Any]
    where: str
    folder: Path
    fit: FitRequest


def run_setups(file: Path, fit: FitRequest, selection: Selection, outputs: ResultFiles) -> int:
    """Fit a model to the set-ups of ``file`` and report the result; return 1 if there is none.

    Raises:
        InputError: the file of the set-ups, records, valve, model or parameters cannot be used.
    """
    request = SetUpsRequest(read_mapping(file, "set-ups"), str(file), file.parent, fit)
    load_model(fit.model)  # refused before the files are made
    wanted = outputs.within("fit", model=True)
    found = fit_setups_of(request, selection)
    for one in found.data:
        for doubt in one.doubts:
            warn(f"{one.name}: {doubt}")
    if wanted.json is not None:
        write_json(wanted.json, to_dictionary(found))
    console = Console()
    print_setups(found, console)
    if found.joint.reason is not None:
        return 1
    if wanted.model is not None:
        for path in save_models(wanted.model, found):
            print(f"{path}: the fitted model")
    if wanted.report is not None:
        from spool_design.setups_page import setups_page  # noqa: PLC0415 - matplotlib is needed here only

        with progress("drawing"):
            write_file(wanted.report, setups_page(found), "--report")
        print(f"{wanted.report}: pictures and tables")
    return 0


def fit_setups_of(request: SetUpsRequest, selection: Selection) -> FittedSetUps:
    """Return a model fitted to set-ups, with its errors on held-out data.

    Raises:
        InputError: the file of the set-ups, records, valve, model or parameters cannot be used.
    """
    if request.fit.valve is None:
        raise InputError(
            "--setups: pass the valve of all set-ups with --valve; the file states the differences"
        )
    valve, model = find_valve(request.fit.valve), load_model(request.fit.model)
    setups, shared = read_setups(request.content, request.where, request.folder, valve, model)
    settings = fit_settings(model, valve, request.fit)
    both = sorted(set(settings.held) & set(shared))
    if both:
        raise InputError(f"{request.where}: shared: {both[0]}: --fix holds it: remove one of them")
    missing = [(one.name, path) for one in setups for path in one.records if not path.exists()]
    if missing:
        names = ", ".join(f"set-up '{name}': {path}" for name, path in missing)
        raise InputError(f"{request.where}: no such record: {names}: correct the names of the files")
    data = tuple(
        load_data(one.records, one.valve, selection, springs=one.known.spring_stiffness is not None)
        for one in setups
    )
    what = f"fitting {model.name} to {len(setups)} set-ups"
    with progress(what, len(setups) * settings.allowed, at_most=True) as tell:
        joint = fit_setups(
            [_setup(one, part, valve) for one, part in zip(setups, data, strict=True)],
            model,
            shared,
            settings,
            tell,
        )
        fits = tuple(validated(part, one, settings) for part, one in zip(data, joint.fits, strict=False))
    return FittedSetUps(valve, setups, data, shared, joint, fits)


def save_models(path: Path, found: FittedSetUps) -> list[Path]:
    """Write the fitted model of each set-up beside ``path``, the set-up's name added; return the files.

    Raises:
        InputError: a file is there already, or cannot be written.
    """
    paths = [path.with_name(f"{path.stem}_{one.name}{path.suffix}") for one in found.setups]
    for file in paths:
        check_output(file, "--save-model")
    for file, setup, one in zip(paths, found.setups, found.validated, strict=True):
        name = f"{one.name[: LONGEST_NAME - 51]}_{setup.name}_fitted"
        comment = f"{one.name}, set-up {setup.name} of {', '.join(other.name for other in found.setups)}"
        save_model(file, one.fit.model, name, one.fit.values, one.fit.parameters, comment)
    return paths


def _setup(one: DescribedSetUp, data: FitData, valve: Valve) -> SetUp:
    oil = (one.known.dynamic_viscosity, one.known.oil, one.known.oil_temperature)
    changed = any(value is not None for value in oil)
    stiffness = one.known.spring_stiffness
    return SetUp(
        one.name,
        data.fitted,
        one.valve,
        {} if stiffness is None else {"spring_stiffness": stiffness},
        one.known.added_mass or 0.0,
        one.valve.dynamic_viscosity / valve.dynamic_viscosity if changed else 1.0,
    )

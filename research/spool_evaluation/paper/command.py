"""Command `./spool paper`: the paper's four series and four models, without the authors' measurements."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from spool_core.errors import InputError
from spool_tools.outputs import write_json
from spool_tools.report import page as html
from spool_tools.terminal import progress

from spool_evaluation.paper.page import (
    amplitude_table,
    derived_table,
    gap_table,
    mean_table,
    parameter_table,
    write_csv,
)
from spool_evaluation.paper.reproduction import Regime, force_table, ranking_table

from .data import MODELS, SERIES
from .page import TITLE, sections
from .reproduction import Reproduction, locked, reproduce
from .simulation import TRUTH, Plan


def run_paper(out: Path, plan: Plan | None = None) -> None:
    """Simulate, fit and write page, pictures and tables into the folder ``out``.

    Raises:
        InputError: ``out`` cannot be made or is a file.
    """
    plan = plan or Plan()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made: {error.strerror}; name another folder") from error
    jobs = len(SERIES) * (len(MODELS) + 1)
    with progress("simulating and fitting", jobs + len(SERIES)) as advance:
        results = reproduce(plan, advance)
    write(out, results)
    _tell(results)
    print(f"{out / 'paper.html'}: figures and tables, with the printed numbers")


def write(out: Path, results: Reproduction) -> None:
    """Write ``paper.html``, ``paper.json``, pictures as PNG and tables as CSV into ``out``."""
    tables = {f"table_{model.table}": parameter_table(model, results.fits) for model in MODELS}
    tables["table_7"] = mean_table(results.fits)
    tables["objective_with_h_fitted"] = gap_table(results.fits, results.free)
    regimes = (Regime("small accelerations", results.data, results.fits), results.full)
    tables["derived"] = derived_table()
    tables["models_in_both_regimes"] = ranking_table(regimes)
    tables["forces_in_both_regimes"] = force_table(results.plan)
    for name, rows in tables.items():
        write_csv(out / f"{name}.csv", rows)
    amplitudes = amplitude_table(results.data, results.fits, results.printed)
    write_csv(out / "amplitudes.csv", amplitudes)
    write_json(
        out / "paper.json",
        {
            "truth": {"model": "viscous_friction + stribeck_friction", "parameters": TRUTH},
            "plan": asdict(results.plan),
            "fits": [
                {"series": one.series, "model": one.model, "h_fitted": one.free_gap, "decrease": one.decrease}
                for one in (*results.fits.values(), *results.free.values())
            ],
            "spool_follows_body_with_table_4": locked(results),
            "tables": tables,
            "amplitudes": amplitudes,
        },
    )
    page = html.page(TITLE, sections(out, results, tables))
    (out / "paper.html").write_text(page, encoding="utf-8")


def _tell(results: Reproduction) -> None:
    for row in mean_table(results.fits):
        print(
            f"model {row['model']:9} a_est/a_pom {row['a_est/a_pom, fitted']:.3f} (printed "
            f"{row['a_est/a_pom, printed']:.2f}), objective {row['objective, fitted']:.3g}"
        )
    followed = sum(locked(results).values())
    print(f"table 4's values lock the spool (a_spool = a_body) in {followed} of {len(SERIES)} series")

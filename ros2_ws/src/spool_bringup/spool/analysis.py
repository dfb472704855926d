"""Analyses of records: what the commands of the same names do."""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, cast

from spool.errors import one_error
from spool.record import AnyRecord, AnyValve, path_of, paths_of, valve_files
from spool.results import Comparison, Fit, Gap, Replay, keeping_backend, text_console, text_of


@one_error
def fit(
    records: AnyRecord | Iterable[AnyRecord],
    valve: AnyValve | None = None,
    model: str | Path = "coulomb",
    *,
    holdout: Sequence[AnyRecord] = (),
    free: Sequence[str] = (),
    fix: Sequence[str] = (),
    sensor_gain: bool = False,
    sensor_delay: bool = False,
) -> Fit:
    """Fit one model to records.

    Args:
        records: one or several of the same valve, which are one set of data.
        valve: description, name or file; default: the bag's own description.
        model: name or YAML file.
        holdout: records to judge errors by; default: pieces of ``records``.
        free: parameters to fit though the valve file gives them, ``"moving_mass"`` or ``"moving_mass=0.18"``.
        fix: parameters to hold, ``"coulomb_force=0.3"``, or as the valve file has them.
        sensor_gain: fit the gain of the spool's sensor.
        sensor_delay: fit its delay.

    Raises:
        InputError: records, valve, model or parameters cannot be used.
    """
    from spool_tools.operations.fit_run import fit_records  # noqa: PLC0415
    from spool_tools.operations.record_loading import Selection  # noqa: PLC0415 - slow to load, as below

    with valve_files([valve]) as (file,):
        validated = fit_records(
            paths_of(records), file, str(model), Selection(), held_out=paths_of(holdout), free=free,
            fixed=fix, sensor_gain=sensor_gain, sensor_delay=sensor_delay,
        )  # fmt: skip
    for doubt in (*validated.data.doubts, *validated.fit.warnings):
        warnings.warn(doubt, stacklevel=3)
    return Fit(validated)


@one_error
def compare(
    records: AnyRecord | Iterable[AnyRecord],
    valve: AnyValve | Sequence[AnyValve] | None = None,
    models: Sequence[str | Path] = (),
    *,
    together: bool = False,
    holdout: Sequence[AnyRecord] = (),
) -> Comparison:
    """Fit several models to records and rank them.

    Args:
        records: each is one series, as in the paper.
        valve: for all records, or one for each.
        models: names or YAML files; default: the paper's four, coulomb and stribeck.
        together: take all records as one set of data.
        holdout: records to judge errors by; default: pieces of ``records``.

    Raises:
        InputError: records, valves or models cannot be used.
    """
    from spool_tools.operations.fit_run import compare_records  # noqa: PLC0415
    from spool_tools.operations.record_loading import Selection  # noqa: PLC0415

    given: list[AnyValve] = []
    if valve is not None:
        given = list(valve) if isinstance(valve, (list, tuple)) else [cast("AnyValve", valve)]
    with valve_files(given) as files:
        found = compare_records(
            paths_of(records), [str(file) for file in files], [str(one) for one in models], Selection(),
            held_out=paths_of(holdout), together=together,
        )  # fmt: skip
    return Comparison(*found)


@one_error
def gap(
    records: AnyRecord | Iterable[AnyRecord],
    valve: AnyValve | None = None,
    base: str | Path = "fluid",
    *,
    kind: str = "accelerations",
    holdout: Sequence[AnyRecord] = (),
    **options: Any,
) -> Gap:
    """Find where simulation and records disagree, name what is missing, add it, measure the gap again.

    Args:
        records: one or several of the same valve, which are one set of data.
        valve: description, name or file; default: the bag's own description.
        base: model that something may be missing from: name or YAML file.
        kind: ``accelerations``, ``driven`` (a force moves the mass) or ``imposed`` (it is the reaction).
        holdout: records to judge by; default: every other stretch.
        options: of the command ``gap``: ``gain_tolerance``, ``delay_tolerance`` (s), ``mass`` (kg),
            ``least_share``, ``thorough``, ``profiles``.

    Raises:
        InputError: records, valve or model cannot be used.
    """
    with keeping_backend(), valve_files([valve]) as (file,), tempfile.TemporaryDirectory() as folder:
        from spool_tools.operations.gap_run import run_gap  # noqa: PLC0415
        from spool_tools.operations.record_loading import Selection  # noqa: PLC0415
        from spool_tools.outputs import ResultFiles  # noqa: PLC0415

        found, page, model = (Path(folder) / name for name in ("gap.json", "gap.html", "gap.yaml"))
        shown = text_console()
        with contextlib.redirect_stdout(io.StringIO()):
            run_gap(
                paths_of(records), file, str(base), kind, Selection(), ResultFiles(found, page, model),
                holdout=paths_of(holdout), console=shown, **options,
            )  # fmt: skip
        return Gap(
            json.loads(found.read_text(encoding="utf-8")),
            text_of(shown),
            page.read_text(encoding="utf-8"),
            model.read_text(encoding="utf-8"),
        )


@one_error
def replay(
    record: AnyRecord, valve: AnyValve | None = None, *, report: bool = False, **options: Any
) -> Replay:
    """Run the live estimator and monitor over a record.

    Args:
        record: bag or file; a bag may hold several valves.
        valve: description, name or file; default: what the bag describes.
        report: draw the page that ``save("replay.html")`` writes.
        options: ``method`` (``prediction`` or ``equation``), ``baseline_time`` (s), ``state`` (folder that
            keeps baselines).

    Raises:
        InputError: record or valve cannot be used.
    """
    from spool_tools.operations.record_replay import replay_bag  # noqa: PLC0415

    with valve_files([valve]) as (file,), tempfile.TemporaryDirectory() as folder:
        given = [] if file is None else [file]
        if not report:
            return Replay(replay_bag(path_of(record), given, **options), "")
        page = Path(folder) / "replay.html"
        with keeping_backend():
            found = replay_bag(path_of(record), given, report=page, **options)
        return Replay(found, page.read_text(encoding="utf-8"))

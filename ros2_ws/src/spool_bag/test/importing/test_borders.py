"""Borders of what files hold: rows that end early, slow rates, files that no library opens."""

from __future__ import annotations

import gc
import sys
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from scipy.io import savemat
from spool_bag.importing.logger_record import read_record
from spool_core.errors import InputError

from . import loggers as made


def test_cells_that_a_row_of_a_workbook_lacks_are_holes(tmp_path: Path) -> None:
    """A workbook that is written row by row ends each row with its last cell."""
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet()
    sheet.append(["Time [s]", "Body [m/s2]", "Spool [m/s2]", "Oil [degC]"])
    for at, row in enumerate(zip(made.TIME, made.BODY, made.SPOOL, strict=True)):
        sheet.append([*map(float, row), *([45.0] if at % 2 == 0 else [])])
    book.save(tmp_path / "book.xlsx")
    oil = read_record(tmp_path / "book.xlsx").columns["oil_temperature_C"]
    assert np.isnan(oil[1::2]).all()
    assert (oil[::2] == 45.0).all()


def test_a_row_of_a_workbook_without_a_time_is_named(tmp_path: Path) -> None:
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet()
    sheet.append(["time", "body [m/s2]", "spool [m/s2]"])
    for at, row in enumerate(zip(made.BODY[:400], made.SPOOL[:400], strict=True)):
        time = datetime(2025, 1, 2) + timedelta(milliseconds=at)
        sheet.append([None if at == 200 else time, *map(float, row)])
    book.save(tmp_path / "book.xlsx")
    with pytest.raises(InputError, match="row 202: time is 'None', not a number"):
        read_record(tmp_path / "book.xlsx")


@pytest.mark.parametrize(
    ("setting", "value", "said"),
    [
        *(
            (setting, value, "steps by 20 s")
            for setting, value in (("fs", 0.05), ("dt", 20.0), ("dt_ms", 2e4))
        ),
        *(("fs", value, "--rate") for value in (0.0, -2000.0, np.nan, np.inf)),
    ],
)
def test_a_stated_rate_that_no_valve_is_sampled_at_is_refused_as_stated_or_is_none(
    tmp_path: Path, setting: str, value: float, said: str
) -> None:
    savemat(tmp_path / "x.mat", {"body_m_s2": made.BODY, "spool_m_s2": made.SPOOL, setting: value})
    with pytest.raises(InputError, match=said):
        read_record(tmp_path / "x.mat")


def test_a_measurement_file_that_cannot_be_opened_leaves_no_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", shown.append)
    path = tmp_path / "cut.mf4"
    path.write_bytes(b"MDF     4.10" + bytes(80))
    with pytest.raises(InputError, match="cannot be read as ASAM MDF"):
        read_record(path)
    gc.collect()
    assert shown == []

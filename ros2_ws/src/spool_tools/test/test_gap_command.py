"""`./spool gap`: the files and the terminal of one analysis."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from spool_tools.cli import main

SOFT = find_valve("4weh10_soft")


def test_page_json_and_terminal_show_what_was_taken_where_nothing_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, made = (
        tmp_path / "gap.html",
        Simulator(SOFT, PRESETS["multisine"], model="fluid", sample_rate=500.0),
    )
    blocks = list(made.records(10.0))
    body, spool = (np.concatenate([getattr(one, name) for one in blocks]) for name in ("body", "spool"))
    time = np.arange(body.size) / 500.0
    hum = 0.3 * np.cos(2.0 * np.pi * 50.03 * time)
    record, result = tmp_path / "x.csv", tmp_path / "gap.json"
    rows = np.transpose([time, body, spool + hum])
    np.savetxt(record, rows, fmt="%.9g", delimiter=",", header="time_s,body_m_s2,spool_m_s2", comments="")
    words = ["gap", str(record), "--valve", SOFT.id, "--report", str(page), "--json", str(result)]
    assert main(words) == 0
    found = json.loads(result.read_text("utf-8"))
    assert found["verdict"] == "none"
    assert [row["id"] for row in found["ranking"] if row["accepted"]] == ["none"]
    text, printed = page.read_text("utf-8"), capsys.readouterr().out
    assert re.search(r"<td>none</td>(\s*<td[^>]*>[^<]*</td>){3}\s*<td>accepted</td>", text)
    assert "of windows that no fit has seen" in text
    assert re.search(
        r"Measuring-chain effects.*?<td>hum[^<]*</td>\s*<td>spool</td>\s*<td[^>]*>0\.30 m/s", text, re.S
    )
    errors = [f"{100.0 * found['gap'][when]['nrmse']:.2g} %" for when in ("before", "after")]
    assert f"Held-out error {errors[0]} before, {errors[1]} after" in text
    for shown in (text, printed):
        assert "The record determines: spring stiffness, viscous coefficient." in shown
        assert "another one is better" not in shown
        assert "noise alone up to" not in shown
    assert re.search(r"^none +the base .* accepted *$", printed, re.MULTILINE)

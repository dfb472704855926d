"""`./spool valve check`."""

from __future__ import annotations

from pathlib import Path

import pytest
from spool_sim.valve.description import shipped_valves
from spool_tools.cli import main


def test_quantities_of_the_papers_valve(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["valve", "check", "4weh10_soft"]) == 0
    said = capsys.readouterr().out
    assert "15.15 Hz" in said
    assert "8.203 N s/m at 20 deg C" in said
    # (6) by hand: 8.2033 N s/m x 0.5 m/s over 0.172 kg x 9.80665 m/s^2.
    assert "equation (6): 2.43" in said
    assert "5 um of roughness" in said
    assert "equation (31): 5 %" in said


def test_springs_in_n_per_mm_look_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = shipped_valves()["4weh10_soft"].read_text(encoding="utf-8")
    file = tmp_path / "valve.yaml"
    file.write_text(text.replace("1632.0", "1.632"), encoding="utf-8")
    assert main(["valve", "check", str(file)]) in (1, 2)
    told = capsys.readouterr()
    assert "N/mm" in told.out + told.err


def test_missing_file_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["valve", "check", "nowhere.yaml"]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1

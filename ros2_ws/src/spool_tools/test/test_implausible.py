"""Implausible input to the commands: wrong units, the wrong valve, records that show nothing."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from spool_core.block import Block
from spool_core.block_gate import malformed
from spool_sim.valve import shipped_valves
from spool_tools.cli import main

RATE = 1000.0


def written(path: Path, columns: str, rows: list[tuple[float, ...]]) -> str:
    path.write_text(
        "\n".join([columns, *(",".join(f"{value:.9g}" for value in row) for row in rows)]) + "\n", "utf-8"
    )
    return str(path)


def shaken(path: Path, unit: float = 1.0) -> str:
    """Write 10 s of a 30 Hz sine; ``unit`` is what a second counts in the file."""
    turn = 2.0 * math.pi * 30.0 / RATE
    rows = [
        (number / RATE * unit, 10.0 * math.sin(turn * number), 4.0 * math.sin(turn * number + 2.0))
        for number in range(int(10.0 * RATE))
    ]
    return written(path, "time_s,body_m_s2,spool_m_s2", rows)


def refusal(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one line that a command refuses with."""
    assert main(arguments) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("spool: ")]
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize(
    ("command", "unit", "said"),
    [
        *((command, 1e3, ["milliseconds"]) for command in ("replay", "fit", "compare")),
        *(
            (command, 25.0, ["40 Hz is too slow for ", "sample at "])
            for command in ("replay", "fit", "compare", "gap")
        ),
    ],
)
def test_milliseconds_taken_for_seconds_and_a_record_too_slow_for_its_valve_are_refused(
    command: str, unit: float, said: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refusal([command, shaken(tmp_path / "record.csv", unit=unit), "--valve", "4weh10_soft"], capsys)
    assert [one for one in said if one not in line] == []


def test_noise_alone_is_called_too_slow_by_no_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.05, (4000, 2))
    rows = [(number / RATE, body, spool) for number, (body, spool) in enumerate(noise.tolist())]
    main(["check", written(tmp_path / "record.csv", "time_s,body_m_s2,spool_m_s2", rows)])
    assert "too slow" not in capsys.readouterr().out


@pytest.mark.parametrize("rate", [15.0, 25.0])
def test_a_rate_is_taken_live_where_it_is_taken_as_a_file(rate: float, tmp_path: Path) -> None:
    rows = [(number / rate, math.sin(number), math.cos(number)) for number in range(200)]
    record = written(tmp_path / "record.csv", "time_s,body_m_s2,spool_m_s2", rows)
    taken = main(["import", record, "--look"]) == 0
    body, spool = (np.array([row[column] for row in rows], np.float32) for column in (1, 2))
    assert taken == (malformed(Block(1, 0, 1.0 / rate, body, spool)) is None)


@pytest.mark.parametrize("command", ["replay", "fit", "compare", "gap", "simulate"])
def test_masses_in_grams_are_refused_by_every_command(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = shipped_valves()["4weh10_soft"].read_text(encoding="utf-8")
    grams = tmp_path / "grams.yaml"
    grams.write_text(text.replace("0.18 ", "180").replace("0.172 ", "172"), "utf-8")
    record = [] if command == "simulate" else [shaken(tmp_path / "record.csv")]
    out = ["--out", str(tmp_path / "bag")] if command == "simulate" else []
    said = refusal([command, *record, "--valve", str(grams), *out], capsys)
    assert "moving_mass: 180 kg" in said
    assert "did you write g?" in said
    assert not (tmp_path / "bag").exists()


def test_the_wrong_valve_is_warned_of_on_the_terminal_in_json_and_on_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, json_file, page = (str(tmp_path / name) for name in ("bag", "fit.json", "fit.html"))
    assert main(["simulate", "--seconds", "12", "--excitation", "multisine", "--out", bag]) == 0
    arguments = ["fit", bag, "--valve", "4weh10_stiff", "--json", json_file, "--report", page]
    assert main(arguments) == 0
    said = "says 28.7 Hz, the record shows 15 Hz (95 %: 14."
    assert said in " ".join(capsys.readouterr().err.split())
    assert any(said in warning for warning in json.loads(Path(json_file).read_text("utf-8"))["warnings"])
    assert said in Path(page).read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_doubted_valve_file_caps_the_confidence_of_a_gap_analysis(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = tmp_path / "record"
    words = ["--coulomb-force", "0.5", "--excitation", "multisine", "--seconds", "8"]
    assert main(["simulate", *words, "--out", str(record)]) == 0
    out = tmp_path / "gap.json"
    assert main(["gap", str(record), "--valve", "4weh10_stiff", "--json", str(out)]) == 0
    result = json.loads(out.read_text("utf-8"))
    assert result["verdict"] == "coulomb_friction"
    assert result["confidence"] == 0.5
    assert "the record shows 15" in capsys.readouterr().err

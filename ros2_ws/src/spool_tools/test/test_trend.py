"""`./spool trend`: what the monitor kept, as a picture and as numbers."""

from __future__ import annotations

import itertools
import json
import re
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest
from spool_monitor.state_file import valve_folder
from spool_monitor.trend import Sums, TrendStore
from spool_tools.cli import main

NOW = int(time.time()) // 60 * 60


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """Three hours of a valve whose Coulomb force rises, with a standstill of half an hour in between."""
    path = valve_folder(tmp_path / "state", "press/left") / "trends.sqlite"
    path.parent.mkdir(parents=True)
    store = TrendStore(path)
    sums = Sums()
    for second in range(0, 3 * 3600, 10):
        if 3600 <= second < 5400:
            continue
        at = (NOW - 3 * 3600 + second) * 1_000_000_000
        sums.add(at, "coulomb_force", "N", 0.1 + 1e-5 * second)
        sums.add(at, "spring_stiffness", "N/m", 1632.0)
        sums.add(at, "relative_displacement", "m", 0.00125)
    sums.count("travel", "m", 250.0)
    store.write(sums, NOW * 1_000_000_000)
    store.close()
    return tmp_path / "state"


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main(["trend", *map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_the_numbers_are_those_that_were_kept(
    kept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "trend.json"
    code, out, _ = run(capsys, "press/left", "--state-folder", kept, "--json", file)
    assert code == 0
    assert "travel in all: 250 m" in out
    result: dict[str, Any] = json.loads(file.read_text("utf-8"))
    assert result["span_s"] == 60
    assert result["counters"] == {"travel": {"value": 250.0, "unit": "m"}}
    force = result["parameters"]["coulomb_force"]
    assert force["unit"] == "N"
    assert sum(force["count"]) == 900
    assert force["mean"][0] == pytest.approx(0.1 + 1e-5 * 25)
    assert all(low <= mean <= high for low, mean, high in zip(
        force["minimum"], force["mean"], force["maximum"], strict=True
    ))  # fmt: skip
    assert max(b - a for a, b in itertools.pairwise(force["start_s"])) == 1860


def test_people_read_the_displacement_in_mm_and_programs_in_m(
    kept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, drawn = tmp_path / "trend.json", tmp_path / "trend.html"
    _, out, _ = run(capsys, "press/left", "--state-folder", kept, "--json", file, "--out", drawn)
    assert re.search(r"relative displacement +mm +1\.250 +1\.250 +1\.250", out)
    assert "relative displacement from 1.250 to 1.250 mm" in drawn.read_text(encoding="utf-8")
    displacement = json.loads(file.read_text("utf-8"))["parameters"]["relative_displacement"]
    assert displacement["unit"] == "m"
    assert displacement["maximum"][0] == 0.00125


def at(seconds: int) -> str:
    """Return a time, s since 1970, as --since takes it."""
    return datetime.fromtimestamp(seconds, timezone.utc).strftime("%Y-%m-%dT%H:%M:%S")


@pytest.mark.parametrize(("since", "minutes"), [(at(NOW - 1800), 30), ("2w", 150)])
def test_one_parameter_since_a_time(
    kept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], since: str, minutes: int
) -> None:
    file = tmp_path / "trend.json"
    arguments = ("--state-folder", kept, "--parameter", "coulomb_force", "--since", since, "--json", file)
    assert run(capsys, "press/left", *arguments)[0] == 0
    result = json.loads(file.read_text("utf-8"))
    assert list(result["parameters"]) == ["coulomb_force"]
    assert len(result["parameters"]["coulomb_force"]["mean"]) == minutes


def test_a_parameter_without_a_value_since_a_time_is_named_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The hour in which the time lies has values, but of before."""
    path = valve_folder(tmp_path, "v") / "trends.sqlite"
    path.parent.mkdir(parents=True)
    store, sums, hour = TrendStore(path), Sums(), NOW // 3600 * 3600
    sums.add(hour * 1_000_000_000, "coulomb_force", "N", 0.1)
    sums.add((hour + 3600) * 1_000_000_000, "spring_stiffness", "N/m", 1632.0)
    store.write(sums)
    store.close()
    arguments = ("v", "--state-folder", tmp_path, "--since", at(hour + 60), "--parameter", "coulomb_force")
    code, _, said = run(capsys, *arguments)
    assert code == 2
    assert said == "spool: v: nothing of coulomb_force was kept since then: leave --since out\n"
    code, shown, _ = run(capsys, *arguments, "--parameter", "spring_stiffness")
    assert code == 0
    assert "spring stiffness" in shown
    assert "coulomb force" not in shown


@pytest.mark.parametrize(("name", "begins"), [("t.png", b"\x89PNG"), ("t.html", b"<!doctype html>")])
def test_a_picture_or_a_page_is_written(
    kept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, begins: bytes
) -> None:
    out = tmp_path / name
    assert run(capsys, "press/left", "--state-folder", kept, "--out", out)[0] == 0
    assert out.read_bytes().startswith(begins)
    assert out.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["valve_9"], "valve_9: no trends in .*; there are trends of: press/left"),
        (["press/left", "--parameter", "mood"], "--parameter mood: press/left has: coulomb_force, "),
        (["press/left", "--since", "lately"], "--since 'lately': write it like 90m"),
        (["press/left", "--since", "2999-01-01"], "nothing was kept since then"),
        (["press/left", "--out", "t.pdf"], r"--out t\.pdf: name a file that ends in \.png or \.html"),
        (["no valve"], "valve name 'no valve'"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    kept: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], reason: str
) -> None:
    code, _, said = run(capsys, *arguments, "--state-folder", kept)
    assert code == 2
    assert len(said.splitlines()) == 1
    assert re.search(reason, said), said

"""`import`, `--look` and `check` on the command line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from spool_bag.reader import BagReader
from spool_tools.cli import main

GRAVITY = 9.80665
BAG = Path(__file__).parents[4] / "bags" / "practice_01"


@pytest.fixture(scope="module")
def practice() -> tuple[np.ndarray, np.ndarray]:
    blocks = list(BagReader(BAG).blocks("valve_1"))
    return tuple(
        np.concatenate([getattr(b, name) for b in blocks]).astype(float) for name in ("body", "spool")
    )


def table(
    folder: Path, name: str, header: str, practice: tuple[np.ndarray, np.ndarray], scale: float
) -> Path:
    body, spool = practice
    path = folder / name
    rows = np.column_stack([np.arange(body.size) / 2000.0, scale * body, scale * spool])
    np.savetxt(path, rows, ["%.4f", "%.12g", "%.12g"], ",", header=header, comments="")
    return path


def fitted(bag: Path, capsys: pytest.CaptureFixture[str], *options: str) -> dict[str, tuple[float, float]]:
    """Return value and standard deviation of each parameter."""
    capsys.readouterr()
    how = ["--valve", "4weh10_soft", "--model", "fluid", "--stop", "10", "--json", "-"]
    assert main(["fit", str(bag), *how, *options]) == 0
    found = json.loads(capsys.readouterr().out)
    return {name: (one["value"], one["std"]) for name, one in found["parameters"].items()}


def check_same(first: dict[str, tuple[float, float]], second: dict[str, tuple[float, float]]) -> None:
    """Check that values agree within 1e-6, or 1e-4 of the deviation where a value is about 0."""
    assert first.keys() == second.keys()
    for name, (value, deviation) in second.items():
        assert first[name][0] == pytest.approx(value, rel=1e-6, abs=1e-4 * deviation), name


def test_g_millivolts_and_si_give_the_same_record(
    tmp_path: Path, practice: tuple[np.ndarray, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    made = {
        "si": (1.0, "body=m/s^2,spool=m/s^2", None),
        "g": (1.0 / GRAVITY, "body=g,spool=g", None),
        "mv": (100.0 / GRAVITY, "body=mV,spool=mV", "body=100mV/g,spool=100mV/g"),
        "v": (0.1 / GRAVITY, "body=V,spool=V", "body=100mV/g,spool=100mV/g"),
    }
    results = {}
    for name, (size, unit, scale) in made.items():
        path = table(tmp_path, f"{name}.csv", "time [s],body,spool", practice, size)
        assert main(["import", str(path), "--out", str(tmp_path / "refused")]) == 2
        said = capsys.readouterr().err
        assert "type --unit body=g,spool=g, or --unit body=m/s^2,spool=m/s^2, or --unit body=V" in said
        assert not (tmp_path / "refused").exists()
        how = (["--unit", unit] if unit else []) + (["--scale", scale] if scale else [])
        assert main(["import", str(path), "--out", str(tmp_path / name), *how]) == 0
        blocks = BagReader(tmp_path / name).blocks("valve_1")
        results[name] = np.concatenate([row for block in blocks for row in (block.body, block.spool)])
    for name in ("g", "mv", "v"):
        np.testing.assert_allclose(results[name], results["si"], rtol=1e-6, atol=1e-6)


def test_a_look_says_what_is_understood_and_writes_no_bag(
    tmp_path: Path, practice: tuple[np.ndarray, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    path = table(tmp_path, "logger.csv", "time [s],body [g],spool [g]", practice, 1.0 / GRAVITY)
    page, told = tmp_path / "look.html", tmp_path / "look.json"
    assert main(["import", str(path), "--look", "--report", str(page), "--json", str(told)]) == 0
    shown = capsys.readouterr().out
    for word in ("body [g]", "2000 Hz", "15.00 Hz", "coherence", "clipped"):
        assert word in shown
    found = json.loads(told.read_text("utf-8"))
    assert found["resonance"]["frequency_Hz"] == pytest.approx(15.0, abs=0.6)
    assert found["channels"]["body"]["rms"] == pytest.approx(float(np.std(practice[0])), rel=1e-4)
    assert found["refused"] is None
    text = page.read_text("utf-8")
    assert "Quality of logger.csv" in text
    assert text.count("data:image/svg+xml") == 2
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["logger.csv", "look.html", "look.json"]


def test_a_look_says_what_import_would_refuse(
    tmp_path: Path, practice: tuple[np.ndarray, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    path = table(tmp_path, "logger.csv", "time [s],body,spool", practice, 1.0)
    assert main(["import", str(path), "--look"]) == 1
    shown = capsys.readouterr().out
    assert "not named" in shown
    assert "import would refuse it" in shown
    assert "--unit body=g" in shown


def test_a_good_record_passes_its_check_and_a_clipped_one_does_not(
    tmp_path: Path, practice: tuple[np.ndarray, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(BAG)]) == 0
    assert "suitable for an estimate" in capsys.readouterr().out
    limit = 0.5 * float(np.abs(practice[1]).max())
    clipped = (practice[0], np.clip(practice[1], -limit, limit))
    path = table(tmp_path, "clipped.csv", "time_s,body_m_s2,spool_m_s2", clipped, 1.0)
    assert main(["check", str(path)]) == 1
    assert "! spool clips at" in capsys.readouterr().out


def test_a_silent_channel_is_told(
    tmp_path: Path, practice: tuple[np.ndarray, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    path = table(tmp_path, "dead.csv", "time_s,body_m_s2,spool_m_s2", (practice[0], 0.0 * practice[1]), 1.0)
    assert main(["check", str(path)]) == 1
    assert "throughout: check sensor and cable" in capsys.readouterr().out


def test_other_commands_read_and_take_units_too_and_say_where_they_are_told(
    tmp_path: Path, practice: tuple[np.ndarray, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    path = table(tmp_path, "g.csv", "time [s],body [g],spool [g]", practice, 1.0 / GRAVITY)
    same = table(tmp_path, "si.csv", "time [s],body [m/s^2],spool [m/s^2]", practice, 1.0)
    of_si, unit = fitted(same, capsys), ("--unit", "body=g,spool=g")
    check_same(fitted(path, capsys), of_si)
    bare = table(tmp_path, "bare.csv", "time [s],body,spool", practice, 1.0 / GRAVITY)
    check_same(fitted(bare, capsys, *unit), of_si)
    kept = []
    for words in ([str(same)], [str(bare), *unit]):
        models = ["--valve", "4weh10_soft", "--models", "fluid,coulomb", "--stop", "10", "--json", "-"]
        assert main(["compare", *words, *models]) == 0
        rows = json.loads(capsys.readouterr().out)["ranking"]
        kept.append({row["model"]: row["error"]["value"] for row in rows})
    assert kept[0] == pytest.approx(kept[1], rel=1e-4)
    assert main(["fit", str(bare), "--valve", "4weh10_soft"]) == 2
    refusal = capsys.readouterr().err
    assert "--unit body=g" in refusal
    assert "import" not in refusal
    assert main(["replay", str(bare), "--valve", "4weh10_soft"]) == 2
    assert "these are options of ./spool import" in capsys.readouterr().err


def test_columns_and_conversions_are_stated_wherever_the_record_is_shown(
    tmp_path: Path, practice: tuple[np.ndarray, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    path = table(tmp_path, "logger.csv", "time [s],Gehäuse [g],acc 2", practice, 1.0 / GRAVITY)
    options = ["--columns", "spool=#2", "--unit", "spool=g", "--unit", "time=s"]
    lines = [
        "time: column #0 'time [s]' in s (--unit time=s)",
        "body: column #1 'Gehäuse [g]', 1 g = 9.80665 m/s^2",
        "spool: column #2 'acc 2', 1 g = 9.80665 m/s^2 (--unit spool=g)",
    ]
    page, told = tmp_path / "look.html", tmp_path / "look.json"
    assert main(["import", str(path), "--look", *options, "--json", str(told), "--report", str(page)]) == 0
    shown = capsys.readouterr().out
    found = json.loads(told.read_text("utf-8"))
    assert found["columns"][1] == {
        "role": "body_m_s2", "file": "logger.csv", "column": "Gehäuse [g]", "number": 1, "unit": "g",
        "factor": GRAVITY, "option": None,
    }  # fmt: skip
    assert main(["import", str(path), "--out", str(tmp_path / "bag"), *options]) == 0
    made = capsys.readouterr().out
    main(["check", str(tmp_path / "bag")])
    checked = capsys.readouterr().out
    html = page.read_text("utf-8").replace("&#39;", "'")
    for line in lines:
        assert line in shown
        assert line in made
        assert line in checked
        assert line in html
        assert line in found["notes"]


@pytest.mark.parametrize(("bag", "covered"), [("practice_01", False), ("practice_03", True)])
def test_the_noise_of_the_spool_is_not_known_where_friction_reaches_up(
    bag: str, covered: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both sensors of these records have 0.03 m/s^2; practice_03 has dry friction, practice_01 has none."""
    assert main(["check", str(BAG.with_name(bag)), "--json", str(tmp_path / "check.json")]) == 0
    channels = json.loads((tmp_path / "check.json").read_text("utf-8"))["channels"]
    shown = [channels[name]["noise_rms"] for name in ("body", "spool")]
    assert shown == [pytest.approx(0.03, rel=0.1), None if covered else pytest.approx(0.03, rel=0.1)]
    assert ("not measurable" in capsys.readouterr().out) is covered


def test_a_column_can_be_left_out(
    tmp_path: Path, practice: tuple[np.ndarray, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    path = table(tmp_path, "two.csv", "time [s],body [m/s2],spool [m/s2]", practice, 1.0)
    text = path.read_text("utf-8").replace("\n", ",1\n").replace("[m/s2],1\n", "[m/s2],body 2 [m/s2]\n", 1)
    path.write_text(text, "utf-8")
    assert main(["import", str(path), "--out", str(tmp_path / "bag")]) == 2
    assert "could be body_m_s2" in capsys.readouterr().err
    assert main(["import", str(path), "--exclude", "body 2", "--out", str(tmp_path / "bag")]) == 0
    assert main(["import", str(path), "--exclude", "body 7", "--out", str(tmp_path / "bag_2")]) == 2
    assert "--exclude" in capsys.readouterr().err


def plain(folder: Path) -> Path:
    time = np.arange(4000) / 2000.0
    body = 5.0 * np.sin(2.0 * np.pi * 20.0 * time)
    rows = np.column_stack([time, body, 0.8 * body + 0.1 * np.cos(300.0 * time)])
    file = folder / "plain.csv"
    np.savetxt(file, rows, delimiter=",", header="time [s],body [m/s^2],spool [m/s^2]", comments="")
    return file


@pytest.mark.parametrize("columns", ["0", "1", "19"])
def test_a_console_without_a_width_shows_the_table(
    columns: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    assert main(["import", str(plain(tmp_path)), "--look"]) == 0
    assert "2000 Hz" in capsys.readouterr().out


def test_a_pipe_is_refused_with_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert main(["import", str(pipe), "--look"]) == 2
    assert "a pipe, which can be read only once: write it to a file first" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        *(("--start", day, "outside 1970 to 2038") for day in ("1960-01-01", "2300-01-01")),
        *(("--start", day, ": write it like 2025-01-31T12:00:00") for day in ("yesterday", "2025-13-01", "")),
        ("--out", "", "name the bag to write"),
    ],
)
def test_a_start_that_no_stamp_can_hold_and_no_name_of_the_bag_are_refused(
    option: str, value: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--out", str(tmp_path / "bag"), option, value]
    assert main(["import", str(plain(tmp_path)), *words]) == 2
    line = capsys.readouterr().err
    assert option in line
    assert said in line


def test_a_bag_with_umlauts_is_whole_in_any_locale(tmp_path: Path) -> None:
    bag = tmp_path / "Prüfstand"
    assert main(["import", str(plain(tmp_path)), "--out", str(bag)]) == 0
    told = subprocess.run(
        [sys.executable, "-c", "import sys; from spool_tools.cli import main; sys.exit(main(sys.argv[1:]))",
         "info", str(bag)],
        env={**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0"}, capture_output=True, check=False,
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    assert b"is missing" not in told.stderr + told.stdout

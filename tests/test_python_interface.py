"""``import spool``: its results are those of the commands, its errors are one type."""

from __future__ import annotations

import builtins
import inspect
import json
import re
import subprocess
import sys
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import spool
from spool.errors import in_python
from spool_design.requests import WhatIfRequest
from spool_report.requests import CompareRequest, FitRequest, GapRequest
from spool_tools.cli import main

ROOT = Path(__file__).resolve().parent.parent
BAG = ROOT / "bags" / "practice_03"
SOFT = partial(spool.valve, "4weh10_soft")
SLOW_LIBRARIES = ("matplotlib", "numba", "numpy", "pandas", "pyarrow", "pydantic", "rich", "scipy")


def arrays_of(record: spool.Record) -> dict[str, np.ndarray]:
    return {"time": record.time, "body": record.body, "spool": record.spool}


@pytest.fixture(scope="module")
def fitted() -> spool.Fit:
    return spool.fit(spool.read(BAG), spool.valve("4weh10_soft"), model="coulomb")


def test_importing_it_loads_no_library_that_takes_long() -> None:
    code = f"import sys, spool; print(sorted(set(sys.modules) & set({SLOW_LIBRARIES!r})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_completion_offers_the_interface_alone() -> None:
    assert dir(spool) == sorted([*spool.__all__, "__version__"])
    assert all(hasattr(spool, name) for name in dir(spool))


def test_a_record_shows_what_it_is(tmp_path: Path) -> None:
    record = spool.read(BAG)
    for said in (repr(record), record._repr_html_()):
        for part in ("practice_03", "40 s", "2000 Hz", "body, spool", "not described"):
            assert part in said
    gone = spool.Record(tmp_path / "<b>.csv")
    assert "cannot be read" in repr(gone)


def test_dates_without_a_zone_are_of_the_one_that_is_stated() -> None:
    record = spool.read(BAG)
    stamps = np.datetime64("2026-05-04T09:51:40", "ns") + (record.time[:4000] * 1e9).astype("timedelta64[ns]")
    table = pd.DataFrame({"body_m_s2": record.body[:4000], "spool_m_s2": record.spool[:4000]}, index=stamps)
    begins = [spool.read(table, zone=zone)._recording.stretches[0].start for zone in ("", "Europe/Berlin")]
    assert begins[0] - begins[1] == 2 * 3600 * 10**9
    with pytest.raises(spool.InputError, match="no dates without a zone"):
        spool.read(table.tz_localize("Europe/Berlin"), zone="Europe/Berlin")


def test_a_fit_has_the_numbers_of_the_command(fitted: spool.Fit, tmp_path: Path) -> None:
    written = tmp_path / "fit.json"
    arguments = ["fit", str(BAG), "--valve", "4weh10_soft", "--model", "coulomb", "--json", str(written)]
    assert main(arguments) == 0
    assert fitted.to_dict() == json.loads(written.read_text("utf-8"))
    assert fitted.parameters["coulomb_force"]["unit"] == "N"
    assert "coulomb force" in fitted.summary()
    assert "coulomb force" in fitted._repr_html_()


def test_a_notebook_gets_a_result_once_and_as_its_own_text(
    fitted: spool.Fit, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shell = type("ZMQInteractiveShell", (), {})()
    monkeypatch.setattr(builtins, "get_ipython", lambda: shell, raising=False)  # how rich knows a notebook
    monkeypatch.setenv("FORCE_COLOR", "1")  # as its kernel does
    assert "coulomb force" in fitted.summary()
    assert "\x1b" not in fitted.summary()
    assert "coulomb force" in fitted._repr_html_()
    assert capsys.readouterr() == ("", "")


def test_a_result_is_saved_once_and_by_its_ending(fitted: spool.Fit, tmp_path: Path) -> None:
    fitted.save(tmp_path / "fit.json")
    assert json.loads((tmp_path / "fit.json").read_text("utf-8")) == fitted.to_dict()
    with pytest.raises(spool.InputError, match="already exists"):
        fitted.save(tmp_path / "fit.json")
    fitted.save(tmp_path / "fit.json", replace=True)
    with pytest.raises(spool.InputError, match=r"\.json or \.html"):
        fitted.save(tmp_path / "fit.txt")


def test_pictures_leave_the_backend_of_the_reader_alone(fitted: spool.Fit) -> None:
    import matplotlib  # noqa: PLC0415
    from matplotlib import pyplot  # noqa: PLC0415

    before, opened = matplotlib.get_backend(), pyplot.get_fignums()
    assert fitted.plot()._repr_png_().startswith(b"\x89PNG")
    assert spool.read(BAG).plot()._repr_png_().startswith(b"\x89PNG")
    assert (matplotlib.get_backend(), pyplot.get_fignums()) == (before, opened)


def test_a_replay_and_a_check_have_the_numbers_of_the_commands(tmp_path: Path) -> None:
    for name, result, options in (
        ("replay", spool.replay(BAG, "4weh10_soft"), ["--valve", "4weh10_soft"]),
        ("check", spool.read(BAG).check(), []),
    ):
        written = tmp_path / f"{name}.json"
        main([name, str(BAG), *options, "--json", str(written)])
        assert result.to_dict() == json.loads(written.read_text("utf-8"))


def test_a_simulated_record_is_one_like_any_other() -> None:
    valve = spool.valve(
        id="mine", moving_mass="180g", spring_rate="0.816N/mm", land_diameter="20mm", land_length="32mm",
        radial_clearance="15um", oil="HL68", oil_temperature="45",
    )  # fmt: skip
    record = spool.simulate(valve, "fluid", "multisine", 5.0, noise=0.0)
    assert record.valve == valve
    assert (record.duration, record.sample_rate) == (5.0, 2000.0)
    assert record.time.shape == record.body.shape == record.spool.shape == (10_000,)


def test_units_that_a_file_does_not_name_are_given_by_argument(tmp_path: Path) -> None:
    path = tmp_path / "Messung für Größe.csv"
    time = np.arange(4000) / 1000.0
    rows = [f"{t:.4f};{np.sin(40 * t):.5f};{np.sin(40 * t + 0.3):.5f}" for t in time]
    path.write_bytes("\r\n".join(["t;body;spool", *rows, ""]).replace(".", ",").encode("cp1252"))
    with pytest.raises(spool.InputError, match="unit"):
        spool.read(path)
    record = spool.read(path, unit="g")
    assert np.ptp(record.body) == pytest.approx(2 * 9.80665, rel=1e-3)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: spool.read("no_such_record"),
        lambda: spool.valve("no_such_valve"),
        spool.valve,
        lambda: spool.fit(BAG, "4weh10_soft", model="no_such_model"),
        lambda: spool.simulate(seconds=-1.0),
        lambda: spool.fleet("no_such_store").query("SELECT 1"),
        lambda: spool.fit(SOFT(), BAG),
        lambda: spool.fit(BAG, spool.read(BAG)),
        lambda: spool.fit(BAG, SOFT(), sensor_gian=True),
        lambda: spool.fit(BAG, SOFT(), model=0.3),
        lambda: spool.fit([], SOFT()),
        lambda: spool.gap(BAG, SOFT(), thorogh=True),
        lambda: spool.gap(BAG, SOFT(), stop="5"),
        lambda: spool.gap(BAG, SOFT(), kind="acceleration"),
        lambda: spool.gap(BAG, SOFT(), gain_tolerance=5.0),
        lambda: spool.replay(BAG, SOFT(), methd="equation"),
        lambda: spool.simulate(SOFT(), seconds="3"),
        lambda: spool.simulate(SOFT(), oil_temperature=318.15, seconds=1.0),
        lambda: spool.valve(id="mine", moving_mass=0.2, spring_stiffness=1600.0, oil="HL68"),
        lambda: spool.valve(spool_mass="172", spring_mass="24g"),
        lambda: spool.read(BAG, start=3.0, stop=2.0),
        lambda: spool.read(BAG, name="valve_7"),
        lambda: spool.read(BAG, since="soon"),
        lambda: spool.read(np.zeros(10)),
        lambda: spool.read(np.zeros((3, 500))),
        lambda: spool.read(np.zeros((500, 2))),
        lambda: spool.read({"time": [0.0, 1.0], "body": [0.0], "spool": [0.0, 1.0]}),
        lambda: spool.read({"time": [0.0, 1.0], "body": [[0.0, 1.0], [2.0, 3.0]], "spool": [0.0, 1.0]}),
        lambda: spool.read(arrays_of(spool.read(BAG))),
        lambda: spool.read([{"body": [1.0]}]),
        lambda: spool.read(7),
    ],
)
def test_wrong_input_is_one_type_of_error_with_one_line(wrong) -> None:
    with pytest.raises(spool.InputError) as caught:
        wrong()
    assert "\n" not in str(caught.value)
    assert "--" not in str(caught.value)


@pytest.mark.parametrize("request_type", [FitRequest, CompareRequest, GapRequest, WhatIfRequest])
def test_a_call_takes_the_options_of_its_command_with_their_defaults(request_type: type) -> None:
    name = {"WhatIf": "what_if"}.get(kind := request_type.__name__.removesuffix("Request"), kind.lower())
    taken = inspect.signature(getattr(spool, name)).parameters
    for option in fields(request_type):
        default = taken[option.name].default
        if isinstance(option.default, bool | float | str):
            assert default == option.default


def test_every_option_that_a_message_names_becomes_an_argument() -> None:
    """In the sources of all messages; what follows an option there may be filled in."""
    sources = "".join(
        path.read_text("utf-8") for path in (ROOT / "ros2_ws").glob("*/spool_*/spool_*/**/*.py")
    )
    found = {line.strip() for line in sources.splitlines() if re.search(r"--[a-z]", line)}
    assert len(found) > 300
    assert [line for line in found if re.search(r"(?<!-)--[a-z]", in_python(line))] == []


@pytest.mark.parametrize(
    ("command", "python"),
    [
        ("type --unit body=g,spool=g, or", "pass unit={'body': 'g', 'spool': 'g'}, or"),
        ("e.g. --rate 2000 for 2000 Hz", "e.g. rate=2000 for 2000 Hz"),
        ("e.g. --columns 'body=a [g],spool=b [g]'.", "e.g. columns={'body': 'a [g]', 'spool': 'b [g]'}."),
        ("choose one with --valve", "choose one with valve="),
        ("give --thorough", "pass thorough=True"),
        ("valve new: give --id, e.g. --id press", "spool.valve: pass id=, e.g. id=press"),
    ],
)  # fmt: skip
def test_a_message_advises_in_the_words_of_python(command: str, python: str) -> None:
    assert in_python(command) == python


@pytest.mark.parametrize("shape", ["mapping", "lists", "frame", "dates", "array", "structured"])
def test_arrays_and_tables_are_read_like_a_file_of_them(shape: str) -> None:
    record = spool.read(BAG, stop=4.0)
    named = arrays_of(record)
    if shape == "mapping":
        found = spool.read(named, unit="m/s^2")
    elif shape == "lists":
        found = spool.read({key: list(row) for key, row in named.items()}, unit="m/s^2")
    elif shape == "frame":
        found = spool.read(record.to_frame())
    elif shape == "dates":
        frame = pd.DataFrame(named).set_index(pd.Timestamp("2026-05-04") + pd.to_timedelta(record.time, "s"))
        found = spool.read(frame[["body", "spool"]].rename(columns="{} [m/s^2]".format))
    elif shape == "array":
        found = spool.read(
            np.column_stack([record.body, record.spool]), unit="m/s^2", rate=record.sample_rate
        )
    else:
        found = spool.read(np.rec.fromarrays(list(named.values()), names=list(named)), unit="m/s^2")
    assert found.sample_rate == pytest.approx(record.sample_rate, rel=1e-9)
    np.testing.assert_allclose(found.body, record.body, atol=1e-5)
    np.testing.assert_allclose(found.spool, record.spool, atol=1e-5)


def test_samples_in_g_are_converted_and_other_columns_left_out() -> None:
    record = spool.read(BAG, stop=4.0)
    named = arrays_of(record) | {
        "body": record.body / 9.80665,
        "spool": record.spool / 9.80665,
        "noise": 0 * record.body,
    }
    found = spool.read(named, unit="g", exclude="noise")
    np.testing.assert_allclose(found.spool, record.spool, rtol=1e-4, atol=1e-5)


def test_a_part_of_a_record_is_what_analyses_use() -> None:
    whole, part = spool.read(BAG), spool.read(BAG, start=2.0, stop=8.0)
    assert part.duration == pytest.approx(6.0, abs=0.01)
    given = spool.fit(whole, SOFT(), model="fluid", start=2.0, stop=8.0)
    assert spool.fit(part, SOFT(), model="fluid").parameters == given.parameters
    with pytest.raises(spool.InputError, match="read in different parts"):
        spool.fit([whole, part], SOFT(), model="fluid")


def test_the_version_and_the_hints_are_there_for_users_and_their_tools() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+", spool.__version__)
    assert Path(spool.__file__).with_name("py.typed").is_file()
    for function in (spool.gap, spool.replay, spool.valve, spool.read):
        kinds = {one.kind for one in inspect.signature(function).parameters.values()}
        assert not kinds & {inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL}


def test_numbers_of_a_data_sheet_are_text_with_units_or_numbers_in_si() -> None:
    text = spool.valve(id="mine", spool_mass="172 g", spring_mass="24g", spring_rate="0.816N/mm")
    assert text == spool.valve(id="mine", spool_mass=0.172, spring_mass=0.024, spring_rate=816)
    with pytest.raises(spool.InputError, match=r"no argument 'spring_masss'; did you mean spring_mass\?"):
        spool.valve(id="mine", spool_mass="172 g", spring_masss="24g", spring_rate="0.816N/mm")


@pytest.mark.slow
def test_a_gap_has_the_numbers_of_the_command(tmp_path: Path) -> None:
    record = spool.simulate("4weh10_soft", "coulomb", "multisine", 20.0)
    found = spool.gap(record)
    assert main(["gap", str(record.path), "--json", str(tmp_path / "gap.json")]) == 0
    assert found.to_dict() == json.loads((tmp_path / "gap.json").read_text("utf-8"))
    assert found.verdict == "coulomb_friction"
    assert found.summary().splitlines()[0].startswith("coulomb_friction")
    found.save(tmp_path / "gap.html")
    found.save_model(tmp_path / "found.yaml")
    assert spool.simulate("4weh10_soft", tmp_path / "found.yaml", seconds=2.0).duration == 2.0

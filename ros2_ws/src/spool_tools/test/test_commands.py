from __future__ import annotations

import itertools
import json
import math
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_bag.format.definitions import typestore
from spool_bag.reading.reader import BagReader
from spool_msgs.msg import ModelEstimate, ValveHealth
from spool_sim.excitation.kinds import load_excitation
from spool_sim.excitation.presets import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve.description import find_valve, shipped_valves
from spool_stream.block import Block
from spool_stream.errors import InputError
from spool_tools.cli import main
from spool_tools.console.outputs import write_json
from spool_tools.demo.display import Display
from spool_tools.demo.processes import Nodes
from spool_tools.demo.scenario import DRIFT, PASSAGE, VALVES
from spool_tools.input.bag_valve import VALVE_DESCRIPTION, encode_valve, recorded_valve
from spool_tools.input.record_names import parse_columns
from spool_tools.operations.simulation import SIMULATION_START, simulate

SETTINGS: dict[str, Any] = {
    "sample_rate": 2000.0,
    "block_rate": 50.0,
    "coulomb_force": 0.3,
    "noise": 0.05,
    "seed": 4,
    "name": "left",
}


# JSON.


def test_what_is_not_finite_becomes_null_at_any_depth(tmp_path: Path) -> None:
    value = {
        "nan": math.nan,
        "list": [1.5, math.inf, -math.inf, (math.nan, 2)],
        "deep": {
            "numpy": np.float64("nan"),
            "number": np.float64(0.1),
            "none": None,
            "text": "nan",
            "true": True,
        },
    }
    path = tmp_path / "value.json"
    write_json(path, value)
    text = path.read_text(encoding="utf-8")
    assert text.endswith("\n")
    assert json.loads(text, parse_constant=pytest.fail) == {
        "nan": None,
        "list": [1.5, None, None, [None, 2]],
        "deep": {"numpy": None, "number": 0.1, "none": None, "text": "nan", "true": True},
    }


@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_keep_every_digit(value: float, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("number") / "number.json"
    write_json(path, [value])
    assert json.loads(path.read_text()) == [value]


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    path = tmp_path / "missing" / "result.json"
    with pytest.raises(InputError, match=r"result\.json: there is no folder .*missing: make it first"):
        write_json(path, {})


# Simulated bags and descriptions.


@pytest.mark.parametrize("name", sorted(shipped_valves()))
def test_a_description_goes_through_a_bag_unchanged(name: str, tmp_path: Path) -> None:
    simulate(tmp_path / "bag", name, "coulomb", "steady", 0.1, **SETTINGS)
    reader = BagReader(tmp_path / "bag")
    assert recorded_valve(reader, "left") == find_valve(name)
    assert recorded_valve(reader, "right") is None


def test_a_description_without_oil_and_its_stamp() -> None:
    valve = find_valve("4weh10_soft").model_copy(update={"oil": None, "moving_mass": 0.1234567890123456})
    data = encode_valve(valve, 1_700_000_000_123_456_789)
    message: Any = typestore().deserialize_cdr(data, VALVE_DESCRIPTION)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert message.header.frame_id == valve.id
    assert message.oil == ""
    assert message.moving_mass == valve.moving_mass


def test_a_simulated_bag_holds_the_simulators_blocks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulate(tmp_path / "bag", "4weh10_soft", "coulomb", "sweep", 1.0, **SETTINGS)
    assert "50 blocks of 4weh10_soft in /left, 1 s at 2000 Hz" in capsys.readouterr().out
    sensor = Sensor(noise=0.05)
    expected = Simulator(
        find_valve("4weh10_soft"), PRESETS["sweep"], coulomb_force=0.3, seed=4, body_sensor=sensor,
        spool_sensor=sensor, start_stamp=SIMULATION_START,
    ).records(1.0)  # fmt: skip
    reader = BagReader(tmp_path / "bag")
    assert set(reader.topics) == {"/left/valve", "/left/acceleration"}
    for one, other in zip(reader.blocks("left"), expected, strict=True):
        assert (one.stamp, one.sequence) == (other.stamp, other.sequence)
        np.testing.assert_array_equal(one.body, other.body)
        np.testing.assert_array_equal(one.spool, other.spool)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"block_rate": 0.0}, "--block-rate"),
        ({"block_rate": math.nan}, "--block-rate"),
        ({"block_rate": 1e5}, "--block-rate"),
        ({"block_rate": 1e-320}, "--block-rate"),
        ({"sample_rate": math.nan}, "--sample-rate nan"),
        ({"sample_rate": 150.0}, "sample_rate: 150 Hz"),
        ({"name": "no good"}, "no good"),
    ],
)
def test_a_wrong_setting_is_refused_by_name_and_leaves_no_bag(
    changes: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=said):
        simulate(tmp_path / "bag", "4weh10_soft", "coulomb", "sweep", 1.0, **SETTINGS | changes)
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize("start", ["yesterday", "2025-13-01", ""])
def test_a_wrong_start_is_refused(start: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", "x.csv", "--out", str(tmp_path / "bag"), "--start", start]) == 2
    assert re.search(r"--start .*: write it like 2025-01-31T12:00:00", capsys.readouterr().err)


@pytest.mark.parametrize("columns", ["time_s", "time_s=", "=t", "time_s=t,,", ""])
def test_wrong_columns_are_refused(columns: str) -> None:
    with pytest.raises(InputError, match=r"--columns .*: write it like time_s=t"):
        parse_columns(columns)


@pytest.mark.parametrize(
    "words",
    [
        "simulate --noise -1 --out BAG",
        "simulate --noise nan --out BAG",
        "simulate --seed -1 --out BAG",
        "demo --seconds 39",
        "demo --seconds inf",
        "gap RECORD --gain-tolerance 0.5",
        "gap RECORD --delay-tolerance nan",
        "gap RECORD --kind moved",
        "replay RECORD --refits --refit-period 0",
    ],
)
def test_numbers_out_of_range_and_unknown_choices_are_refused_by_the_option_s_name(
    words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words.split()) == 2
    said = capsys.readouterr().err
    option = next(word for word in reversed(words.split()) if word.startswith("--") and word != "--out")
    assert f"'{option}'" in said
    assert said.count("\n") == 1


# The command line.


def test_wrong_usage_is_one_line_on_stderr_and_2(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["no_such_command"], ["info"], ["replay", "x", "--colour"], ["info", "no_such_bag"]):
        assert main(arguments) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith("spool: ")
        assert said.err.count("\n") == 1


# What the demonstration shows.


def test_what_is_not_known_yet_is_shown_as_words() -> None:
    display = Display(30.0, ("a", "b"))
    display.health["a"] = ValveHealth(summary="waiting for estimates")
    display.health["a"].dominant_frequency.value = math.nan
    display.estimates["a"] = ModelEstimate()
    assert "nan" not in display._line("a")
    assert "learning" in display._line("a")
    assert display._line("b") == "waiting"


# The demonstration's scenario and its processes.


@pytest.mark.parametrize("seconds", [30.0, 60.0, 3600.0])
def test_each_valve_of_the_demonstration_passes_its_resonance_and_then_drifts(
    seconds: float, tmp_path: Path
) -> None:
    assert 0.0 < PASSAGE[0] < PASSAGE[1] < PASSAGE[2] < DRIFT[0] < sum(DRIFT) < 1.0
    for one in VALVES:
        valve = find_valve(one.valve_file)
        excitation = load_excitation(str(one.write_excitation(tmp_path, seconds)))
        natural = valve.natural_frequency
        assert abs(one.resonant_speed / 60.0 / natural - 1.0) < 0.05
        assert abs(one.steady_speed / 60.0 / natural - 1.0) > 0.3
        simulator = Simulator(valve, excitation, coulomb_force=one.coulomb_force)
        before = getattr(simulator.truth, one.drift)
        simulator.set_drift(one.drift, one.drift_target)
        simulator.next_block()
        assert getattr(simulator.truth, one.drift) == one.drift_target != before


def test_leaving_ends_every_process_also_one_that_will_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    marker = tmp_path / "share/ament_index/resource_index/packages/some_package"
    marker.parent.mkdir(parents=True)
    marker.touch()
    node = tmp_path / "lib/some_package/node"
    node.parent.mkdir(parents=True)
    node.write_text(
        f"#!{sys.executable}\n"
        "import signal, sys, time\n"
        "if sys.argv[1] == 'deaf': signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "if sys.argv[1] == 'short': sys.exit(3)\n"
        "open(sys.argv[2], 'w').close()\n"
        "signal.pause() if sys.argv[1] != 'deaf' else [signal.pause() for _ in range(9)]\n"
    )
    node.chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    with Nodes(tmp_path / "nodes.log") as nodes:
        for name in ("good", "deaf", "short"):
            nodes.start(name, "some_package", "node", [name, str(tmp_path / f"{name}.up")])
        processes = dict(nodes.running)
        assert processes["short"].wait(timeout=20) == 3
        while not ((tmp_path / "good.up").exists() and (tmp_path / "deaf.up").exists()):
            assert processes["good"].poll() is None
            assert processes["deaf"].poll() is None
        assert nodes.dead() == ["short"]
        nodes.stop("deaf", patience=0.2)
        assert processes["deaf"].returncode == -9
        assert set(nodes.running) == {"good", "short"}
    assert processes["good"].returncode in (-2, 1)
    assert nodes.running == {}
    assert "KeyboardInterrupt" in (tmp_path / "nodes.log").read_text()
    assert isinstance(processes["good"], subprocess.Popen)


def test_an_interrupted_simulation_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Simulator.records

    def interrupted(self: Simulator, seconds: float) -> Iterator[Block]:
        yield from itertools.islice(whole(self, seconds), 20)
        raise KeyboardInterrupt

    monkeypatch.setattr(Simulator, "records", interrupted)
    assert main(["simulate", "--seconds", "2", "--out", str(tmp_path / "bag")]) == 130
    assert list(tmp_path.iterdir()) == []


def test_recover_lists_what_was_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "bag"
    assert main(["simulate", "--seconds", "40", "--noise", "1", "--out", str(bag)]) == 0
    file = next(bag.glob("*.mcap"))
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content[:-4000])
    capsys.readouterr()
    assert main(["info", str(bag)]) == 1
    assert "1 damaged place" in capsys.readouterr().out
    assert main(["recover", str(bag), "--out", str(tmp_path / "saved")]) == 1
    told = capsys.readouterr().out
    assert "messages saved" in told
    assert "blocks are missing by their sequence numbers" in told
    assert "was not finished" in told
    assert main(["info", str(tmp_path / "saved")]) == 1  # the lost blocks stay lost

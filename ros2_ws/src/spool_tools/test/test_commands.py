"""Commands on bags, and what they refuse."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from spool_bag.importing.choices import columns_of
from spool_bag.metadata import custom_data, typestore
from spool_bag.reader import BagReader
from spool_core.block import Block
from spool_core.errors import InputError
from spool_monitor.detectors import MonitorSettings
from spool_monitor.journal import Journal, JournalEntry
from spool_monitor.monitor import Monitor
from spool_monitor.monitor_node import to_health_message
from spool_monitor.state_database import FILE
from spool_monitor.state_file import valve_folder
from spool_msgs.msg import AlarmList, ValveHealth
from spool_report.records.record_sources import VALVE_DESCRIPTION, encode_valve, recorded_valve
from spool_report.records.simulation import SIMULATION_START, simulate
from spool_report.requests import SimulationSettings
from spool_sim.excitation import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve, shipped_valves
from spool_tools.cli import main
from spool_tools.operations import service_client

SETTINGS: dict[str, Any] = {
    "sample_rate": 2000.0,
    "block_rate": 50.0,
    "coulomb_force": 0.3,
    "noise": 0.05,
    "seed": 4,
    "name": "left",
}


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        (["gpa"], "No such command 'gpa'. Did you mean 'gap'? See: ./spool --help\n"),
        (["gap", "--no-such"], "See: ./spool gap --help\n"),
        (["import", "{here}", "--look"], "name a rosbag2 directory, or a file in it\n"),
        (["export", "{here}", "--out", "{here}/a.csv"], "a.csv: already exists: name another file, or"),
    ],
)
def test_what_a_refusal_names_exists(
    typed: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.csv").touch()
    assert main([word.format(here=tmp_path) for word in typed]) == 2
    assert said in capsys.readouterr().err


# Simulated bags and descriptions.


@pytest.mark.parametrize("name", sorted(shipped_valves()))
def test_a_description_goes_through_a_bag_unchanged(name: str, tmp_path: Path) -> None:
    simulate(tmp_path / "bag", SimulationSettings(name, "coulomb", "steady", 0.1, **SETTINGS))
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
    simulate(tmp_path / "bag", SimulationSettings("4weh10_soft", "coulomb", "sweep", 1.0, **SETTINGS))
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
        ({"filter": "linear,6"}, "filter: 'linear,6': use instants, mean"),
    ],
)
def test_a_wrong_setting_is_refused_by_name_and_leaves_no_bag(
    changes: dict[str, Any], said: str, tmp_path: Path
) -> None:
    settings = SimulationSettings("4weh10_soft", "coulomb", "sweep", 1.0, **SETTINGS | changes)
    with pytest.raises(InputError, match=said):
        simulate(tmp_path / "bag", settings)
    assert not (tmp_path / "bag").exists()


def test_a_simulated_bag_states_how_each_channel_was_sampled(tmp_path: Path) -> None:
    sensors, bag = tmp_path / "sensors.yaml", tmp_path / "bag"
    sensors.write_text("spool: {filter: 'causal,4,0.36'}\n", "utf-8")
    simulate(bag, SimulationSettings("4weh10_soft", "coulomb", "sweep", 1.0, **SETTINGS, sensors=sensors))
    assert custom_data(bag) == {
        "left/body/filter": "none: samples at instants",
        "left/spool/filter": "Butterworth low-pass, order 4, corner 720 Hz",
    }


@pytest.mark.parametrize("columns", ["time_s", "time_s=", "=t", "time_s=t,,", "", "time_s=,body=b"])
def test_wrong_columns_are_refused(columns: str) -> None:
    with pytest.raises(InputError, match=r"--columns .*: write it like time_s=t"):
        columns_of(columns)


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
    assert option in said
    assert said.count("\n") == 1


# The command line.


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
    assert "missing by sequence numbers: " in told
    assert "was not finished" in told
    assert main(["info", str(tmp_path / "saved")]) == 1  # the lost blocks stay lost


def test_the_history_of_alarms_is_read_where_ros_cannot_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "none")
    path = valve_folder(tmp_path, "valve_1") / FILE
    path.parent.mkdir(parents=True)
    journal = Journal(path)
    journal.write([JournalEntry(10**18, "raise", "resonance", 100, "S", "alarm", "unacknowledged", 1)])
    journal.close()
    for command in ("history", "statistics"):
        assert main(["alarm", command, "--state-folder", str(tmp_path)]) in (0, 1)
        assert "resonance" in capsys.readouterr().out
    assert main(["alarm", "list", "valve_1"]) == 2
    assert "ROS_DOMAIN_ID=none is no domain" in capsys.readouterr().err


def test_the_alarm_list_begins_with_the_strokes_of_a_valve_that_is_switched(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monitor = Monitor(MonitorSettings(natural_frequency=15.15))

    def shown() -> str:
        said = {AlarmList: AlarmList(), ValveHealth: to_health_message(monitor.health, "valve_1")}
        node = SimpleNamespace(create_subscription=lambda kind, _name, take, _qos: take(said[kind]))
        monkeypatch.setattr(service_client, "client_node", lambda *_: nullcontext(node))
        assert service_client.show_alarms("valve_1", every=False) == 0
        return capsys.readouterr().out

    assert shown() == "valve_1: no alarms\n"
    monitor.strokes.count = 412
    assert shown().startswith("valve_1: switched 412 times today, judged ")
    assert shown().endswith(" of the time\nvalve_1: no alarms\n")

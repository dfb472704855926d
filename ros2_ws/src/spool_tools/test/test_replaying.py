from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter
from spool_core.errors import InputError
from spool_report.outputs import write_json
from spool_report.recording_report import replay_page
from spool_report.records.simulation import simulate
from spool_report.requests import ReplayRequest, SimulationSettings
from spool_report.runs.record_replay import SHIPPED, ReplaySettings, replay_bag, replay_valve, settings_from
from spool_sim.valve import find_valve
from spool_tools.cli import main

if TYPE_CHECKING:
    from .conftest import MakeBag, Recorded

PRACTICE = Path(__file__).resolve().parents[4] / "bags" / "practice_01"
#: ns, in the middle of that record.
MIDDLE = 1_735_689_620_000_000_000

SOFT, STIFF = (find_valve(name) for name in ("4weh10_soft", "4weh10_stiff"))


def stiffness(result: dict[str, Any], valve: str) -> float:
    return float(result["valves"][valve]["estimate"]["parameters"]["spring_stiffness"]["value"])


def test_the_result_has_the_keys_that_scripts_rely_on(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded]
) -> None:
    bag = make_bag(tmp_path / "bag", {"valve_1": recorded(seconds=6.0, lost=(50, 51))})
    file = tmp_path / "result.json"
    write_json(file, replay_bag(ReplayRequest(record=bag)))
    result = json.loads(file.read_text("utf-8"))
    assert set(result) == {"bag", "duration_s", "valves", "warnings"}
    assert result["bag"] == str(bag)
    assert result["duration_s"] == pytest.approx(6.0)
    valve = result["valves"]["valve_1"]
    assert set(valve) >= {"blocks", "lost_blocks", "samples", "estimate", "events"}
    assert valve["valve"]["id"] == "4weh10_soft"
    assert valve["valve"]["source"] == "recorded"
    assert valve["warnings"] == []
    assert valve["health"]["baseline"] == "learning"
    assert valve["health"]["judgements"]["friction_drift"] == "learning"
    assert (valve["blocks"], valve["lost_blocks"], valve["samples"]) == (298, 2, 298 * 40)
    estimate = valve["estimate"]
    # "state" is an extra beyond the agreed columns.
    assert set(estimate) - {"state"} == {
        "model",
        "parameters",
        "natural_frequency_Hz",
        "damping_ratio",
        "nrmse",
    }
    assert estimate["model"] == "coulomb"
    parameters = estimate["parameters"]
    assert {name: parameter["unit"] for name, parameter in parameters.items()} == {
        "spring_stiffness": "N/m",
        "viscous_coefficient": "N s/m",
        "coulomb_force": "N",
    }
    for parameter in parameters.values():
        assert set(parameter) == {"value", "std", "unit"}
        assert parameter["std"] > 0.0
    assert parameters["coulomb_force"]["value"] == pytest.approx(0.3, rel=0.1)
    assert estimate["natural_frequency_Hz"] == pytest.approx(SOFT.natural_frequency, rel=0.02)
    assert 0.0 < estimate["nrmse"] < 0.1
    event = valve["events"][0]
    assert set(event) == {
        "t_s", "kind", "state", "severity", "cause", "code", "source", "parameter", "value", "unit", "low",
        "high", "baseline", "change", "limit", "began_s", "causes", "probabilities", "false_alarm_interval",
        "urgency", "time_to_limit", "advice", "subject", "note", "evidence", "message", "details",
    }  # fmt: skip
    # As of the event: the first block after the gap shows both blocks of it as lost.
    assert event["message"] == "Lost blocks: 2"
    assert (event["value"], event["limit"], event["urgency"]) == (2.0, 0.0, "soon")
    assert (event["kind"], event["state"], event["severity"]) == ("data_fault", "raised", "warning")
    assert event["t_s"] == pytest.approx(52 * 0.02)


def test_the_valves_description_is_taken_from_the_bag(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded]
) -> None:
    """The moving mass of the description sets the scale, so a wrong one shows."""
    bag = make_bag(tmp_path / "bag", {"a": recorded(), "b": recorded("4weh10_stiff")})
    result = replay_bag(ReplayRequest(record=bag))
    assert stiffness(result, "a") == pytest.approx(SOFT.spring_stiffness, rel=0.02)
    assert stiffness(result, "b") == pytest.approx(STIFF.spring_stiffness, rel=0.02)


def heavier(folder: Path, name: str, factor: float) -> str:
    """Write a description whose mass is ``factor`` times the soft valve's; return its path."""
    path = folder / f"{name}.yaml"
    described = SOFT.model_dump(exclude_defaults=True) | {
        "id": name,
        "moving_mass": factor * SOFT.moving_mass,
    }
    path.write_text("".join(f"{key}: {value}\n" for key, value in described.items()), "utf-8")
    return str(path)


@pytest.mark.parametrize(("factors", "expected"), [((2.0,), (2.0, 2.0)), ((2.0, 3.0), (2.0, 3.0))])
def test_valves_are_given_once_for_all_or_once_for_each_in_order_of_name(
    tmp_path: Path,
    make_bag: MakeBag,
    recorded: type[Recorded],
    factors: tuple[float, ...],
    expected: tuple[float, float],
) -> None:
    bag = make_bag(tmp_path / "bag", {"b": recorded(), "a": recorded()})
    files = [heavier(tmp_path, f"file_{factor:g}", factor) for factor in factors]
    result = replay_bag(ReplayRequest(record=bag, valve=files))
    assert list(result["valves"]) == ["a", "b"]
    for name, factor in zip("ab", expected, strict=True):
        assert stiffness(result, name) == pytest.approx(factor * SOFT.spring_stiffness, rel=0.02)


def test_valves_are_given_by_their_namespaces(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded]
) -> None:
    bag = make_bag(tmp_path / "bag", {"a": recorded(), "b": recorded()})
    result = replay_bag(ReplayRequest(record=bag, valve=[f"b={heavier(tmp_path, 'heavy', 2.0)}"]))
    assert stiffness(result, "a") == pytest.approx(SOFT.spring_stiffness, rel=0.02)
    assert stiffness(result, "b") == pytest.approx(2.0 * SOFT.spring_stiffness, rel=0.02)
    sources = {name: valve["valve"]["source"] for name, valve in result["valves"].items()}
    assert sources == {"a": "recorded", "b": "given"}
    for given, said in (
        (["c=4weh10_soft"], "has no valve c: it has a, b"),
        (["a=4weh10_soft", "a=4weh10_stiff"], "given twice"),
        (["a=4weh10_soft", "4weh10_stiff"], "write NAME=4weh10_stiff"),
        (["a=4weh10_sof"], "did you mean 4weh10_soft"),
        (["4weh10_soft"] * 3, "given 3 times, the bag holds a, b: give it once for all, or NAME"),
        (["no_such_valve"], "no_such_valve"),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            replay_bag(ReplayRequest(record=bag, valve=given))


def test_a_valve_that_nobody_described_is_assumed_aloud(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded], capsys: pytest.CaptureFixture[str]
) -> None:
    described = make_bag(tmp_path / "described", {"a": recorded()})
    bag, file = make_bag(tmp_path / "bag", {"a": recorded(described=False)}), tmp_path / "result.json"
    assert main(["replay", str(bag), "--json", str(file)]) == 0
    shown = capsys.readouterr()
    assert "warning: a: the record does not describe its valve" in shown.err
    assert "ASSUMED to be 4weh10_soft" in shown.out
    estimate = json.loads(file.read_text("utf-8"))["valves"]["a"]["estimate"]
    assert estimate == replay_bag(ReplayRequest(record=described))["valves"]["a"]["estimate"]


def test_the_wrong_valve_file_is_told_by_replay(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded], capsys: pytest.CaptureFixture[str]
) -> None:
    bag = make_bag(tmp_path / "bag", {"a": recorded(seconds=10.0)})
    assert main(["replay", str(bag), "--valve", "4weh10_stiff"]) == 0
    assert "says 28.7 Hz, the record shows 15.2 Hz" in capsys.readouterr().err
    assert main(["replay", str(bag), "--valve", "4weh10_soft"]) == 0
    assert capsys.readouterr().err == ""


def test_a_csv_file_replays_as_the_bag_that_it_becomes(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded]
) -> None:
    bag = make_bag(tmp_path / "bag", {"valve_1": recorded(seconds=6.0)})
    table = tmp_path / "record.csv"
    assert main(["export", str(bag), "--out", str(table)]) == 0
    assert main(["import", str(table), "--out", str(tmp_path / "again")]) == 0
    results = [
        replay_bag(ReplayRequest(record=path, valve=["4weh10_soft"]))["valves"]
        for path in (table, tmp_path / "again")
    ]
    assert results[0] == results[1]
    assert main(["info", str(table)]) == 0


def test_times_of_all_valves_count_from_the_bags_first_stamp(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded]
) -> None:
    bag = make_bag(
        tmp_path / "bag", {"a": recorded(begin=3.0, seconds=1.0, lost=(10,)), "b": recorded(seconds=2.0)}
    )
    result = replay_bag(ReplayRequest(record=bag))
    assert result["duration_s"] == pytest.approx(4.0)
    assert result["valves"]["a"]["events"][0]["t_s"] == pytest.approx(3.0 + 11 * 0.02)


def test_too_little_data_give_unknowns_and_no_numbers(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded], capsys: pytest.CaptureFixture[str]
) -> None:
    bag = make_bag(tmp_path / "bag", {"a": recorded(seconds=0.4)})
    file = tmp_path / "result.json"
    assert main(["replay", str(bag), "--json", str(file)]) == 0
    assert "unknown" in capsys.readouterr().out
    estimate = json.loads(file.read_text("utf-8"))["valves"]["a"]["estimate"]
    assert estimate["natural_frequency_Hz"] is None
    assert estimate["nrmse"] is None
    assert all(one["value"] is None for one in estimate["parameters"].values())


def test_a_bag_without_accelerations_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/valve_1/health", "spool_msgs/msg/ValveHealth")
    with pytest.raises(InputError, match=r"bag: no acceleration topic in it"):
        replay_bag(ReplayRequest(record=tmp_path / "bag"))


#: Limits beyond what the spool of `practice_03` does: it amplifies 2.6 times at its resonance.
DEAF = {"amplification_on": 9.0, "amplification_off": 8.0}


def limits(folder: Path, section: str = "/**/monitor", **values: float) -> Path:
    """Write a parameter file; return its path."""
    lines = "".join(f"    {name}: {value}\n" for name, value in values.items())
    file = folder / "limits.yaml"
    file.write_text(f"{section}:\n  ros__parameters:\n{lines}", "utf-8")
    return file


def test_a_replay_judges_by_the_limits_of_the_plant_and_states_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = str(PRACTICE.parent / "practice_03")
    file = limits(tmp_path, **DEAF)
    told = {}
    for name, more in (("shipped", []), ("plant", ["--params-file", str(file)])):
        written = tmp_path / f"{name}.json"
        assert main(["replay", record, "--valve", "4weh10_soft", "--json", str(written), *more]) == 0
        result = json.loads(written.read_text("utf-8"))
        told[name] = result["valves"]["valve_1"], capsys.readouterr().out, replay_page(result, {})
    kinds = {name: [event["kind"] for event in one["events"]] for name, (one, _, _) in told.items()}
    assert kinds == {"shipped": ["resonance", "resonance"], "plant": []}
    sentence = (
        f"limits of {file}: amplification_on 9 (shipped: 1.8), amplification_off 8 (shipped: 1.5); "
        "all others as shipped"
    )
    for name, expected in (("shipped", "limits as shipped"), ("plant", sentence)):
        one, console, report = told[name]
        assert one["limits"]["sentence"] == expected
        assert f"  {expected}\n" in console
        assert f"Judged by {expected}." in report
    used = told["plant"][0]["limits"]
    assert used["source"] == str(file)
    assert used["values"]["amplification_on"] == {"value": 9.0, "unit": "1", "shipped": 1.8}
    assert used["values"]["coulomb_change"] == {"value": 0.1, "unit": "N", "shipped": 0.1}


def test_a_parameter_file_of_another_valve_changes_nothing_and_that_is_said(tmp_path: Path) -> None:
    file = limits(tmp_path, "/valve_2/monitor", **DEAF)
    assert settings_from(file, "valve_1").sentence() == (
        f"limits as shipped: {file} has none for this valve's monitor"
    )
    assert settings_from(file, "valve_2").monitor == DEAF


def test_the_estimators_parameters_apply_as_well(tmp_path: Path) -> None:
    file = limits(tmp_path, "/**/estimator", memory=6.0, low_cut=4.0)
    settings = settings_from(file, "valve_1")
    assert settings.make_estimator(SOFT, "valve_1").settings.memory == 6.0
    assert settings.sentence().startswith(f"limits of {file}: the estimator's memory 6.0; ")


def test_the_shipped_parameter_file_is_the_same_as_none() -> None:
    file = Path(__file__).resolve().parents[2] / "spool_bringup" / "config" / "valve.yaml"
    settings = settings_from(file, "press/left")
    assert settings.sentence() == f"limits of {file}, the same as shipped"
    assert settings.limits(SOFT).given["natural_frequency"] == SOFT.natural_frequency


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"amplification_on": 1.2}, "amplification_off (1.5) must lie below amplification_on (1.2)"),
        ({"coulomb_change": 3}, "parameter coulomb_change = 3 must be of type double, e.g. 3.0"),
        ({"coulomb_chang": 0.2}, "parameter coulomb_chang is unknown"),
        ({"gain_change": 7.0}, "parameter gain_change = 7.0 is out of range (from 0.02 to 1.0 1)"),
    ],
)
def test_limits_that_the_node_would_refuse_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], values: dict[str, float], reason: str
) -> None:
    file = limits(tmp_path, **values)
    assert main(["replay", str(PRACTICE), "--params-file", str(file)]) == 2
    (line,) = [one for one in capsys.readouterr().err.splitlines() if one.startswith("spool:")]
    assert line.startswith(f"spool: {file}: /valve_1/monitor: {reason}")


def test_the_time_of_the_baseline_reaches_the_monitor(
    tmp_path: Path, make_bag: MakeBag, recorded: type[Recorded]
) -> None:
    reader = BagReader(make_bag(tmp_path / "bag", {"a": recorded(seconds=8.0)}))
    short, long = (
        replay_valve(reader, "a", SOFT, settings)
        for settings in (ReplaySettings({"baseline_time": 3.0}), SHIPPED)
    )
    assert short.monitor.detection.parameters["coulomb_force"].baseline.frozen
    assert not long.monitor.detection.parameters["coulomb_force"].baseline.frozen
    assert math.isfinite(short.monitor.health.viscous_drift.value)


def test_a_replay_counts_time_on_where_the_clock_was_set_and_says_so(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "set") as writer:
        channel = None
        for topic, record in BagReader(PRACTICE).records():
            if channel is None:
                channel = writer.add_topic(topic.name, topic.type)
            data = bytearray(record.data)
            seconds = int.from_bytes(data[4:8], "little") - (3600 if record.log_time > MIDDLE else 0)
            data[4:8] = seconds.to_bytes(4, "little")
            writer.write(channel, record.log_time, bytes(data))
    whole = replay_bag(ReplayRequest(record=PRACTICE, valve=["4weh10_soft"]))
    result = replay_bag(ReplayRequest(record=tmp_path / "set", valve=["4weh10_soft"]))
    assert result["duration_s"] == pytest.approx(whole["duration_s"], abs=0.1)
    (warning,) = result["warnings"]
    assert "jumps back by 3600.000 s" in warning
    times = [event["t_s"] for event in result["valves"]["valve_1"]["events"]]
    assert all(0.0 <= time <= result["duration_s"] + 1.0 for time in times)


def test_a_message_that_cannot_be_decoded_is_left_out_of_a_replay_and_told(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        channel = None
        for number, (topic, record) in enumerate(BagReader(PRACTICE).records()):
            if channel is None:
                channel = writer.add_topic(topic.name, topic.type)
            writer.write(channel, record.log_time, record.data[:20] if number == 30 else record.data)
    result = replay_bag(ReplayRequest(record=tmp_path / "bag", valve=["4weh10_soft"]))
    (warning,) = result["warnings"]
    assert "/valve_1/acceleration: 1 message left out: the bytes do not fit the type" in warning
    assert "spool recover" in warning
    assert result["valves"]["valve_1"]["lost_blocks"] == 1


def test_drift_between_records_of_one_valve_is_seen_by_a_baseline_that_is_kept(tmp_path: Path) -> None:
    for name, friction in (("before", 0.5), ("after", 0.75)):
        settings = SimulationSettings(
            "4weh10_soft", "coulomb", "multisine", 30.0, sample_rate=1000.0, block_rate=25.0,
            coulomb_force=friction, seed=1,
        )  # fmt: skip
        simulate(tmp_path / name, settings)

    def drifts(name: str, state: Path | None) -> list[str]:
        result = replay_bag(ReplayRequest(record=tmp_path / name, state=state))
        events = result["valves"]["valve_1"]["events"]
        return [event["cause"] for event in events if event["kind"] == "friction_drift"]

    assert drifts("after", None) == []
    assert drifts("before", tmp_path / "baselines") == []
    assert drifts("after", tmp_path / "baselines") == ["oil_contamination"]
    other = ReplayRequest(record=tmp_path / "after", state=tmp_path / "baselines", valve=["4weh10_stiff"])
    with pytest.raises(InputError, match="is of valve 4weh10_soft"):
        replay_bag(other)

"""Alarms, baseline and diagnostics of real nodes, over restarts and kills."""

from __future__ import annotations

import math
import re
import signal
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from spool_bag.reader import BagReader
from spool_msgs.msg import Alarm, AlarmList, HealthEvent, ValveHealth
from spool_msgs.srv import AcknowledgeAlarm, ResetAlarms, ShelveAlarm, SuppressAlarm

if TYPE_CHECKING:
    from .conftest import Heard, Process, System, Topic

MONITOR = "/valve_1/monitor"
SILENCE = "stale/acceleration"
RATIOS = ("amplification", "viscous_coefficient_change", "reversals")
ANALYZERS = Path(__file__).parents[1] / "ros2_ws/src/spool_bringup/config/diagnostic_aggregator.yaml"
SHOWN = "/Spool valves/valve_1/monitor: "
UNITS = ("_N", "_N_per_m", "_N_s_per_m", "_Hz", "_deg_C", "_m", "_B")


def alarm(topic: Topic, name: str = SILENCE) -> Any:
    return next((one for one in topic.last.alarms if one.name == name), None) if topic.heard else None


def state(topic: Topic, name: str = SILENCE) -> int:
    found = alarm(topic, name)
    return -1 if found is None else int(found.state)


def ask(system: System, kind: Any, service: str, **fields: object) -> Any:
    return system.call(kind, f"{MONITOR}/{service}", kind.Request(**fields))


def valve(system: System, **parameters: object) -> tuple[Process, Process, Process]:
    """Start simulator, estimator and monitor of a valve and wait until it is judged."""
    monitor = system.start("monitor", baseline_time=3.0, **parameters)
    estimator = system.start("estimator")
    simulator = system.start("simulator", excitation="multisine", wait_for_subscribers=2)
    return simulator, estimator, monitor


def stop_data(system: System, simulator: Process, alarms: Topic) -> None:
    simulator.end()
    system.until(lambda: state(alarms) == Alarm.STATE_UNACKNOWLEDGED, "the silence is an alarm")


def test_operators_acknowledge_shelve_suppress_and_are_refused_with_a_reason(system: System) -> None:
    alarms = system.listen(AlarmList, "/valve_1/alarms", latched=True)
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    simulator, _, _ = valve(system)
    system.until(lambda: health.heard and health.last.namur == ValveHealth.NAMUR_NORMAL, "all is well")
    out = SuppressAlarm.Request.OUT_OF_SERVICE
    assert ask(system, SuppressAlarm, "suppress_alarm", alarm=SILENCE, way=out, who="E").success
    system.until(lambda: health.last.namur == ValveHealth.NAMUR_FUNCTION_CHECK, "somebody works on it")
    taken = ask(system, SuppressAlarm, "suppress_alarm", alarm=SILENCE, way=out, suppressed=False, who="E")
    assert taken.success
    system.until(lambda: health.last.namur == ValveHealth.NAMUR_NORMAL, "it is back")
    stop_data(system, simulator, alarms)
    assert alarm(alarms).namur == ValveHealth.NAMUR_FAILURE
    system.until(lambda: health.last.namur == ValveHealth.NAMUR_FAILURE, "health says failure")

    nobody = ask(system, AcknowledgeAlarm, "acknowledge_alarm", alarm=SILENCE)
    assert (nobody.success, nobody.reason) == (False, "'who' is required: name the operator")
    unknown = ask(system, AcknowledgeAlarm, "acknowledge_alarm", alarm="smoke", who="Eva")
    assert not unknown.success
    assert unknown.reason.startswith("no alarm 'smoke'; there are: ")
    active = ask(system, ResetAlarms, "reset_alarms", alarm=SILENCE, who="Eva")
    assert active.reason == f"{SILENCE}: it is still active, so it can't be reset"
    past = ask(system, AcknowledgeAlarm, "acknowledge_alarm", alarm=SILENCE, who="Eva", occurrence=7)
    assert "occurrence 7 is not current; look at number 1 first" in past.reason

    # Calling the service asks for it: a missing field does not take back.
    shelved = ask(system, ShelveAlarm, "shelve_alarm", alarm=SILENCE, duration=600.0, who="Eva")
    assert shelved.success
    system.until(lambda: state(alarms) == Alarm.STATE_SHELVED, "it is on the shelf")
    assert alarm(alarms).underlying == Alarm.STATE_UNACKNOWLEDGED
    assert ask(system, ShelveAlarm, "shelve_alarm", alarm=SILENCE, shelved=False, who="Eva").success

    assert ask(system, SuppressAlarm, "suppress_alarm", alarm=SILENCE, way=out, who="E").success
    system.until(lambda: state(alarms) == Alarm.STATE_OUT_OF_SERVICE, "it is out of service")
    back = ask(system, SuppressAlarm, "suppress_alarm", alarm=SILENCE, way=out, suppressed=False, who="E")
    assert back.success
    wrong = ask(system, SuppressAlarm, "suppress_alarm", alarm=SILENCE, way=9, suppressed=True, who="E")
    assert wrong.reason == "way: 9 is not 0 (by design) or 1 (out of service)"
    assert ask(system, AcknowledgeAlarm, "acknowledge_alarm", alarm="", who="Eva").success
    system.until(lambda: state(alarms) == Alarm.STATE_ACKNOWLEDGED, "it is acknowledged")


def test_a_monitor_that_shall_keep_nothing_says_so(system: System) -> None:
    monitor = system.start("monitor", state_folder="none")
    system.until(lambda: "alarms and baseline are kept nowhere" in monitor.said, "it is configured")
    assert monitor.end(signal.SIGINT) == 0
    assert "can't be written" not in monitor.said


@pytest.mark.slow
def test_an_operator_works_from_a_terminal_and_the_alarm_keeps_its_surroundings(
    system: System, tmp_path: Path
) -> None:
    alarms = system.listen(AlarmList, "/valve_1/alarms", latched=True)
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    folder = tmp_path / "snapshots"
    recorder = system.start(
        "recorder", namespace="", output=tmp_path / "bag", valves="[valve_1]",
        snapshot_folder=folder, snapshot_before=5.0, snapshot_after=1.0,
    )  # fmt: skip
    simulator, _, _ = valve(system)
    # Of a valve that never sent a block no silence can be timed.
    system.until(lambda: health.heard and health.last.level == ValveHealth.LEVEL_OK, "data are judged")
    assert system.spool("alarm", "list", "valve_1").returncode == 0
    stop_data(system, simulator, alarms)
    listed = system.spool("alarm", "list", "valve_1")
    assert listed.returncode == 1
    assert SILENCE in listed.stdout
    done = system.spool("alarm", "acknowledge", "valve_1", SILENCE, "--who", "Eva")
    assert (done.returncode, done.stdout.strip()) == (0, f"valve_1: {SILENCE}")
    system.until(lambda: state(alarms) == Alarm.STATE_ACKNOWLEDGED, "it is acknowledged")
    again = system.spool("alarm", "acknowledge", "valve_1", SILENCE, "--who", "Eva")
    assert again.returncode == 2
    assert again.stderr.strip().endswith("there is nothing to acknowledge, Eva acknowledged it")
    assert "Traceback" not in again.stderr
    kept = ("--state-folder", str(system.folder / "state" / "spool"))
    history = system.spool("alarm", "history", "--search", "eva acknowledge", *kept)
    assert re.search(rf"valve_1 +acknowledge +801 {SILENCE} +Eva +No acceleration", history.stdout)
    counted = system.spool("alarm", "statistics", *kept)
    assert counted.stdout.startswith("1 alarm of 1 valve from "), counted.stdout + counted.stderr
    # The recorder's own words say that the bag is complete.
    system.until(lambda: "snapshot " in recorder.said, "the alarm's surroundings are kept")
    (bag,) = folder.iterdir()
    assert bag.name.startswith("valve_1_stale_")
    reader = BagReader(bag)
    assert len(list(reader.blocks("valve_1"))) > 50
    kinds = [one.kind for one in reader.messages("/valve_1/events")]
    assert "stale" in kinds
    replayed = system.spool("replay", str(bag))
    assert replayed.returncode == 0, replayed.stderr
    assert "valve_1" in replayed.stdout
    asked = system.spool("snapshot", "valve_1", "--who", "Eva", "--comment", "sounds odd")
    assert asked.returncode == 0, asked.stderr
    # While it is written it has another name.
    system.until(lambda: any(folder.glob("valve_1_requested_*")), "a snapshot is kept on request")
    unknown = system.spool("snapshot", "valve_2", "--who", "Eva")
    assert (unknown.returncode, "no data of this valve is recorded" in unknown.stderr) == (2, True)


# By the rules of the standard tools: REP 107 and what diagnostic_aggregator and rqt show.


def until_stale(system: System, tasks: list[str], after: float) -> Callable[[], bool]:
    def stale() -> bool:
        newest = [system.statuses(task, after=after) for task in tasks]
        return all(one and one[-1][1].level == DiagnosticStatus.STALE for one in newest)

    return stale


def memory(statuses: Iterable[DiagnosticStatus], *keys: str) -> dict[str, tuple[int, bool]]:
    """Return the faults that ros2_medkit has of ``statuses``: by code the worst level, and whether it stands.

    Its bridge takes the code from the first of ``keys`` that a task has, without keys from the task's name,
    and calls STALE critical; its fault manager knows a fault by the code alone: an OK of it ends it.
    """
    faults: dict[str, tuple[int, bool]] = {}
    for one in statuses:
        values = {pair.key: pair.value for pair in one.values}
        own = re.sub("[^A-Z0-9]+", "_", one.name.upper()).strip("_")
        code = next((values[key] for key in keys if key in values), "" if keys else own)
        level = int.from_bytes(one.level, "little")
        if code and (level or code in faults):
            assert re.fullmatch(r"[A-Za-z0-9_.-]{1,128}", code)
            faults[code] = (max(level, faults.get(code, (0, False))[0]), level > 0)
    return faults


def aggregated(heard: Iterable[Heard], now: float) -> dict[str, int]:
    """Return what diagnostic_aggregator with our analyzers shows of ``heard`` at ``now``: levels by path.

    It keeps the last state of each task that an analyzer's prefix fits, forever, and makes it STALE where
    ``timeout`` passed since. An expected task is STALE before it comes. An analyzer has the worst level; with
    a STALE one among others it is ERROR. It shows no "/" of a name, and removes the prefix.
    """
    stale, error = (int.from_bytes(one, "little") for one in (DiagnosticStatus.STALE, DiagnosticStatus.ERROR))
    settings = yaml.safe_load(ANALYZERS.read_text())["analyzers"]["ros__parameters"]
    root, shown = settings.pop("path"), {}
    received = [(one.arrival, status) for one in heard for status in one.message.status]
    for analyzer in settings.values():
        (prefix,), path = analyzer["find_and_remove_prefix"], f"/{root}/{analyzer['path']}"
        items = dict.fromkeys(analyzer["expected"], (-math.inf, stale))
        for arrival, status in received:
            if status.name.startswith(prefix):
                items[status.name] = arrival, int.from_bytes(status.level, "little")
        levels = {
            name: stale if now - at > analyzer["timeout"] else level for name, (at, level) in items.items()
        }
        worst = max(levels.values())
        shown[path] = error if worst == stale and min(levels.values()) < stale else worst
        shown |= {
            f"{path}/{name.removeprefix(prefix).strip().replace('/', ' ')}": one
            for name, one in levels.items()
        }
    return shown


def test_a_fault_memory_has_a_fault_an_alarm_and_silence_by_order_is_no_fault(system: System) -> None:
    """As a bridge reads it: a fault for each task that is not OK, at the node that hardware_id names."""
    _ = system.diagnostics
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    simulator, _, _ = valve(system)
    system.until(lambda: health.heard and health.last.namur == ValveHealth.NAMUR_NORMAL, "all is well")
    simulator.end()
    task, judged = (
        f"valve_1/monitor: alarm {SILENCE}",
        ["valve_1/monitor: data", "valve_1/monitor: condition"],
    )

    def last(name: str, after: float = 0.0) -> DiagnosticStatus:
        return (system.statuses(name, after=after) or [(0.0, DiagnosticStatus(level=b"\xff"))])[-1][1]

    system.until(lambda: last(task).level == DiagnosticStatus.ERROR, "the silence is a fault")
    assert last(task).hardware_id == MONITOR
    assert system.numbers(task)["code"] == "801"
    everything = [one for heard in system.diagnostics.messages for one in heard.status]
    assert {one.name for one in everything if any(pair.key == "code" for pair in one.values)} == {task}
    assert memory(everything, "fault_code") == {"valve_1.stale.acceleration": (2, True)}
    critical = {code for code, (level, _) in memory(everything).items() if level == 3}
    assert critical <= {"VALVE_1_MONITOR_DATA", "VALVE_1_MONITOR_CONDITION"}
    shown = aggregated(system.diagnostics.heard, system.diagnostics.heard[-1].arrival)
    assert shown["/Spool valves/valve_1"] == shown[f"{SHOWN}alarm stale acceleration"] == 2
    assert shown["/Spool valves/valve_2"] == 3  # it never came
    estimator = [one for one in everything if one.name == "valve_1/estimator: estimate"]
    assert DiagnosticStatus.STALE not in {one.level for one in estimator}

    out = SuppressAlarm.Request.OUT_OF_SERVICE
    assert ask(system, SuppressAlarm, "suppress_alarm", way=out, who="Eva").success
    ordered = time.monotonic()
    for name in (task, *judged):
        system.until(lambda name=name: last(name, ordered).level == DiagnosticStatus.OK, "no fault any more")
        assert "out of service" in last(name).message
    put_aside = time.monotonic()
    everything = [one for heard in system.diagnostics.messages for one in heard.status]
    assert memory(everything, "fault_code") == {"valve_1.stale.acceleration": (2, False)}
    system.change(MONITOR, "deactivate")
    asleep, resting = "not monitored: the monitor is inactive", time.monotonic()
    system.until(lambda: all(last(name).message == asleep for name in judged), "it says that it sleeps")
    assert {last(name).level for name in judged} == {DiagnosticStatus.OK}
    system.until(
        lambda: system.statuses(task, after=resting + 6.0), "a monitor that rests differs from a dead one"
    )
    newest = system.diagnostics.heard[-1].arrival
    shown = aggregated(system.diagnostics.heard, newest)
    own = {name: level for name, level in shown.items() if name.startswith(SHOWN)}
    assert f"{SHOWN}alarm stale acceleration" in own
    assert set(own.values()) == {0}
    gone = aggregated(system.diagnostics.heard, newest + 6.0)
    assert set(gone.values()) == {3}
    since = [
        one for heard in system.diagnostics.heard if heard.arrival > put_aside for one in heard.message.status
    ]
    assert DiagnosticStatus.STALE not in {one.level for one in since}


def test_diagnostics_follow_the_rules_of_the_standard_tools_where_nothing_can_be_kept(system: System) -> None:
    _ = system.diagnostics
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    events = system.listen(HealthEvent, "/valve_1/events", latched=True)
    simulator, _, monitor = valve(system, state_folder="/proc/nowhere")

    def own() -> dict[str, DiagnosticStatus]:
        found = {}
        for heard in system.diagnostics.messages:
            for one in heard.status:
                if one.name.startswith(("valve_1/monitor: ", "valve_1/estimator: ")):
                    found[one.name] = one
        return found

    ours = [f"valve_1/monitor: {task}" for task in ("data", "condition", "alarms")]
    system.until(
        lambda: (
            {*ours, "valve_1/estimator: estimate"} <= set(own())
            and all(KeyValue(key="valve_id", value="4weh10_soft") in one.values for one in own().values())
        ),
        "every task says which valve it is of",
    )
    system.until(
        lambda: any(value.key.startswith("viscous_coefficient_change") and value.value != "nan"
                    for value in own()[ours[1]].values),
        "the drift is known",
    )  # fmt: skip
    assert len(own()) <= 4  # and one of the simulator, where there is one
    for name, one in own().items():
        assert one.level in (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR), name
        assert one.message
        for value in one.values:
            assert re.fullmatch(r"[a-z][a-z0-9_]*(_[A-Za-z0-9_]+)?", value.key), value.key
            # A count says what is counted in its name; relative changes and ratios have no unit.
            if re.fullmatch(r"-?(\d+\.\d*|\d+e.*|nan|inf)", value.value) and value.key not in RATIOS:
                assert value.key.endswith(UNITS), f"{name}: no unit in {value.key!r}"
    keys = [value.key for one in own().values() for value in one.values]
    assert all(keys)
    assert all(len({value.key for value in one.values}) == len(one.values) for one in own().values())

    # Once a second and not more: a display of a hundred valves has to follow. One more at either end, and one
    # where the level became known.
    stamps = [
        array.header.stamp.sec + 1e-9 * array.header.stamp.nanosec
        for array in system.diagnostics.messages
        if any(status.name == ours[0] for status in array.status)
    ]
    assert len(stamps) <= 3 + (stamps[-1] - stamps[0]) + 2 * len(events.heard)

    gone = time.monotonic()
    simulator.end()
    system.until(until_stale(system, ours[:2], gone), "the tasks go stale")
    system.until(
        lambda: events.first(
            lambda one: one.kind == "stale" and one.state == HealthEvent.STATE_RAISED, after=gone
        ),
        "the event says so",
    )
    system.until(
        lambda: any(
            one.level == DiagnosticStatus.ERROR and SILENCE in one.message
            for _, one in system.statuses(ours[2], after=gone)
        ),
        "the alarm is shown",
    )
    assert health.first(lambda message: message.level == ValveHealth.LEVEL_OK), "data were judged"
    assert monitor.end(signal.SIGINT) == 0
    assert monitor.said.count("can't be written") == 1

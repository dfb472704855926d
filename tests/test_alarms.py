"""Alarms and diagnostics of real nodes: what operators and the standard tools see."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from spool_bag.reader import BagReader
from spool_msgs.msg import Alarm, AlarmList, ValveHealth
from spool_msgs.srv import SuppressAlarm

if TYPE_CHECKING:
    from .conftest import Heard, Process, System, Topic

MONITOR = "/valve_1/monitor"
SILENCE = "stale/acceleration"
ANALYZERS = Path(__file__).parents[1] / "ros2_ws/src/spool_bringup/config/diagnostic_aggregator.yaml"
SHOWN = "/Spool valves/valve_1/monitor: "


def alarm(topic: Topic, name: str = SILENCE) -> Any:
    return next((one for one in topic.last.alarms if one.name == name), None) if topic.heard else None


def state(topic: Topic, name: str = SILENCE) -> int:
    found = alarm(topic, name)
    return -1 if found is None else int(found.state)


def ask(system: System, kind: Any, service: str, **fields: object) -> Any:
    return system.call(kind, f"{MONITOR}/{service}", kind.Request(**fields))


def valve(system: System) -> Process:
    """Start monitor, estimator and simulator of a valve; return the simulator."""
    system.start("monitor", baseline_time=3.0)
    system.start("estimator")
    return system.start("simulator", excitation="multisine", wait_for_subscribers=2)


def stop_data(system: System, simulator: Process, alarms: Topic) -> None:
    simulator.end()
    system.until(lambda: state(alarms) == Alarm.STATE_UNACKNOWLEDGED, "the silence is an alarm")


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
    simulator = valve(system)
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
    settings = yaml.safe_load(ANALYZERS.read_text("utf-8"))["analyzers"]["ros__parameters"]
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
    simulator = valve(system)
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

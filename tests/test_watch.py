"""`./spool watch`, `baseline` and `analyse` on real nodes: what is shown, and what an operator's keys do."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from spool_monitor.listener import DRIFT, HeardValve
from spool_msgs.msg import Alarm, AlarmList, ValveHealth
from spool_tools.operations.valve_rows import shown_condition

if TYPE_CHECKING:
    from textual.pilot import Pilot

    from .conftest import System

SILENCE = "stale/acceleration"
#: s; what is waited for comes much sooner on an idle machine.
PATIENCE = 180.0


def heard(level: int, judgement: str = "judged") -> HeardValve:
    judgements = [f"{name}: {judgement}" for name in DRIFT]
    health = ValveHealth(level=level, baseline=ValveHealth.BASELINE_FROZEN, judgements=judgements)
    return HeardValve("v", health, 100.0)


@pytest.mark.parametrize(
    ("valve", "now", "word"),
    [
        (heard(ValveHealth.LEVEL_OK), 100.5, "OK"),
        (heard(ValveHealth.LEVEL_OK), 104.0, "NO WORD"),
        (HeardValve("v"), 100.0, "NO WORD"),
        (heard(ValveHealth.LEVEL_STALE), 100.5, "STALE"),
        (heard(ValveHealth.LEVEL_OK, "learning"), 100.5, "LEARNING"),
        (heard(ValveHealth.LEVEL_OK, "not enough excitation"), 100.5, "AT REST"),
        (heard(ValveHealth.LEVEL_ALARM), 100.5, "ALARM"),
    ],
)
def test_a_valve_is_shown_as_good_only_where_it_was_judged_lately(
    valve: HeardValve, now: float, word: str
) -> None:
    assert shown_condition(valve, now).word == word


def test_marks_tell_conditions_without_colour() -> None:
    levels = (ValveHealth.LEVEL_OK, ValveHealth.LEVEL_WARNING, ValveHealth.LEVEL_ALARM, 0)
    assert len({shown_condition(heard(level), 100.0).mark for level in levels}) == len(levels)


async def until(pilot: Pilot[None], met: Callable[[], object], what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not met():
        assert time.monotonic() < end, f"waited in vain: {what}"
        await pilot.pause(0.1)


@pytest.mark.slow
def test_alarms_are_acknowledged_and_shelved_by_keys(system: System, monkeypatch: pytest.MonkeyPatch) -> None:
    alarms = system.listen(AlarmList, "/valve_1/alarms", latched=True)
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    system.start("monitor", baseline_time=3.0)
    system.start("estimator")
    simulator = system.start("simulator", excitation="multisine", wait_for_subscribers=2)
    system.until(lambda: health.heard and health.last.level == ValveHealth.LEVEL_OK, "data are judged")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(system.domain_id))
    from spool_tools.operations.watch import WatchApp, WatchNode  # noqa: PLC0415 - slow to load

    listener = WatchNode()

    def state() -> tuple[int, Any]:
        valve = listener.valves.get("valve_1")
        listed = [] if valve is None or valve.alarms is None else valve.alarms.alarms
        found = next((one for one in listed if one.name == SILENCE), None)
        return (-1, None) if found is None else (found.state, found)

    async def work() -> None:
        app = WatchApp(listener, "Eva")
        async with app.run_test(size=(160, 40)) as pilot:
            valves: Any = app.query_one("#valves")
            await until(pilot, lambda: valves.row_count == 1, "the valve is found by itself")
            simulator.kill()
            table: Any = app.query_one("#alarms")
            await until(pilot, lambda: state()[0] == Alarm.STATE_UNACKNOWLEDGED, "the silence is an alarm")
            await until(pilot, lambda: table.row_count == 1, "it is shown")
            assert "STALE" in str(valves.get_row_at(0)[1]) or "ALARM" in str(valves.get_row_at(0)[1])
            await pilot.press("a")
            await pilot.press(*"seen", "enter")
            await until(pilot, lambda: state()[0] == Alarm.STATE_ACKNOWLEDGED, "it is acknowledged")
            assert (state()[1].acknowledged_by, state()[1].comment) == ("Eva", "seen")
            await pilot.press("s", "escape")
            await pilot.press("s", "enter")
            await until(pilot, lambda: state()[0] == Alarm.STATE_SHELVED, "it is on the shelf")
            await pilot.press("u", "enter")
            await until(pilot, lambda: state()[0] == Alarm.STATE_ACKNOWLEDGED, "it is off the shelf")
            await pilot.press("r", "enter")
            said: Any = app.query_one("#said")
            await until(pilot, lambda: "can't be reset" in str(said.content), "a refusal is shown")

    try:
        asyncio.run(work())
    finally:
        listener.close()
    assert alarms.heard


@pytest.mark.slow
def test_off_a_terminal_lines_a_baseline_and_an_analysis_come_by_command(
    system: System, tmp_path: Path
) -> None:
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    system.start("monitor", baseline_time=3.0)
    system.start("estimator")
    system.start("simulator", excitation="multisine", wait_for_subscribers=2)
    system.until(
        lambda: health.heard and health.last.baseline == ValveHealth.BASELINE_FROZEN, "a baseline is learned"
    )
    watched = system.spool("watch", "--seconds", "7")
    assert watched.returncode == 0, watched.stderr
    assert "valve_1  " in watched.stdout
    shown = system.spool("baseline", "show", "valve_1")
    assert shown.returncode == 0, shown.stderr
    assert "spring_stiffness" in shown.stdout
    confirmed = system.spool("baseline", "freeze", "valve_1", "--who", "Eva")
    assert "confirmed by Eva" in confirmed.stdout, confirmed.stderr
    missing = system.spool("baseline", "restore", "valve_1", "9", "--who", "Eva")
    assert (missing.returncode, "Traceback" in missing.stderr) == (2, False)
    file = tmp_path / "gap.json"
    analysed = system.spool("analyse", "valve_1", "--json", str(file))
    assert analysed.returncode == 0, analysed.stderr
    assert json.loads(file.read_text("utf-8"))["verdict"] in analysed.stdout
    nobody = system.spool("analyse", "valve_9")
    assert nobody.returncode == 2
    assert "no active estimator answers in /valve_9" in nobody.stderr

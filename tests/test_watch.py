"""`./spool watch`, `baseline` and `analyse` on real nodes: what is shown, and what an operator does."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from rich.console import Console, Group
from spool_core.events.language import ENGLISH
from spool_monitor.listener import DRIFT, HeardValve
from spool_monitor.shown import shown as shown_valve
from spool_msgs.msg import ValveHealth
from spool_tools.operations.valve_rows import SHOWN, picture, valve_row

if TYPE_CHECKING:
    from .conftest import System


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
    assert valve_row(valve, shown_valve(valve, now, 0.0))[1].plain.endswith(word)


def test_marks_tell_conditions_without_colour() -> None:
    levels = (ValveHealth.LEVEL_OK, ValveHealth.LEVEL_WARNING, ValveHealth.LEVEL_ALARM, 0)
    marks = {SHOWN[shown_valve(heard(level), 100.0, 0.0).state].mark for level in levels}
    assert len(marks) == len(levels)


def shown(picture: Group, line_width: int = 200) -> str:
    console = Console(width=line_width, file=io.StringIO())
    console.print(picture)
    return console.file.getvalue()  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_table_shows_a_valve_that_falls_silent_and_its_alarm(
    system: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    system.start("monitor", baseline_time=3.0)
    system.start("estimator")
    simulator = system.start("simulator", excitation="multisine", wait_for_subscribers=2)
    system.until(lambda: health.heard and health.last.level == ValveHealth.LEVEL_OK, "data are judged")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(system.domain_id))
    from spool_tools.operations.live_run import Display, live_run  # noqa: PLC0415 - slow to load

    with live_run("watch", Display(None)) as run:

        def now() -> str:
            run.turn()
            return shown(picture(run.display.valves, ENGLISH))

        system.until(lambda: "valve_1" in now(), "the valve is found by itself")
        simulator.kill()
        system.until(lambda: "801 stale/acceleration" in now(), "its alarm is shown")
        assert "No acceleration: silence" in now()


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

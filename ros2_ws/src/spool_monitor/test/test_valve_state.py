"""What is kept of a valve comes back after a full, a failing and a shared disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from spool_core.uncertainty import Quantity
from spool_monitor.alarm import Operator
from spool_monitor.event import Event, EventState, Severity
from spool_monitor.journal import JournalEntry
from spool_monitor.monitor import Monitor
from spool_monitor.state_database import FILE
from spool_monitor.state_file import BaselineRecord, HealthyValue, StateFile, StateTable
from spool_monitor.valve_state import ALARMS, BASELINE, RETRY, ValveState


def opened(folder: Path | None) -> tuple[ValveState, list[str]]:
    warnings: list[str] = []
    state = ValveState(Monitor(), folder, warnings.append)
    state.open()
    return state, warnings


def stuck(state: EventState, stamp: int) -> Event:
    return Event(stamp, "stuck_spool", state, Severity.ALARM, "", Quantity("x", "1"))


def failing(number: int, reason: str) -> Callable[..., Any]:
    """Return what a disk does that refuses a call."""

    def call(*_: Any, **__: Any) -> Any:
        raise OSError(number, reason)

    return call


def test_a_folder_in_use_is_left_alone(tmp_path: Path) -> None:
    first, _ = opened(tmp_path)
    second, warnings = opened(tmp_path)
    assert not second.writable
    assert len(warnings) == 1
    assert "in use by another monitor" in warnings[0]
    second.alarms.update(stuck(EventState.RAISED, 1))
    second.keep_alarms()
    assert not (tmp_path / FILE).exists()
    first.close()


def test_what_can_t_be_understood_is_kept_aside(tmp_path: Path) -> None:
    file = StateFile(tmp_path, print)
    file.save(ALARMS, {"not": "alarms"})
    file.close()
    state, warnings = opened(tmp_path)
    state.keep_alarms()
    state.close()
    assert "it will be kept as alarms.damaged" in warnings[0]
    assert json.loads((tmp_path / "alarms.damaged").read_text("utf-8")) == {"not": "alarms"}


def test_a_disk_that_was_full_is_written_as_soon_as_it_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, warnings = opened(tmp_path)
    with monkeypatch.context() as full:
        full.setattr(StateTable, "write", failing(28, "No space left on device"))
        state.alarms.update(stuck(EventState.RAISED, 1))
        state.keep_alarms()
        state.retry(0)
        assert not state.writable
        assert len(warnings) == 1
        assert "No space left on device" in warnings[0]
    state.retry(RETRY // 2)
    assert not state.writable
    state.retry(RETRY)
    assert state.writable
    assert "can be written again" in warnings[1]
    state.close()
    again, _ = opened(tmp_path)
    assert again.alarms.alarms["stuck_spool"].active
    again.close()


def test_a_folder_that_another_monitor_leaves_is_taken_over_with_what_it_holds(tmp_path: Path) -> None:
    first, _ = opened(tmp_path)
    second, _ = opened(tmp_path)
    first.alarms.update(stuck(EventState.RAISED, 1))
    first.alarms.acknowledge("stuck_spool", Operator("Eva", 2))
    first.keep_alarms()
    first.close()
    second.retry(0)
    assert second.writable
    assert second.alarms.alarms["stuck_spool"].acknowledged_by == "Eva"
    # Its end is seen, too.
    assert second.monitor.detection.conditions["stuck_spool"].active is Severity.ALARM
    second.close()


def test_a_file_that_can_t_be_read_for_a_while_is_no_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, _ = opened(tmp_path)
    state.alarms.update(stuck(EventState.RAISED, 1))
    state.alarms.acknowledge("stuck_spool", Operator("Eva", 2))
    state.alarms.update(stuck(EventState.CLEARED, 3))
    state.keep_alarms()
    state.close()
    with monkeypatch.context() as disk:
        disk.setattr(StateTable, "read", failing(5, "Input/output error"))
        again, warnings = opened(tmp_path)
        again.keep_alarms()
        assert not again.retry(0)
        assert len(warnings) == 1
        assert "can't be read (Input/output error)" in warnings[0]
    assert not again.writable
    assert again.retry(RETRY)
    alarm = again.alarms.alarms["stuck_spool"]
    assert (alarm.latched, alarm.acknowledged_by) == (True, "Eva")
    assert again.writable
    again.close()
    assert not list(tmp_path.glob("*.damaged"))


def test_what_is_due_is_written_at_the_end_or_named_as_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for healed in (False, True):
        state, warnings = opened(tmp_path)
        with monkeypatch.context() as full:
            full.setattr(StateTable, "write", failing(28, "full"))
            state.alarms.update(stuck(EventState.RAISED, 1))
            state.keep_alarms()
            if not healed:
                state.close()
        if healed:
            state.close()
        again, _ = opened(tmp_path)
        assert again.alarms.alarms["stuck_spool"].active is healed
        again.close()
        assert any("not written and lost: alarms" in line for line in warnings) is not healed


def test_a_disk_that_fails_in_two_ways_is_said_once_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, warnings = opened(tmp_path)
    state.note([JournalEntry(1, "raise", "stuck_spool")])
    monkeypatch.setattr(StateTable, "write", failing(5, "Input/output error"))
    (tmp_path / FILE).unlink()
    state.keep_alarms()
    (tmp_path / FILE).unlink()
    (tmp_path / FILE).mkdir()
    state.note([JournalEntry(2, "clear", "stuck_spool")])
    for number in range(5):
        state.retry(number * RETRY)
    assert len(set(warnings)) == len(warnings) >= 2
    state.close()


@pytest.mark.parametrize("folder", [None, Path("/proc/nowhere")])
def test_without_a_folder_it_warns_once_and_works(folder: Path | None) -> None:
    state, warnings = opened(folder)
    state.alarms.update(stuck(EventState.RAISED, 1))
    state.keep_alarms()
    state.keep_alarms()
    assert len(warnings) == (0 if folder is None else 1)
    assert state.alarms.alarms["stuck_spool"].active
    state.close()


def test_a_folder_of_json_files_is_taken_over_with_its_alarms_and_its_baseline(tmp_path: Path) -> None:
    """The files are those of the version before: JSON, with a checksum over sequence and content."""
    before, _ = opened(None)
    before.alarms.update(stuck(EventState.RAISED, 1))
    before.alarms.acknowledge("stuck_spool", Operator("Eva", 2))
    record = BaselineRecord("4weh10_soft", version=3, values=(HealthyValue("k", "N/m", 5847.0, 1, 1, 1, 9),))
    before.baseline.records = [record]
    for name, content in ((ALARMS, before.alarms.dump()), (BASELINE, before.baseline.dump())):
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        digest = hashlib.sha256(f"41\n{text}".encode()).hexdigest()
        whole = {"format": 1, "sequence": 41, "sha256": digest, "content": content}
        (tmp_path / f"{name}.json").write_text(json.dumps(whole), "utf-8")
    state, warnings = opened(tmp_path)
    state.keep_alarms()
    state.keep_baseline()
    state.close()
    for path in tmp_path.glob("*.json"):
        path.unlink()
    again, more = opened(tmp_path)
    assert again.alarms.alarms["stuck_spool"].acknowledged_by == "Eva"
    assert [(one.version, one.values[0].value) for one in again.baseline.records] == [(3, 5847.0)]
    assert warnings == more == []
    again.close()

"""What long work shows: a bar on a terminal, nothing elsewhere."""

from __future__ import annotations

import io
import threading

import pytest
from spool_tools.terminal import progress


class Terminal(io.StringIO):
    """A terminal that keeps what is written to it."""

    def isatty(self) -> bool:
        return True


def test_long_work_shows_what_it_does_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with progress("replaying valve_1", 8.0) as advance:
        advance(2.0)
    assert "replaying valve_1" in terminal.getvalue()


def test_work_off_a_terminal_is_silent_however_long_it_takes(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # colours that a user forces make no terminal
    before = threading.enumerate()
    with progress("reading", 8.0) as advance:
        advance(2.0)
        # Nothing is left that could write later.
        assert threading.enumerate() == before
    assert capfd.readouterr() == ("", "")

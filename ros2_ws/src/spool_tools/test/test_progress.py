"""What long work says where there is no terminal."""

from __future__ import annotations

import re
import threading

import pytest
from spool_tools.terminal import progress


class Lines:
    """A stream without a terminal that tells when a line has come."""

    def __init__(self) -> None:
        self.text = ""
        self.came = threading.Event()

    def write(self, text: str) -> int:
        self.text += text
        if "\n" in self.text:
            self.came.set()
        return len(text)

    def flush(self) -> None:
        """Nothing is held back."""

    def isatty(self) -> bool:
        return False


def test_long_work_says_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = Lines()
    monkeypatch.setattr("sys.stderr", lines)
    with progress("replaying valve_1", 8.0, interval=0.01) as advance:
        advance(2.0)
        assert lines.came.wait(timeout=10)
    first = lines.text.splitlines()[0]
    assert re.fullmatch(r"replaying valve_1: \d+ s, 25 % done, about \d+ s left", first)


def test_short_work_is_silent(capfd: pytest.CaptureFixture[str]) -> None:
    with progress("reading") as advance:
        advance(1.0)
    assert capfd.readouterr() == ("", "")

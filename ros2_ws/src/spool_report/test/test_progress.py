"""What long work shows: a bar on a terminal, nothing elsewhere."""

from __future__ import annotations

import io
import re
import threading

import pytest
from spool_core.kernels.kernel_files import KernelCache
from spool_report.terminal import progress


class Terminal(io.StringIO):
    """A terminal that keeps what is written to it."""

    def isatty(self) -> bool:
        return True


def shown(monkeypatch: pytest.MonkeyPatch, *, compiled: bool = False, **how: bool) -> str:
    """What a bar of 8 parts shows, 6 of which are done."""
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with progress("fitting", 8.0, **how) as advance:
        if compiled:
            kernel = KernelCache("no.such.kernel", lambda: "0" * 64)
            assert kernel.load_overload((), Target()) is None
        else:
            advance(6.0)
    return terminal.getvalue()


class Target:
    """Target of a compilation, as numba's."""

    def refresh(self) -> None:
        pass

    def codegen(self) -> Target:
        return self

    def magic_tuple(self) -> tuple[str]:
        return ("processor",)


def test_the_time_left_is_shown_for_work_of_equal_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    assert re.search(r"fitting.* 75%.* about \d+ s left", shown(monkeypatch))
    assert re.search(r"at most \d+ s left", shown(monkeypatch, at_most=True))


def test_a_time_left_that_cannot_be_known_is_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    text = shown(monkeypatch, steady=False)
    assert "75%" in text
    assert "left" not in text


def test_compilation_is_called_that_and_counts_as_no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    text = shown(monkeypatch, compiled=True)
    assert "fitting: compiling the numerical kernels (first start only)" in text
    assert "left" not in text
    assert KernelCache.watch is None


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

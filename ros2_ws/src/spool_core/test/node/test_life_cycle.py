from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable
from typing import Any

import pytest
from std_srvs.srv import Trigger

from .conftest import PATIENCE

Start = Callable[..., "subprocess.Popen[str]"]


def end(process: subprocess.Popen[str], number: int = signal.SIGTERM) -> tuple[list[str], str]:
    """End the node; return what its hooks said and its log."""
    process.send_signal(number)
    stdout, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, stderr
    return stdout.split(), stderr


def test_starts_itself_and_ends_on_an_interrupt_in_order(probe: Start, observer: Any) -> None:
    process = probe()
    observer.until(lambda: "tick" in observer.heard, "a tick")
    assert observer.state() == "active"
    words, log = end(process, signal.SIGINT)
    assert words == ["configure", "activate", "deactivate", "cleanup"]
    assert "Traceback" not in log


def test_without_autostart_it_waits_in_silence_and_ends_on_a_signal(probe: Start, observer: Any) -> None:
    process = probe(autostart="false")
    assert observer.state() == "unconfigured"
    observer.spin(0.5)
    assert observer.heard == []
    assert end(process, signal.SIGINT)[0] == []


def test_the_whole_life_cycle_by_its_services(probe: Start, observer: Any) -> None:
    process = probe(autostart="false")
    for _ in range(2):
        assert observer.change("configure")
        assert observer.state() == "inactive"
        observer.becomes_silent()
        assert observer.change("activate")
        assert observer.state() == "active"
        observer.until(lambda: observer.heard.count("tick") > 3, "ticks")
        observer.tell("something")
        observer.until(lambda: "heard something" in observer.heard, "the echo")
        assert observer.change("deactivate")
        assert observer.state() == "inactive"
        observer.becomes_silent()
        assert observer.change("cleanup")
        assert observer.state() == "unconfigured"
    assert end(process)[0] == ["configure", "activate", "deactivate", "cleanup"] * 2


def test_a_transition_that_raises_fails_in_silence_and_can_be_tried_again(
    probe: Start, observer: Any
) -> None:
    process = probe(autostart="false", failing="configure")
    assert not observer.change("configure")
    assert observer.state() == "unconfigured"
    assert observer.set(failing="activate!")[0]
    assert observer.change("configure")
    assert not observer.change("activate")
    assert observer.state() == "inactive"
    observer.spin(0.4)
    assert observer.heard == []
    assert observer.set(failing="deactivate")[0]
    assert observer.change("activate")
    observer.until(lambda: "tick" in observer.heard, "a tick")
    assert not observer.change("deactivate")
    observer.becomes_silent()
    assert process.poll() is None
    words, log = end(process)
    assert words[:2] == ["configure", "cleanup"]
    assert "can't configure: Traceback" in log
    assert "RuntimeError: configure broke" in log
    assert "can't activate: activate: repair this" in log
    assert "RuntimeError: deactivate broke" in log
    assert log.count("Traceback") == log.count("RuntimeError: ")


def test_an_inactive_node_refuses_requests_and_says_what_to_do(probe: Start, observer: Any) -> None:
    process = probe()
    observer.until(lambda: "tick" in observer.heard, "a tick")
    assert observer.call(Trigger, "answer", Trigger.Request()).success
    assert observer.change("deactivate")
    answer = observer.call(Trigger, "answer", Trigger.Request())
    assert (answer.success, answer.message) == (False, "/probe is inactive: activate it first")
    assert observer.change("activate")
    assert observer.call(Trigger, "answer", Trigger.Request()).success
    assert observer.change("deactivate")
    assert observer.change("cleanup")
    observer.until(lambda: not observer.node.count_services("/probe/answer"), "the service to go")
    end(process)


@pytest.mark.parametrize("hook", ["configure!", "activate!"])
def test_an_autostart_that_fails_ends_with_2_and_the_reason(probe: Start, hook: str) -> None:
    process = probe(failing=hook)
    _, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert stderr.splitlines()[-1].endswith(f"{hook[:-1]}: repair this")
    assert "Traceback" not in stderr


def test_an_exception_in_a_callback_and_a_transition_it_has_not_are_logged_and_the_node_lives(
    probe: Start, observer: Any
) -> None:
    process = probe()
    # Heard both ways first: messages sent before the two have found each other are not kept for long.
    observer.until(lambda: "tick" in observer.heard, "ticks")
    observer.tell("raise")
    observer.tell("on")
    observer.until(lambda: "heard on" in observer.heard, "the echo")
    assert observer.state() == "active"
    assert not observer.change("configure")  # it is active
    observer.heard.clear()
    observer.until(lambda: "tick" in observer.heard, "a further tick")
    words, log = end(process)
    assert words == ["configure", "activate", "deactivate", "cleanup"]
    assert "RuntimeError: heard a word that breaks" in log
    assert log.count("a message could not be handled") == log.count("Traceback") == 1
    assert "transition refused" in log

"""Valves without ROS for the server's tests; nodes, a stand-in of a monitor and a browser for the others."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from spool_core.events.event import Event, EventState, Facts, Severity, Urgency
from spool_core.events.language import LANGUAGES
from spool_core.node import qos, testing
from spool_core.node.messages import to_event_message
from spool_core.opcua_folder import keep_operator, operators
from spool_core.uncertainty import Quantity as Measured
from spool_core.uncertainty import Validity
from spool_monitor.listener import HeardValve
from spool_msgs.msg import Alarm, AlarmList, ModelEstimate, Quantity, ValveHealth
from spool_view.acts import Act, Outcome
from spool_view.application import Application, application
from spool_view.operator import ActLog, Desk, OperatorToken
from starlette.testclient import TestClient

#: Fixtures that every package's tests of nodes have.
away_from_other_ros_programs = testing.away_from_other_ros_programs
claim_domain, domain_id = testing.claim_domain, testing.domain_id

#: s; what is waited for comes much sooner on an idle machine.
PATIENCE = 180.0
OWN = "http://127.0.0.1:8765"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip


def quantity(
    name: str, unit: str, value: float, deviation: float = 0.01, validity: int = Quantity.VALIDITY_VALID
) -> Quantity:
    return Quantity(name=name, unit=unit, value=value, standard_deviation=deviation, validity=validity)


def good_health(summary: str = "tracking, baseline learned", shakes: float = 21.0) -> ValveHealth:
    return ValveHealth(
        level=ValveHealth.LEVEL_OK,
        baseline=ValveHealth.BASELINE_FROZEN,
        summary=summary,
        judgements=["resonance: judged", "friction_drift: judged", "spring_change: judged"],
        dominant_frequency=quantity("dominant_frequency", "Hz", shakes),
        amplification=quantity("amplification", "1", 2.1),
        natural_frequency=quantity("natural_frequency", "Hz", 28.7),
    )


def tracking() -> ModelEstimate:
    return ModelEstimate(
        model="coulomb",
        state=ModelEstimate.STATE_TRACKING,
        parameters=[
            quantity("spring_stiffness", "N/m", 5860.0, 2.0),
            quantity("viscous_coefficient", "N s/m", 8.2, 0.1),
            quantity("coulomb_force", "N", 0.1, 0.005),
        ],
        natural_frequency=quantity("natural_frequency", "Hz", 28.7),
    )


def alarm(name: str = "resonance", note: str = "", comment: str = "") -> Alarm:
    one = Alarm(name=name, kind=name, code=100, state=Alarm.STATE_UNACKNOWLEDGED, severity=2, occurrence=3)
    amplification = Measured("amplification", "1", 4.2, validity=Validity.VALID)
    facts = replace(Facts.of(amplification, 3.6, note=note), urgency=Urgency.IMMEDIATE, advice=100)
    event = Event(
        1_790_000_000_000_000_000, name, EventState.RAISED, Severity.ALARM, "", amplification, "", 100, facts
    )
    one.event = to_event_message(event, "valve", LANGUAGES["en"])
    one.message, one.comment = one.event.message, comment
    one.raised_at.sec = 1_790_000_000
    return one


@dataclass
class Station:
    """A page's server without ROS, and the requests to the valves."""

    desk: Desk
    application: Application
    asked: list[Act]
    answers: Callable[[Act], Outcome]
    client: TestClient = field(init=False)

    def __post_init__(self) -> None:
        self.client = TestClient(
            self.application.asgi, base_url=OWN, client=("127.0.0.1", 50_000), follow_redirects=False
        )

    @property
    def token(self) -> str:
        assert self.desk.token is not None
        return self.desk.token.path.read_text("utf-8").strip()

    @property
    def log(self) -> str:
        assert self.desk.log is not None
        return self.desk.log.path.read_text("utf-8")

    def headers(self, **more: str) -> dict[str, str]:
        own = {"origin": OWN, "authorization": f"Bearer {self.token}"}
        return own | {name.replace("_", "-"): value for name, value in more.items()}


@pytest.fixture(autouse=True, scope="session")
def _on_this_machine_only() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield


@pytest.fixture
def make_station(tmp_path: Path) -> Iterator[Callable[..., Station]]:
    made: list[Station] = []

    def make(
        *,
        operator: bool = True,
        people: Mapping[str, str] | None = None,
        outcome: Outcome | None = None,
        spectrum: Callable[[list[bytes]], dict[str, Any] | None] = lambda _: None,
    ) -> Station:
        asked: list[Act] = []
        valve = HeardValve("valve_1", good_health(), time.monotonic(), alarms=AlarmList(alarms=[alarm()]))

        def do(act: Act) -> Future[Outcome]:
            asked.append(act)
            answer: Future[Outcome] = Future()
            answer.set_result(outcome or Outcome(True, act.alarm))
            return answer

        for name, password in (people or {}).items():
            keep_operator(tmp_path, name, password)
        desk = Desk(
            valves={"valve_1": valve},
            open=[],
            address="127.0.0.1",
            state_folder=tmp_path,
            spectrum=spectrum,
            do=do,
            token=OperatorToken(tmp_path / "web_page" / "token_8765", operators(tmp_path))
            if operator
            else None,
            log=ActLog(tmp_path / "web_page" / "operator_log.jsonl") if operator else None,
            warn=lambda _: None,
        )
        made.append(Station(desk, application(desk), asked, lambda _: Outcome(True, "")))
        return made[-1]

    yield make
    for one in made:
        if one.desk.log is not None:
            one.desk.log.close()


@pytest.fixture
def station(make_station: Callable[..., Station]) -> Station:
    return make_station()


def executable(package: str, name: str) -> str:
    prefixes = [Path(one) for one in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if one]
    found = [one / "lib" / package / name for one in prefixes if (one / "lib" / package / name).exists()]
    if not found:
        pytest.skip(f"{package} is not installed")
    return str(found[0])


class Domain:
    """Nodes as processes on a ROS domain of the test's own, and the page's address once it is served."""

    def __init__(self, number: int, folder: Path) -> None:
        self.number, self.folder = number, folder
        self.environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(number),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "XDG_STATE_HOME": str(folder / "state"),
            "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
        }
        self.running: list[subprocess.Popen[bytes]] = []

    def start(
        self, package: str, name: str, *arguments: str, **parameters: object
    ) -> subprocess.Popen[bytes]:
        words = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
        log = (self.folder / f"{len(self.running)}_{name}.log").open("wb")
        process = subprocess.Popen(
            [executable(package, name), "--ros-args", *arguments, *words],
            env=self.environment, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
        )  # fmt: skip
        log.close()
        self.running.append(process)
        return process

    def page(self, *, operator: bool = False, **parameters: object) -> tuple[subprocess.Popen[bytes], str]:
        """Start the page; return its process and address."""
        number = len(self.running)
        process = self.start("spool_view", "page", port=0, operator=str(operator).lower(), **parameters)
        log = self.folder / f"{number}_page.log"
        until(lambda: "page is at" in log.read_text("utf-8"), "the page is served")
        address = log.read_text("utf-8").partition("page is at ")[2].split()[0]
        return process, address

    @property
    def token(self) -> str:
        (file,) = (self.folder / "state" / "spool" / "web_page").glob("token_*")
        return file.read_text("utf-8").strip()

    @property
    def log(self) -> str:
        file = self.folder / "state" / "spool" / "web_page" / "operator_log.jsonl"
        return file.read_text("utf-8") if file.exists() else ""

    def close(self) -> None:
        for process in self.running:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in self.running:
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def until(met: Callable[[], Any], what: str, patience: float = PATIENCE) -> None:
    end = time.monotonic() + patience
    while not met():
        assert time.monotonic() < end, f"waited {patience:g} s in vain: {what}"
        time.sleep(0.02)


@pytest.fixture
def domain(domain_id: int, tmp_path: Path) -> Iterator[Domain]:
    made = Domain(domain_id, tmp_path)
    yield made
    made.close()


class StandIn:
    """A monitor and an estimator by what they publish: says once a second what it is set to publish."""

    def __init__(self, number: int, valve: str) -> None:
        self._ended = threading.Event()
        self.context = Context()
        rclpy.init(context=self.context, domain_id=number)
        self.node = Node("stand_in", namespace=f"/{valve}", context=self.context)
        self.health, self.estimate, self.alarms = good_health(), tracking(), AlarmList()
        self._publishers = {
            name: self.node.create_publisher(kind, name, qos.state())
            for name, kind in (("health", ValveHealth), ("estimate", ModelEstimate), ("alarms", AlarmList))
        }
        self.node.create_timer(1.0, self.say)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def say(self) -> None:
        for name, publisher in self._publishers.items():
            publisher.publish(getattr(self, name))

    def _spin(self) -> None:
        while not self._ended.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def close(self) -> None:
        if not self._ended.is_set():
            self._ended.set()
            self._thread.join(timeout=5.0)
            self._executor.shutdown()
            self.node.destroy_node()
            self.context.shutdown()


@pytest.fixture
def stand_in(domain_id: int) -> Iterator[Callable[[str], StandIn]]:
    made: list[StandIn] = []

    def make(valve: str = "valve_1") -> StandIn:
        made.append(StandIn(domain_id, valve))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture(scope="module")  # while it is open its event loop runs, beside which no other can
def chromium() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    with playwright.sync_playwright() as one:
        browser = one.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def open_page(chromium: Any) -> Iterator[Callable[..., Any]]:
    """Return what opens an address; a page that throws or logs an error fails the test."""
    contexts, wrong = [], []

    def make(address: str, *, width: int = 1280, height: int = 900, **options: Any) -> Any:
        context = chromium.new_context(viewport={"width": width, "height": height}, **options)
        context.set_default_timeout(1000 * PATIENCE)
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(address)
        return page

    yield make
    for context in contexts:
        context.close()
    assert wrong == []

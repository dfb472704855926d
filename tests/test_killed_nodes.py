"""kill -9 of any one node: the others live on and say what they miss; what comes back is taken up again."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticStatus
from spool_bag.reader import BagReader
from spool_msgs.msg import AccelerationBlock, HealthEvent, ModelEstimate, ValveHealth

if TYPE_CHECKING:
    from .conftest import Process, System, Topic


class Chain:
    """All four nodes, learned and recorded."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.nodes: dict[str, Process] = {}
        self.bag = Path()
        self.acceleration = system.listen(AccelerationBlock, "/valve_1/acceleration")
        self.estimate = system.listen(ModelEstimate, "/valve_1/estimate", latched=True)
        self.health = system.listen(ValveHealth, "/valve_1/health", latched=True)
        self.events = system.listen(HealthEvent, "/valve_1/events", latched=True)

    def start(self, name: str) -> None:
        """Start a node, the recorder with a new bag."""
        if name == "recorder":
            self.bag = self.system.folder / f"bag_{len(self.system.processes)}"
            self.nodes[name] = self.system.start(name, "", output=self.bag)
        elif name == "simulator":
            self.nodes[name] = self.system.start(name, excitation="multisine", wait_for_subscribers=4)
        else:
            self.nodes[name] = self.system.start(name)

    def complete(self) -> None:
        """Start what does not run, and wait until the chain works."""
        for name in ("recorder", "estimator", "monitor", "simulator"):
            if name not in self.nodes or not self.nodes[name].alive:
                self.start(name)
        self.system.until(
            lambda: self.system.node.count_subscribers("/valve_1/estimate") >= 3,
            "recorder, monitor and this test listen to the estimate",
        )
        heard = len(self.estimate.heard)
        self.system.until(
            lambda: (
                len(self.estimate.heard) >= heard + 3  # the recorder may hold the last second in memory
                and self.health.heard
                and self.health.last.level not in (ValveHealth.LEVEL_UNKNOWN, ValveHealth.LEVEL_STALE)
            ),
            "the chain works",
        )

    def hears(self, topic: Topic, wanted: Callable[..., bool], what: str, *, after: float) -> float:
        """Wait for the first ``wanted`` message ``after`` some arrival; return when it came."""
        self.system.until(lambda: topic.first(wanted, after=after), what)
        found = topic.first(wanted, after=after)
        assert found is not None
        return found.arrival

    def goes_on(self, *topics: Topic, count: int = 2) -> None:
        """Wait until each of ``topics`` brought more."""
        before = [len(topic.heard) for topic in topics]
        self.system.until(
            lambda: all(len(topic.heard) >= seen + count for topic, seen in zip(topics, before, strict=True)),
            "the others go on publishing",
        )

    def others_live(self, killed: str) -> None:
        assert [name for name, node in self.nodes.items() if not node.alive] == [killed]


@pytest.fixture(scope="module", name="one_chain")
def _one_chain(
    make_system: Callable[[Path], AbstractContextManager[System]], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Chain]:
    with make_system(tmp_path_factory.mktemp("chain")) as system:
        yield Chain(system)


@pytest.fixture(name="chain")
def _chain(one_chain: Chain) -> Chain:
    one_chain.complete()
    return one_chain


def is_stale(message: ModelEstimate | ValveHealth) -> bool:
    if isinstance(message, ModelEstimate):
        return bool(message.state == ModelEstimate.STATE_STALE)
    return bool(message.level == ValveHealth.LEVEL_STALE)


def raised(cause: str) -> Callable[[HealthEvent], bool]:
    return lambda event: (
        event.kind == "stale" and event.cause == cause and event.state == HealthEvent.STATE_RAISED
    )


def cleared(event: HealthEvent) -> bool:
    return bool(event.kind == "stale" and event.state == HealthEvent.STATE_CLEARED)


def expected_by_the_aggregator(*groups: str) -> set[str]:
    """Return the tasks whose silence the shipped configuration of the aggregator would show."""
    folder = Path(get_package_share_directory("spool_bringup"))
    content = yaml.safe_load((folder / "config" / "diagnostic_aggregator.yaml").read_text(encoding="utf-8"))
    analyzers = content["analyzers"]["ros__parameters"]
    return {task for group in groups for task in analyzers[group]["expected"]}


def test_recorder_killed(chain: Chain) -> None:
    """Its bag has each block since a simulator last began."""
    bag = chain.bag

    def recorded() -> list[int]:
        return [block.sequence for block in BagReader(bag).blocks("valve_1")]

    heard = chain.acceleration.last.sequence
    chain.system.until(lambda: recorded()[-1:] >= [heard], "the received messages are on the disk")
    chain.nodes["recorder"].kill()
    chain.goes_on(chain.acceleration, chain.estimate, chain.health)
    chain.others_live("recorder")
    reader = BagReader(bag)
    assert not reader.closed
    kept = recorded()
    begins = [place for place, number in enumerate(kept) if place == 0 or number < kept[place - 1]]
    last_run = kept[begins[-1] :]
    assert last_run == list(range(last_run[0], last_run[0] + len(last_run)))
    assert last_run[-1] >= heard
    assert reader.topics["/valve_1/estimate"].messages >= 1

    begin = time.monotonic()
    chain.start("recorder")
    chain.system.until(
        lambda: (
            any(
                status.level == DiagnosticStatus.OK
                for _, status in chain.system.statuses("recorder: recording", after=begin)
            )
            and chain.system.node.count_subscribers("/valve_1/acceleration") >= 4
        ),
        "a new recorder records what all others hear as well",
    )
    chain.goes_on(chain.estimate)
    # Subscriptions of the killed one are still counted for a while.
    wanted = {"/valve_1/acceleration", "/valve_1/valve"}

    def records_both() -> bool:
        return wanted <= {name for name, topic in BagReader(chain.bag).topics.items() if topic.messages}

    chain.system.until(records_both, "it records blocks and the valve")
    assert chain.nodes["recorder"].end() == 0
    found = BagReader(chain.bag)
    assert found.closed
    assert found.topics["/valve_1/acceleration"].messages > 0
    # Latched, so in every bag.
    assert found.topics["/valve_1/valve"].messages == 1


def test_simulator_killed(chain: Chain) -> None:
    killed = chain.nodes["simulator"].kill()
    chain.hears(chain.estimate, is_stale, "estimate stale", after=killed)
    chain.hears(chain.events, raised("acceleration"), "event stale", after=killed)
    chain.hears(chain.health, is_stale, "health stale", after=killed)
    chain.others_live("simulator")
    # A held estimate is no new one: its time is that of the last sample.
    assert chain.estimate.last.samples == chain.estimate.messages[-2].samples
    assert chain.estimate.last.header.stamp == chain.estimate.messages[-2].header.stamp

    chain.start("simulator")
    again = chain.hears(chain.events, cleared, "event cleared", after=killed)
    for topic in (chain.estimate, chain.health):
        chain.hears(topic, lambda message: not is_stale(message), "what comes after a restart", after=again)


def test_estimator_killed(chain: Chain) -> None:
    killed = chain.nodes["estimator"].kill()
    chain.hears(chain.events, raised("estimate"), "event stale", after=killed)
    chain.hears(chain.health, is_stale, "health stale", after=killed)
    chain.goes_on(chain.acceleration, chain.health)
    chain.others_live("estimator")

    chain.start("estimator")
    chain.hears(chain.events, cleared, "event cleared", after=killed)
    chain.system.until(lambda: not is_stale(chain.health.last), "health after a restart")


def test_monitor_killed(chain: Chain) -> None:
    killed = chain.nodes["monitor"].kill()
    chain.goes_on(chain.acceleration, chain.estimate)
    chain.others_live("monitor")
    # A dead monitor can't report its own end: the recorder does.
    task = "recorder: monitoring"
    chain.system.until(
        lambda: any(
            status.level == DiagnosticStatus.ERROR and status.message == "not monitored: valve_1"
            for _, status in chain.system.statuses(task, after=killed)
        ),
        "somebody misses the monitor",
    )
    assert chain.nodes["recorder"].said.count("valve_1 is not monitored") == 1
    before = len(chain.health.heard)
    chain.start("monitor")
    chain.system.until(
        lambda: len(chain.health.heard) > before and chain.health.last.level == ValveHealth.LEVEL_OK,
        "health after a restart",
    )
    chain.system.until(
        lambda: chain.system.statuses(task)[-1][1].level == DiagnosticStatus.OK, "the monitor is there again"
    )
    published = {status.name for one in chain.system.diagnostics.messages for status in one.status}
    assert expected_by_the_aggregator("valve_1", "recorder") <= published

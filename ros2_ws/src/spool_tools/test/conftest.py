from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from rclpy.serialization import serialize_message
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.writer import BagWriter
from spool_core.cdr import encode_block
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.messages import to_message
from spool_monitor.detectors import MonitorSettings
from spool_monitor.monitor import Monitor
from spool_monitor.monitor_node import to_health_message
from spool_report.records.record_sources import VALVE_DESCRIPTION, encode_valve
from spool_sim.excitation import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

START = 1_735_689_600_000_000_000


@dataclass(frozen=True)
class Recorded:
    """One valve of a bag that a test makes; ``begin`` and ``seconds`` in s, ``lost`` are sequences."""

    valve: str = "4weh10_soft"
    begin: float = 0.0
    seconds: float = 4.0
    described: bool = True
    analysed: bool = False
    lost: tuple[int, ...] = ()


@pytest.fixture(autouse=True, scope="session")
def _state_of_its_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Monitors must not find what earlier runs kept."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


MakeBag = Callable[[Path, Mapping[str, Recorded]], Path]


def _make_bag(path: Path, valves: Mapping[str, Recorded]) -> Path:
    with BagWriter(path) as writer:
        for name, recorded in valves.items():
            valve = find_valve(recorded.valve)
            start = START + round(recorded.begin * 1e9)
            sensor = Sensor(noise=0.02)
            simulator = Simulator(
                valve, PRESETS["multisine"], coulomb_force=0.3, start_stamp=start, body_sensor=sensor,
                spool_sensor=sensor,
            )  # fmt: skip
            if recorded.described:
                topic = writer.add_topic(f"/{name}/valve", VALVE_DESCRIPTION)
                writer.write(topic, start, encode_valve(valve, start))
            acceleration = writer.add_topic(f"/{name}/acceleration", ACCELERATION_BLOCK)
            if recorded.analysed:
                estimate_topic = writer.add_topic(f"/{name}/estimate", "spool_msgs/msg/ModelEstimate")
                health_topic = writer.add_topic(f"/{name}/health", "spool_msgs/msg/ValveHealth")
                # A monitor that waits for data reports by its own clock.
                early = replace(Monitor().health, stamp=START - 500_000_000)
                writer.write(health_topic, START, serialize_message(to_health_message(early, valve.id)))
            estimator = Estimator(settings_for(valve))
            monitor = Monitor(MonitorSettings(natural_frequency=valve.natural_frequency))
            for block in simulator.records(recorded.seconds):
                if block.sequence in recorded.lost:
                    continue
                writer.write(
                    acceleration, block.stamp, encode_block(block, valve.id), sequence=block.sequence
                )
                if not recorded.analysed:
                    continue
                monitor.update(block)
                for estimate in estimator.update(block):
                    monitor.update_estimate(estimate)
                    message = serialize_message(to_message(estimate, valve.id))
                    writer.write(estimate_topic, estimate.stamp, message)
                    message = serialize_message(to_health_message(monitor.health, valve.id))
                    writer.write(health_topic, estimate.stamp, message)
    return path


@pytest.fixture
def make_bag() -> MakeBag:
    """Return what writes a bag of simulated valves."""
    return _make_bag


@pytest.fixture
def recorded() -> type[Recorded]:
    """Return the class that says what a valve of a bag is to be."""
    return Recorded

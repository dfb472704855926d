"""Numbers for plotters; envelope of a waveform: no peak is lost, and nothing is made up over a gap."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from spool_core.block import Block
from spool_core.node import qos
from spool_core.node.messages import from_block, nanoseconds
from spool_msgs.msg import ModelEstimate, PlotValue, Quantity, ValveHealth, WaveformEnvelope
from spool_view.plots_node import Envelope, PlotsNode


@given(st.lists(st.integers(1, 57), min_size=1, max_size=12), st.integers(1, 40))
def test_however_samples_are_cut_into_blocks_bounds_are_those_of_the_intervals(
    sizes: list[int], width: int
) -> None:
    draw = np.random.default_rng(sum(sizes))
    rows = draw.standard_normal((2, sum(sizes))).astype(np.float32)
    envelope = Envelope(1000.0 / width)
    found, begin = [], 0
    for number, size in enumerate(sizes):
        part = rows[:, begin : begin + size]
        stamp = 10**18 + begin * 10**6
        found += envelope.update(Block(stamp, number, 1e-3, part[0], part[1], "v"))
        begin += size
    assert len(found) == sum(sizes) // width
    for number, point in enumerate(found):
        part = rows[:, number * width : (number + 1) * width]
        assert point.body == (part[0].min(), part[0].max())
        assert point.spool == (part[1].min(), part[1].max())
        assert point.stamp == 10**18 + number * width * 10**6


def test_an_interval_that_a_lost_block_cuts_is_left_out() -> None:
    envelope = Envelope(100.0)
    row = np.ones(15, dtype=np.float32)
    first = envelope.update(Block(10**18, 0, 1e-3, row, row, "v"))
    after = envelope.update(Block(10**18 + 10**9, 5, 1e-3, row, row, "v"))
    assert [point.stamp for point in first] == [10**18]
    assert [point.stamp for point in after] == [10**18 + 10**9]


#: Numbers of an estimate and of a health message by the names of their fields: value and standard deviation.
ESTIMATE = {
    "natural_frequency": (28.0, 1.0), "damping_ratio": (0.3, 0.02), "residual": (0.04, 0.003),
    "excitation": (5.0, 0.4), "relative_displacement": (6e-4, 5e-5), "oil_temperature": (70.0, 6.0),
}  # fmt: skip
HEALTH = {
    "viscous_drift": (0.8, 0.07), "coulomb_drift": (0.9, 0.08), "dominant_frequency": (10.0, 0.9),
    "amplification": (1.1, 0.1),
}  # fmt: skip


def quantities(values: dict[str, tuple[float, float]]) -> dict[str, Quantity]:
    return {
        name: Quantity(
            name=name, unit=f"unit of {name}", value=value, standard_deviation=deviation, validity=1
        )
        for name, (value, deviation) in values.items()
    }


@pytest.fixture(name="heard", scope="module")
def _heard() -> Iterator[dict[str, list[Any]]]:
    """Return what the node publishes of an estimate, a health message and two seconds of a block."""
    rclpy.init()
    node, other = PlotsNode(), rclpy.create_node("other")
    node.alone = False
    assert [one.name for one in node.PARAMETERS] == ["waveform_rate"]
    node.set_parameters([Parameter("waveform_rate", value=4.0)])
    assert node.trigger_configure() == node.trigger_activate()
    estimate = ModelEstimate(
        parameters=[*quantities({"mass": (0.2, 0.01), "stiffness": (1700.0, 20.0)}).values()],
        **quantities(ESTIMATE),
    )
    health = ValveHealth(**quantities(HEALTH))
    rows = np.arange(8, dtype=np.float32), 100.0 + np.arange(8, dtype=np.float32)
    block = from_block(Block(7 * 10**9, 0, 0.125, *rows), "press 7")
    found: dict[str, list[Any]] = {}
    sent = []
    for topic, message, stamp, quality in (
        ("estimate", estimate, 5, qos.state()),
        ("health", health, 6, qos.state()),
        ("acceleration", block, 7, qos.profile(10, reliable=True)),
    ):
        message.header.stamp, message.header.frame_id = Time(sec=stamp), f"valve of {topic}"
        sent.append((other.create_publisher(type(message), topic, quality), message))
    names = ("mass", "stiffness", *ESTIMATE, *HEALTH)
    for name, kind in (*((name, PlotValue) for name in names), ("waveform", WaveformEnvelope)):
        found[name] = []
        other.create_subscription(kind, f"plot/{name}", found[name].append, qos.profile(10, reliable=True))
    executor = SingleThreadedExecutor()
    for one in (node, other):
        executor.add_node(one)
    end = time.monotonic() + 180.0
    while not all(found.values()) or len(found["waveform"]) < 4:
        assert time.monotonic() < end, [name for name, messages in found.items() if not messages]
        block.sequence += 1
        for publisher, message in sent:
            publisher.publish(message)
        for _ in range(40):  # all that comes of them
            executor.spin_once(timeout_sec=0.005)
    yield found
    executor.shutdown()
    node.trigger_shutdown()
    for one in (node, other):
        one.destroy_node()
    rclpy.shutdown()


def test_each_number_comes_on_a_topic_of_its_own_with_its_interval_unit_and_stamp(
    heard: dict[str, list[Any]],
) -> None:
    values = {"mass": (0.2, 0.01), "stiffness": (1700.0, 20.0), **ESTIMATE, **HEALTH}
    for name, (value, deviation) in values.items():
        one = heard[name][0]
        half = 1.96 * deviation
        assert (one.low, one.value, one.high) == pytest.approx((value - half, value, value + half), rel=1e-4)
        source, stamp = ("health", 6) if name in HEALTH else ("estimate", 5)
        assert (one.unit, one.header.frame_id, one.header.stamp.sec) == (
            f"unit of {name}", f"valve of {source}", stamp,
        )  # fmt: skip


def test_the_envelope_has_as_many_points_a_second_as_are_asked_for(heard: dict[str, list[Any]]) -> None:
    fields = ("body_low", "body_high", "spool_low", "spool_high")
    points = {  # of the same block, several times
        nanoseconds(one.header.stamp): (one.header.frame_id, [getattr(one, name) for name in fields])
        for one in heard["waveform"]
    }
    assert points == {
        (28 + n) * 250_000_000: ("valve of acceleration", [2 * n, 2 * n + 1, 100 + 2 * n, 101 + 2 * n])
        for n in range(4)
    }

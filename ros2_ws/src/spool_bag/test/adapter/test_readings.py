"""Samples out of messages: axis, sign, unit, time; what is no sample says why."""

from __future__ import annotations

import math

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import AccelStamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu
from spool_bag.adapter_node import ACCEL, ARRAY, IMU, LEASE, Gravity, Reading, SensorReport, UnusableError
from spool_core.aligner import Aligner, AlignerSettings, Channel
from spool_core.node.diagnostics import Level
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

STAMP = 3_000_000_004


def imu(frame: str = "imu") -> Imu:
    message = Imu()
    message.header.stamp = Time(sec=3, nanosec=4)
    message.header.frame_id = frame
    message.linear_acceleration.x = 1.0
    message.linear_acceleration.y = 2.0
    message.linear_acceleration.z = 3.0
    return message


@pytest.mark.parametrize(
    ("axis", "unit", "gain", "value"),
    [
        ("+x", "m/s^2", 1.0, 1.0),
        ("x", "m/s^2", 1.0, 1.0),
        ("-y", "m/s^2", 1.0, -2.0),
        ("+z", "g", 1.0, 3.0 * 9.80665),
        ("-z", "g", 0.5, -1.5 * 9.80665),
    ],
)
def test_axis_sign_unit_and_gain_of_an_imu(axis: str, unit: str, gain: float, value: float) -> None:
    data = serialize_message(imu())
    assert Reading(IMU, axis, unit, gain).samples(data, 7) == [(STAMP, pytest.approx(value))]
    assert Reading(IMU, axis, unit, gain, by_arrival=True).samples(data, 7)[0][0] == 7


def test_accel_stamped_holds_its_vector_a_level_deeper() -> None:
    message = AccelStamped()
    message.header.stamp = Time(sec=3, nanosec=4)
    message.accel.linear.z = 3.0
    assert Reading(ACCEL, "-z").samples(serialize_message(message), 0) == [(STAMP, -3.0)]


def test_only_the_frame_that_is_asked_for() -> None:
    with pytest.raises(UnusableError, match="frame_id is 'other', not 'imu'"):
        Reading(IMU, "+x", frame="imu").samples(serialize_message(imu("other")), 0)


def test_an_imu_that_measures_no_acceleration_is_none() -> None:
    message = imu()
    message.linear_acceleration_covariance[0] = -1.0
    with pytest.raises(UnusableError, match="measures no acceleration"):
        Reading(IMU, "+x").samples(serialize_message(message), 0)


def test_more_than_a_second_of_nanoseconds_is_no_time() -> None:
    message = imu()
    message.header.stamp.nanosec = 2_000_000_000
    assert Reading(IMU, "+x").samples(serialize_message(message), 9) == [(0, 1.0)]


def array(rows: list[list[float]], offset: int = 0) -> Float64MultiArray:
    columns = len(rows[0])
    dimensions = [
        MultiArrayDimension(label="samples", size=len(rows), stride=len(rows) * columns),
        MultiArrayDimension(label="channels", size=columns, stride=columns),
    ]
    data = [math.nan] * offset + [value for row in rows for value in row]
    return Float64MultiArray(layout=MultiArrayLayout(dim=dimensions, data_offset=offset), data=data)


@pytest.mark.parametrize("offset", [0, 3])
def test_rows_of_an_array_are_samples_that_end_at_its_arrival(offset: int) -> None:
    message = array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]], offset)
    found = Reading(ARRAY, "-column1", sample_rate=1000.0).samples(serialize_message(message), 10_000_000)
    assert found == [(8_000_000, -10.0), (9_000_000, -20.0), (10_000_000, -30.0)]
    with pytest.raises(UnusableError, match="set sample_rate, or time_column"):
        Reading(ARRAY, "+column1").samples(serialize_message(message), 10_000_000)


def test_a_column_of_time_is_the_stamp_and_no_number_is_no_time() -> None:
    message = array([[1.5, 10.0], [math.nan, 20.0], [math.inf, 30.0], [1e300, 40.0]])
    found = Reading(ARRAY, "+column1", time_column=0).samples(serialize_message(message), 1)
    assert found == [(1_500_000_000, 10.0), (0, 20.0), (0, 30.0), (0, 40.0)]


@pytest.mark.parametrize("data", [[], [1.0, 2.0, 3.0]])
def test_what_is_no_whole_number_of_rows_or_lacks_the_column_is_refused(data: list[float]) -> None:
    message = array([[1.0, 2.0]])
    message.data = data
    with pytest.raises(UnusableError):
        Reading(ARRAY, "+column1").samples(serialize_message(message), 1)
    with pytest.raises(UnusableError, match="no column 4"):
        Reading(ARRAY, "+column4").samples(serialize_message(Float64MultiArray(data=[1.0, 2.0])), 1)


@pytest.mark.parametrize(
    ("kind", "axis"),
    [(IMU, "q"), (IMU, "+column0"), (ACCEL, ""), (ARRAY, "+x"), (ARRAY, "column"), (ARRAY, "0")],
)
def test_an_axis_that_a_type_does_not_have_is_refused_with_those_it_has(kind: str, axis: str) -> None:
    refusal = Reading(kind, axis).refusal()
    assert refusal is not None
    assert refusal.startswith(f"{axis!r} is no axis of {kind}: write ")


@pytest.mark.parametrize(
    ("burst", "seconds", "named"),
    [(True, 0.25, True), (False, 0.25, False), (False, LEASE + 1.0, True)],
    ids=["bursts", "restarted driver", "for good"],
)
def test_two_publishers_on_one_topic_are_named_as_the_cause(burst: bool, seconds: float, named: bool) -> None:
    aligner = Aligner(AlignerSettings())
    report = SensorReport({Channel.BODY: "/body/imu", Channel.SPOOL: "/spool/imu"}, 1.0)
    for at in range(2000):
        stamp = 1_000_000_000_000 + at * 5_000_000
        aligner.update(Channel.BODY, stamp, math.sin(at))
        if burst:
            aligner.update(Channel.BODY, stamp + 700_000, math.sin(at))
        aligner.update(Channel.SPOOL, stamp, math.cos(at))
    report.silent = dict.fromkeys(Channel, 0.0)
    report.count_publishers({Channel.BODY: 2, Channel.SPOOL: 1}, seconds)
    status = report.status(aligner, 1_010_000_000_000)
    assert ("body: 2 publishers on /body/imu" in status.message) == named
    assert (status.level is Level.ERROR) == named
    report.count_publishers({Channel.BODY: 1, Channel.SPOOL: 1}, seconds)
    assert "publishers on" not in report.status(aligner, 1_010_000_000_000).message


@pytest.mark.parametrize(
    ("unit", "shown", "other"),
    [("m/s^2", 1.02, "g"), ("m/s^2", 9.81, ""), ("g", 9.7, "m/s^2"), ("g", 1.0, ""), ("m/s^2", 0.0, "")],
)
def test_gravity_shows_a_unit_that_is_not_the_one_set(unit: str, shown: float, other: str) -> None:
    gravity = Gravity(unit)
    samples = Reading(IMU, "+x", unit, gravity=gravity).samples
    for at in range(1000):
        message = imu()
        message.linear_acceleration.x = 5.0 * math.sin(at)
        message.linear_acceleration.y = 0.0
        message.linear_acceleration.z = shown
        samples(serialize_message(message), 0)
    assert gravity.other_unit == other

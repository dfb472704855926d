"""Which fault keeps which other from being judged: the one table of that, by the names of conditions.

A name stands for all conditions that begin with it. What no row lists is judged while the other fault lasts.
"""

from __future__ import annotations

from typing import NamedTuple

from spool_monitor.event import EACH_CHANNEL

DEAD, CLIPPING, OFFSET = (f"sensor_fault/sensor_{one}" for one in ("dead", "clipping", "offset"))
SWAPPED, SCALE = "sensor_fault/sensor_swapped", "sensor_fault/sensor_scale"
SAME, WRAP = "sensor_fault/sensor_same_channel", "sensor_fault/sensor_wrap_around"
SENSITIVITY, AC_COUPLING = "sensor_fault/sensor_sensitivity", "sensor_fault/sensor_ac_coupling"
REPEATS, OUTLIERS = "data_fault/data_repeats", "data_fault/outliers"
CLOCKS = ("data_fault/data_clock_step", "data_fault/data_clock_drift")

#: Faults of the valve that the estimated parameters show, and those that need both channels as they are.
PARAMETERS = ("friction_drift", "spring_change", "model_gap")
VALVE = ("resonance", "stuck_spool", *PARAMETERS)
#: What one channel shows of the other, and what is needed to compare their sizes.
PAIR = (SENSITIVITY, AC_COUPLING, *CLOCKS)
COMPARED = (*PAIR, SWAPPED, SCALE)


class Row(NamedTuple):
    """Row of the table: while a fault of ``by`` lasts, those of ``what`` are not judged, and ``why``."""

    by: tuple[str, ...]
    what: tuple[str, ...]
    why: str


TABLE: tuple[Row, ...] = (
    Row(
        ("stale/acceleration",), (*VALVE, "sensor_fault", "data_fault", "stale/estimate"), "No blocks arrive."
    ),
    Row(
        ("data_fault/rate", "data_fault/clock_step"),
        (
            *(*VALVE, "sensor_fault", "stale/estimate", OUTLIERS, REPEATS, *CLOCKS),
            *("data_fault/estimate", "data_fault/lost", "data_fault/source/second"),
        ),
        "No block can be used.",
    ),
    Row(
        ("stale/estimate",),
        (*PARAMETERS, SCALE, CLOCKS[0], "data_fault/estimate"),
        "Nobody estimates the parameters, and it is the estimates that point to a step.",
    ),
    Row(
        (SAME,),
        (DEAD, CLIPPING, OFFSET, WRAP, REPEATS, OUTLIERS, *COMPARED, *VALVE),
        "Both channels carry one sensor, so nothing is known of the other one.",
    ),
    Row(
        (WRAP,),
        (DEAD, CLIPPING, OFFSET, REPEATS, *COMPARED, *VALVE),
        "Samples are wrong by whole ranges of the converter.",
    ),
    Row((REPEATS,), (DEAD, CLIPPING, *COMPARED, *VALVE), "Samples are not of the time that they name."),
    Row((DEAD,), (SAME, OFFSET, *COMPARED, *VALVE), "The channel shows nothing to compare the other with."),
    Row((CLIPPING,), (WRAP, OFFSET, *COMPARED, *VALVE), "Peaks are missing, so sizes and means are wrong."),
    Row((OFFSET,), (OFFSET,), "An offset of the other channel too looks like a machine that is tilted."),
    Row((SENSITIVITY, SCALE, SWAPPED), (*COMPARED, *VALVE), "The sizes of both channels do not compare."),
    Row(
        (AC_COUPLING, *CLOCKS),
        (*COMPARED, "stuck_spool", *PARAMETERS),
        "The delay between both channels is wrong; the size of a single line is not.",
    ),
    Row(("stuck_spool",), (*COMPARED, *VALVE), "The spool moves with its body and shows no response."),
    Row(("spring_change",), ("resonance",), "A line that only the other stiffness brings near is no news."),
    *(
        Row((f"{by}/{channel}",), tuple(f"{one}/{channel}" for one in what), why)
        for channel in EACH_CHANNEL
        for by, what, why in (
            (DEAD, (CLIPPING, WRAP, REPEATS, OUTLIERS), "The channel shows nothing."),
            (REPEATS, (WRAP,), "Repeated samples hide the jumps of a wrap-around."),
            (OUTLIERS, (WRAP,), "Samples that are left out hide the jumps of a wrap-around."),
        )
    ),
)


def unknowable(fault: str, by: str) -> bool:
    """Return whether the condition ``fault`` is not judged while the condition ``by`` lasts."""
    return fault != by and any(_lists(row.by, by) and _lists(row.what, fault) for row in TABLE)


def _lists(names: tuple[str, ...], name: str) -> bool:
    return any(f"{name}/".startswith(f"{one}/") for one in names)

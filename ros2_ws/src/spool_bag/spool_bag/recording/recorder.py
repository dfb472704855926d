"""Recorder without ROS: which topics belong to the valves, and which blocks were lost."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path

from spool_core.cdr import CdrError, block_sequence, header_stamp
from spool_core.errors import InputError

from spool_bag.format.definitions import ACCELERATION_BLOCK, TEMPERATURE

DIAGNOSTICS = "/diagnostics"
#: Changes of limits belong to what was judged by them.
PARAMETER_EVENTS = "/parameter_events"
TOPICS = {
    "acceleration": ACCELERATION_BLOCK,
    "estimate": "spool_msgs/msg/ModelEstimate",
    "health": "spool_msgs/msg/ValveHealth",
    "events": "spool_msgs/msg/HealthEvent",
    "valve": "spool_msgs/msg/ValveDescription",
    "refit": "spool_msgs/msg/WindowRefit",
    "gap": "spool_msgs/msg/GapAnalysis",
    "oil_temperature": TEMPERATURE,
}
#: Topics that the suite's nodes offer latched.
LATCHED = ("estimate", "health", "events", "valve", "refit", "gap")
#: What makes a namespace a valve; an oil temperature alone may be anybody's.
MARKS = ("acceleration", "estimate", "health", "events")


def valve_namespaces(graph: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the namespaces (``/valve_1``) in which a topic of ours with our type lives.

    ``graph`` holds the types by topic, as ROS 2 tells them.
    """
    found = set()
    for topic, types in graph.items():
        namespace, _, name = topic.rpartition("/")
        if name in MARKS and TOPICS[name] in types:
            found.add(namespace)
    return sorted(found)


def select_topics(graph: Mapping[str, Sequence[str]], valves: Sequence[str] = ()) -> dict[str, str]:
    """Return the type by topic of everything to be recorded.

    That is every visible topic in the namespaces of the valves (``valves`` without leading slash, or those
    found where it is empty), ``/diagnostics`` and ``/parameter_events``. The topics of named valves belong to
    it before anybody publishes on them, so that not one block is missed. A topic with several types is left
    out.
    """
    namespaces = [f"/{valve.strip('/')}" for valve in valves] or valve_namespaces(graph)
    chosen = {
        f"{namespace}/{name}": kind for namespace in namespaces for name, kind in TOPICS.items() if valves
    }
    for topic, types in graph.items():
        hidden = any(part.startswith("_") for part in topic.split("/"))
        if hidden or len(types) != 1:
            continue
        # Everything would be inside the root: of a valve without namespace only the known topics count.
        inside = any(
            topic.startswith(f"{namespace}/") if namespace else topic.lstrip("/") in TOPICS
            for namespace in namespaces
        )
        if topic in (DIAGNOSTICS, PARAMETER_EVENTS) or inside:
            chosen[topic] = types[0]
    return dict(sorted(chosen.items()))


#: Times the blocks that fit into the time that the stamps say went by, and blocks on top, that can be lost:
#: clocks and block lengths vary, but not by more.
LIKELY, SLACK = 3.0, 100.0


@dataclass(slots=True)
class _LastBlock:
    sequence: int
    stamp: int
    step: float = math.nan


@dataclass(slots=True)
class LossCount:
    """Loss count: blocks that never arrived, by topic, from jumps in ``sequence``.

    A jump that is far beyond what the stamps say went by is a wrong number, not a loss. Where the next block
    goes on from there it is another source, of which nothing is lost.
    """

    lost: dict[str, int] = field(default_factory=dict)
    _last: dict[str, _LastBlock] = field(default_factory=dict)
    _doubted: dict[str, int] = field(default_factory=dict)

    def see(self, topic: str, data: bytes) -> None:
        """Take note of the CDR of a block; bytes that are none are left to the reader to judge."""
        try:
            sequence, stamp = block_sequence(data), header_stamp(data)
        except CdrError:
            return
        self.lost.setdefault(topic, 0)
        last = self._last.get(topic)
        if last is None:
            self._last[topic] = _LastBlock(sequence, stamp)
            return
        jump = sequence - last.sequence - 1
        if jump > self._likely(last, stamp):
            if self._doubted.get(topic) != sequence - 1:
                self._doubted[topic] = sequence
                return
            jump = 0
        self._doubted.pop(topic, None)
        self.lost[topic] += max(jump, 0)
        step = float(stamp - last.stamp) if jump == 0 and stamp > last.stamp else last.step
        self._last[topic] = _LastBlock(sequence, stamp, step)

    @staticmethod
    def _likely(last: _LastBlock, stamp: int) -> float:
        """Return how many blocks can have been lost since ``last``."""
        if math.isnan(last.step):
            return SLACK
        return SLACK + LIKELY * max(stamp - last.stamp, 0) / last.step


def new_bag(
    output: str,
    now: datetime | None = None,
    activation: int = 0,
    *,
    number: bool = False,
    resume: bool = False,
) -> Path:
    """Return where to record: ``output``, or ``recording_<UTC time>`` in the working directory.

    From the second ``activation`` (1) on a number is put behind ``output``; with ``number`` also where the
    place is taken, the first one that is free. With ``resume`` it is ``output``, whatever is there.

    Raises:
        InputError: the place is taken.
    """
    moment = now or datetime.now(timezone.utc)
    name = output or f"recording_{moment:%Y%m%dT%H%M%S}Z"
    if resume and output:
        return Path(name).expanduser()
    path = Path(name if activation == 0 else f"{name.rstrip('/')}_{activation}").expanduser()
    while number and path.exists():
        activation += 1
        path = Path(f"{name.rstrip('/')}_{activation}").expanduser()
    if path.exists():
        raise InputError(f"output: {path} exists already: name a bag that does not, or remove it")
    return path


def free_space(path: Path) -> int:
    """Return the free bytes on the file system of ``path``."""
    return shutil.disk_usage(path).free

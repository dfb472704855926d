"""What a bag holds and what was lost on the way into it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spool_stream.block import Block
from spool_stream.block_gate import BlockGate, Verdict

from .mcap_file import Damage
from .reader import BagReader


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """One topic; ``rate`` in 1/s over the bag's duration, ``None`` where that is not known."""

    name: str
    type: str
    messages: int
    rate: float | None


@dataclass(frozen=True, slots=True)
class ValveSummary:
    """The accelerations of one valve.

    ``sample_rate`` in Hz and ``first_stamp`` and ``end_stamp`` in ns are those of the usable blocks, ``None``
    without any; ``lost_blocks`` come from jumps in ``sequence``; ``refused_blocks`` are malformed; ``faults``
    counts each kind by its text.
    """

    name: str
    blocks: int
    samples: int
    sample_rate: float | None
    lost_blocks: int
    refused_blocks: int
    first_stamp: int | None
    end_stamp: int | None
    temperatures: int
    faults: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class BagInformation:
    """A bag as a whole: ``size`` in bytes, ``duration`` in s by acquisition time, stamps in ns."""

    path: Path
    size: int
    closed: bool
    duration: float | None
    first_stamp: int | None
    topics: tuple[TopicSummary, ...]
    valves: tuple[ValveSummary, ...]
    damages: tuple[Damage, ...]
    warnings: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return what ``--json`` writes; units stand in the keys."""
        return {
            "bag": str(self.path),
            "size_bytes": self.size,
            "closed": self.closed,
            "duration_s": self.duration,
            "first_stamp_ns": self.first_stamp,
            "topics": [
                {
                    "name": topic.name,
                    "type": topic.type,
                    "messages": topic.messages,
                    "rate_per_s": topic.rate,
                }
                for topic in self.topics
            ],
            "valves": {valve.name: _valve_dict(valve) for valve in self.valves},
            "damages": [
                {"offset_bytes": damage.offset, "size_bytes": damage.size, "reason": damage.reason}
                for damage in self.damages
            ],
            "warnings": list(self.warnings),
        }


def describe(path: Path | str) -> BagInformation:
    """Read the bag at ``path`` through and return what is in it; damage is listed, not raised.

    Raises:
        InputError: there is no bag at ``path``.
    """
    reader = BagReader(path, skip_damage=True)
    valves = tuple(_valve(reader, name) for name in reader.valves)
    first = min((valve.first_stamp for valve in valves if valve.first_stamp is not None), default=None)
    end = max((valve.end_stamp for valve in valves if valve.end_stamp is not None), default=None)
    if first is None or end is None:
        for _, record in reader.records():
            first = record.log_time if first is None else min(first, record.log_time)
            end = record.log_time if end is None else max(end, record.log_time)
    duration = (end - first) / 1e9 if first is not None and end is not None else None
    topics = tuple(
        TopicSummary(name, topic.type, topic.messages, topic.messages / duration if duration else None)
        for name, topic in reader.topics.items()
    )
    size = sum(file.path.stat().st_size for file in reader.files)
    return BagInformation(
        Path(path),
        size,
        reader.closed,
        duration,
        first,
        topics,
        valves,
        tuple(reader.damages),
        tuple(reader.warnings),
    )


def _valve(reader: BagReader, name: str) -> ValveSummary:
    gate = BlockGate()
    samples = temperatures = 0
    first: int | None = None
    end: int | None = None
    rate: float | None = None
    for item in reader.stream(name):
        if not isinstance(item, Block):
            temperatures += 1
        elif gate.judge(item) is not Verdict.REFUSED:
            samples += item.body.size
            first = item.stamp if first is None else min(first, item.stamp)
            end = item.end if end is None else max(end, item.end)
            rate = 1.0 / item.sample_period
    return ValveSummary(
        name,
        gate.accepted + gate.refused,
        samples,
        rate,
        gate.lost,
        gate.refused,
        first,
        end,
        temperatures,
        {fault.value: count for fault, count in gate.faults.items()},
    )


def _valve_dict(valve: ValveSummary) -> dict[str, Any]:
    content = asdict(valve)
    del content["name"]
    for name, unit in (("sample_rate", "Hz"), ("first_stamp", "ns"), ("end_stamp", "ns")):
        content[f"{name}_{unit}"] = content.pop(name)
    return content

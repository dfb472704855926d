"""Topics of an MCAP file, from its schemas and channels, within bounds."""

from __future__ import annotations

from dataclasses import dataclass, field
from io import BytesIO
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics

from .mcap_record import FRAME

#: B of one definition and of all of a file; the longest of ROS 2's own, with its dependencies, have 50 kB.
LARGEST_DEFINITION = 1 << 18
MOST_DEFINITIONS = 1 << 24


@dataclass(frozen=True, slots=True)
class Topic:
    """Topic: what a channel carries."""

    name: str
    type: str
    schema: str
    schema_encoding: str
    encoding: str
    qos: str
    digest: str


class _Schema(NamedTuple):
    name: str
    text: str
    encoding: str


@dataclass(slots=True)
class Definitions:
    """Definitions: topics by channel number; writers repeat them, which costs a comparison only."""

    topics: dict[int, Topic] = field(default_factory=dict)
    _schemas: dict[int, _Schema] = field(default_factory=dict)
    _known: dict[tuple[int, bytes], bytes] = field(default_factory=dict)
    _size: int = 0

    def take(self, opcode: int, content: bytes) -> None:
        """Take the ``content`` of a schema or channel.

        Raises:
            ValueError: not one, or more than the bounds.
            mcap.exceptions.McapError: it ends too early.
        """
        key = (opcode, content[:2])
        if self._known.get(key) == content:
            return
        if len(content) > LARGEST_DEFINITION or self._size + len(content) > MOST_DEFINITIONS:
            raise ValueError(
                f"a definition of more than {LARGEST_DEFINITION} bytes, or {MOST_DEFINITIONS} bytes of them"
            )
        self._size += len(content)
        stream = ReadDataStream(BytesIO(content))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._schemas[schema.id] = _Schema(
                schema.name, schema.data.decode("utf-8", "replace"), schema.encoding
            )
        else:
            self._add(Channel.read(stream))
        self._known[key] = content

    def _add(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id) or _Schema("", "", "")
        about = channel.metadata
        qos, digest = about.get("offered_qos_profiles", ""), about.get("topic_type_hash", "")
        self.topics[channel.id] = Topic(
            channel.topic, *schema, encoding=channel.message_encoding, qos=qos, digest=digest
        )


def summary_counts(summary: bytes, definitions: Definitions) -> tuple[dict[int, int], tuple[int, int]] | None:
    """Return messages by channel and first and last time (ns) that a summary tells; add what it defines.

    ``None`` where it has no statistics.

    Raises:
        ValueError, struct.error, mcap.exceptions.McapError: the section is damaged.
    """
    counts: tuple[dict[int, int], tuple[int, int]] | None = None
    at = 0
    while at < len(summary):
        opcode, length = FRAME.unpack_from(summary, at)
        at += FRAME.size
        if at + length > len(summary):
            raise ValueError("a record of the summary is cut off")
        content = summary[at : at + length]
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.take(opcode, content)
        elif opcode == Opcode.STATISTICS:
            told = Statistics.read(ReadDataStream(BytesIO(content)))
            times = told.message_start_time, told.message_end_time
            counts = dict(told.channel_message_counts), times
        at += length
    return counts

"""Chunks that explain themselves: each holds the definitions of the messages in it.

A file then loses nothing but the chunk that is damaged, even if it is the first one. Definitions may be
repeated (MCAP specification, "Channel": identical records with the same id).
"""

from __future__ import annotations

from mcap._chunk_builder import ChunkBuilder
from mcap.records import Channel, Message, Schema
from mcap.writer import Writer


class RepeatingChunks(ChunkBuilder):
    """Put the schema and channel of a message into the chunk before its first message there."""

    def __init__(self) -> None:
        super().__init__()
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._here: set[tuple[str, int]] = set()

    def add_schema(self, schema: Schema) -> None:
        """Take note of a schema."""
        self._schemas[schema.id] = schema

    def add_channel(self, channel: Channel) -> None:
        """Take note of a channel."""
        self._channels[channel.id] = channel

    def add_message(self, message: Message) -> None:
        """Add a message, behind its definitions where they are not yet in this chunk."""
        if ("channel", message.channel_id) not in self._here:
            self._define(self._channels[message.channel_id])
        super().add_message(message)

    def reset(self) -> None:
        """Begin the next chunk."""
        super().reset()  # type: ignore[no-untyped-call]
        self._here.clear()

    def _define(self, channel: Channel) -> None:
        if channel.schema_id and ("schema", channel.schema_id) not in self._here:
            super().add_schema(self._schemas[channel.schema_id])
            self._here.add(("schema", channel.schema_id))
        super().add_channel(channel)
        self._here.add(("channel", channel.id))


def repeat_definitions(writer: Writer) -> None:
    """Let ``writer``, which has written nothing yet, make chunks that explain themselves."""
    assert hasattr(writer, "_Writer__chunk_builder"), "mcap has changed: see RepeatingChunks"
    writer._Writer__chunk_builder = RepeatingChunks()

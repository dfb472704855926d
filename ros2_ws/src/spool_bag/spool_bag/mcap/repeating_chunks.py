"""Repeated definitions: a lost chunk does not take them with it, later ones hold them again.

A file then loses nothing but the chunk that is damaged, even if it is the first one. Definitions may be
repeated (MCAP specification, "Channel": identical records with the same id).
"""

from __future__ import annotations

from mcap._chunk_builder import ChunkBuilder
from mcap.records import Channel, Message, Schema
from mcap.writer import Writer

#: Of the chunks with messages of a channel the first ones that define it, and every how many later ones do:
#: in every chunk of 0.7 s the definitions of one valve's accelerations alone add 6 % to a recording, so 1 %.
FIRST, EVERY = 4, 8


class RepeatingChunks(ChunkBuilder):
    """Chunk builder that puts schema and channel before the first message of a channel in a chunk."""

    def __init__(self) -> None:
        super().__init__()
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._here: set[int] = set()
        self._uses: dict[int, int] = {}
        self._used: set[int] = set()

    def add_schema(self, schema: Schema) -> None:
        """Take note of a schema."""
        self._schemas[schema.id] = schema

    def add_channel(self, channel: Channel) -> None:
        """Take note of a channel."""
        self._channels[channel.id] = channel

    def add_message(self, message: Message) -> None:
        """Add a message, behind its definitions where they are not yet in this chunk."""
        channel = message.channel_id
        if channel not in self._used:
            self._used.add(channel)
            uses = self._uses.get(channel, 0)
            self._uses[channel] = uses + 1
            if uses < FIRST or uses % EVERY == 0:
                self._define(self._channels[channel])
        super().add_message(message)

    def reset(self) -> None:
        """Begin the next chunk."""
        super().reset()  # type: ignore[no-untyped-call]
        self._here.clear()
        self._used.clear()

    def _define(self, channel: Channel) -> None:
        if channel.schema_id and channel.schema_id not in self._here:
            super().add_schema(self._schemas[channel.schema_id])
            self._here.add(channel.schema_id)
        super().add_channel(channel)


def repeat_definitions(writer: Writer) -> None:
    """Let ``writer``, which has written nothing yet, make chunks that explain themselves."""
    assert hasattr(writer, "_Writer__chunk_builder"), "mcap has changed: see RepeatingChunks"
    writer._Writer__chunk_builder = RepeatingChunks()

"""Writer of a rosbag2 directory with MCAP storage: a kill or a power loss costs a second at most."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType

from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Qos
from spool_stream.errors import InputError
from spool_stream.files.staging import leftovers, partial_name, remove

from spool_bag.format.definitions import Definition, definition
from spool_bag.format.metadata import (
    BagMetadata,
    TopicCount,
    metadata_text,
    qos_text,
    sync_folder,
    write_metadata,
)
from spool_bag.mcap.repeating_chunks import repeat_definitions

#: B: what is written faster than it was recorded closes no chunk by time; this is 8 s of a valve at 2 kHz,
#: which a damaged chunk then costs. A packed sample record takes no more room so than in chunks of 1 MiB.
CHUNK_SIZE = 1 << 17
#: s between two ``metadata.yaml`` of a recording under way, 250 messages of a valve.
METADATA_INTERVAL = 5.0


class RecordingError(OSError):
    """Recording failed: the bag could not be written on; what was flushed before is kept and readable."""


class _Output:
    """Unbuffered file: mcap hands over whole chunks, and a full disk must be seen immediately.

    Not derived from ``io.RawIOBase``, around which mcap puts a buffer: so mcap declares no such type.
    """

    def __init__(self, path: Path) -> None:
        self.descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self.position = 0

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            written = os.write(self.descriptor, view)
            self.position += written
            view = view[written:]
        return len(data)

    def tell(self) -> int:
        return self.position

    def flush(self) -> None:
        """Nothing is buffered here."""

    def sync(self) -> None:
        os.fsync(self.descriptor)

    def cut(self, size: int) -> None:
        os.ftruncate(self.descriptor, size)

    def close(self) -> None:
        os.close(self.descriptor)


class BagWriter:
    """Writer of a rosbag2 directory: ``metadata.yaml`` and ``NAME_0.mcap``.

    Chunks are closed and synced to the disk once ``flush_interval`` seconds of wall time have passed; call
    :meth:`flush_if_due` as well where messages may stay away. ``bytes`` counts message payload.

    ``staged`` writes under another name in the same folder, which :meth:`close` changes to ``path`` once the
    bag is whole; where an exception (Ctrl-C) leaves the ``with`` block, nothing stays. A recording is not
    staged: what it has on the disk is to be found under its name whatever happens.

    Raises:
        InputError: ``path`` exists already or cannot be made.
        RecordingError: from any method, on the first failure to write (disk full); the file is then cut back
            to its last complete chunk and closed.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        flush_interval: float = 1.0,
        chunk_size: int = CHUNK_SIZE,
        staged: bool = False,
    ) -> None:
        self.path = Path(path)
        self.bytes = 0
        self._interval = flush_interval
        self._topics: dict[int, TopicCount] = {}
        self._schemas: dict[str, int] = {}
        self._start: int | None = None
        self._end = 0
        self._described = 0.0
        self._open = self._settled = False
        if self.path.exists() or self.path.is_symlink():
            raise InputError(f"{self.path} exists already: name a bag that does not, or remove it")
        for left in leftovers(self.path):
            remove(left)
        self._folder = partial_name(self.path) if staged else self.path
        try:
            self._folder.mkdir(parents=True)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be made: {error.strerror}") from error
        self.file = self._folder / f"{self.path.name}_0.mcap"
        try:
            self._output = _Output(self.file)
            self._writer = Writer(self._output, chunk_size, CompressionType.ZSTD)  # type: ignore[arg-type]
            repeat_definitions(self._writer)
            self._writer.start(profile="ros2", library="spool_bag")
            self._write_metadata()
            sync_folder(self._folder.absolute().parent)
        except OSError as error:
            raise RecordingError(f"{self.file}: {error.strerror}") from error
        self._open = True
        self._good = self._output.tell()
        self._flushed = time.monotonic()

    def add_topic(
        self, topic: str, type_name: str, qos: Sequence[Qos] = (), described: Definition | None = None
    ) -> int:
        """Return the channel number of ``topic``; asking again for the same topic returns the same number.

        ``described`` stands in for the installed definition, e.g. the one of a bag that is copied.

        Raises:
            InputError: the topic was added with another type, or the type is unknown.
        """
        for number, known in self._topics.items():
            if known.name == topic:
                if known.type != type_name:
                    raise InputError(f"{topic} is already recorded as {known.type}, not {type_name}")
                return number
        described = described or definition(type_name)
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(
                type_name, described.encoding, described.text.encode()
            )
        number = self._writer.register_channel(
            topic,
            "cdr",
            self._schemas[type_name],
            {"offered_qos_profiles": qos_text(qos), "topic_type_hash": described.digest},
        )
        self._topics[number] = TopicCount(topic, type_name, described.digest, tuple(qos))
        self._guard(self._write_metadata)
        return number

    def write(
        self, channel: int, log_time: int, data: bytes, publish_time: int | None = None, sequence: int = 0
    ) -> None:
        """Append the CDR ``data``; times in ns, ``publish_time`` defaults to ``log_time``."""
        published = log_time if publish_time is None else publish_time
        self._guard(lambda: self._writer.add_message(channel, log_time, data, published, sequence))
        self._topics[channel].messages += 1
        self.bytes += len(data)
        self._start = log_time if self._start is None else min(self._start, log_time)
        self._end = max(self._end, log_time)
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Close the chunk and sync it if the last time was ``flush_interval`` ago."""
        if time.monotonic() - self._flushed >= self._interval:
            self.flush()

    def flush(self) -> None:
        """Close the chunk in progress and sync it to the disk."""
        self._guard(self._flush)

    def close(self) -> None:
        """Write index, footer and the final ``metadata.yaml``; closing again does nothing.

        Raises:
            InputError: something took the place of a staged bag meanwhile.
        """
        self.finish()
        if self._folder != self.path and not self._settled:
            self._settle()
            self._settled = True

    def finish(self) -> None:
        """Do what :meth:`close` does, but leave a staged bag under its other name, to be read once more."""
        if not self._open:
            return
        self._guard(self._finish)
        self._open = False
        self._output.close()

    def discard(self) -> None:
        """Leave nothing of a staged bag that is not closed; close any other."""
        if self._folder == self.path:
            self.close()
            return
        if self._open:
            self._open = False
            self._output.close()
        self._settled = True
        remove(self._folder)

    @property
    def messages(self) -> int:
        """Number of messages written."""
        return sum(topic.messages for topic in self._topics.values())

    @property
    def counts(self) -> dict[str, int]:
        """Messages per topic."""
        return {topic.name: topic.messages for topic in self._topics.values()}

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            try:
                self.close()
            except BaseException:
                self.discard()
                raise
        else:
            self.discard()

    def _settle(self) -> None:
        """Give the staged bag its name."""
        if self.path.exists() or self.path.is_symlink():
            remove(self._folder)
            raise InputError(f"{self.path} exists already: name a bag that does not, or remove it")
        self._folder.replace(self.path)
        sync_folder(self.path.absolute().parent)
        self.file = self.path / self.file.name

    def _flush(self) -> None:
        self._writer.flush()
        self._output.sync()
        self._good = self._output.tell()
        self._flushed = time.monotonic()
        if self._flushed - self._described >= METADATA_INTERVAL:
            self._write_metadata()

    def _finish(self) -> None:
        self._flush()
        # As rosbag2's own plugin does, so that the file by itself tells its distribution and counts.
        text = metadata_text(self._about(finished=True))
        self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
        self._writer.finish()
        self._output.sync()
        self._write_metadata(finished=True)

    def _guard(self, action: Callable[[], None]) -> None:
        if not self._open:
            raise RecordingError(f"{self.file} is closed")
        try:
            action()
        except OSError as error:
            self._open = False
            self._output.cut(self._good)
            self._output.close()
            raise RecordingError(
                f"{self.file}: {error.strerror}; what was recorded before is kept ({self._good} bytes)"
            ) from error

    def _write_metadata(self, *, finished: bool = False) -> None:
        self._described = time.monotonic()
        write_metadata(self._folder, self._about(finished=finished))

    def _about(self, *, finished: bool) -> BagMetadata:
        start = self._start or 0
        topics = tuple(self._topics.values())
        return BagMetadata(self.file.name, start, max(self._end - start, 0), topics, finished)

"""Reader of a bag by acquisition time: blocks, oil temperature, speed and any other message."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from itertools import takewhile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from spool_core import cdr
from spool_core.block import Block, BlockRun
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag import metadata, no_such_bag
from spool_bag.blocks import Item, OrderingWindows, Span, decode_blocks, keyed_of
from spool_bag.mcap_file import Damage, McapFile, McapMessage, MessageBatch, decompressed
from spool_bag.mcap_record import Topic
from spool_bag.part_records import begin_of, losses_of

_ALL = Span()
#: Names of topics that one line lists.
MOST_LISTED = 12

#: ns by which blocks arrive late at most where sensor and recorder share a clock.
SHARED_CLOCK = 1_000_000_000

#: Messages of one length and their times of reception on the sensor's clock (ns) to items, with their counts.
_Decode = Callable[[Sequence[bytes], Sequence[int]], Iterator[tuple[Item | None, int]]]


class _Source(NamedTuple):
    """A topic that is read by stamp, its type and how to decode messages of one length."""

    name: str
    type: str
    decode: _Decode


_ACCELERATION = _Source("acceleration", metadata.ACCELERATION_BLOCK, lambda many, _: decode_blocks(many))


def _readings(read: Callable[[bytes, int], cdr.Reading]) -> _Decode:
    """Return what decodes messages one by one with ``read``."""

    def decode(messages: Sequence[bytes], received: Sequence[int]) -> Iterator[tuple[Item | None, int]]:
        for data, stamp in zip(messages, received, strict=True):
            try:
                yield read(data, stamp), 1
            except cdr.CdrError:
                yield None, 1

    return decode


_OIL = _Source("oil_temperature", metadata.TEMPERATURE, _readings(lambda one, _: cdr.decode_temperature(one)))
_SPEED = _Source("speed", metadata.FLOAT64, _readings(cdr.decode_speed))
_READINGS = (_OIL, _SPEED, _Source("command", metadata.FLOAT64, _readings(cdr.decode_command)))


class TopicInformation(NamedTuple):
    """Topic of a bag: its type and number of messages, without those that parts repeat."""

    type: str
    messages: int


class BagReader:
    """Reader of a rosbag2 directory or an ``.mcap`` file, also compressed as a whole (``.mcap.zstd``).

    Everything is read in passes over the file; of the messages of a valve at most two ``WINDOW`` (10 s of
    stamps, and never more than ``LONGEST_QUEUE`` messages or ``LARGEST_QUEUE`` B) are held, so that messages
    up to 5 s late are put in order of (header.stamp, sequence). A stamp that goes back further is a new start
    of time and is passed on where it stands. A message that is not what its type says is left out, counted.

    A recording in parts is read like one file; of ``span`` only what lies in it, and parts that cannot hold
    any of it are not opened. Blocks and temperatures are in it by their stamps, other messages by when they
    were received.

    Attributes:
        warnings: what is missing or not as it should be, one line each.
        closed: the recording was finished properly.
        damages: with ``skip_damage`` what was stepped over so far, else empty: damage is an error then.
        undecodable: messages that are not what their type says, left out, by topic, as far as read.

    Raises:
        InputError: there is no bag at ``path``, or (from any method) it is damaged.
    """

    def __init__(self, path: Path | str, *, skip_damage: bool = False, span: Span = _ALL) -> None:
        self.path = Path(path)
        self.span = span
        self.damages: list[Damage] = []
        self._noted: dict[Path, list[Damage]] = {}
        self._skip = skip_damage
        self._folder: TemporaryDirectory[str] | None = None
        self.warnings: list[str] = []
        self._told = 0
        if self.path.is_dir():
            paths, self._told, self.warnings, _ = metadata.storage_files(self.path)
        elif self.path.is_file():
            paths = [self.path]
        else:
            raise no_such_bag(self.path)
        files = self._opened(paths)
        self.files = [file for file in files if file.times is None or span.touches(*file.times)]
        self.closed = all(file.closed for file in self.files)
        self.warnings.extend(
            f"{file.path}: the recording was not finished: data not yet on the disk is missing; "
            "`./spool recover` makes a finished bag of it"
            for file in self.files
            if not file.closed
        )
        if self.files and self.closed and metadata.is_unfinished(self.path):
            self.warnings.append(
                f"{self.path}: the recording is under way, or was cut off between two parts: data not "
                "yet on the disk is missing"
            )
        self.warnings.extend(_stated_losses(self.files))
        self._topics: dict[str, TopicInformation] | None = None
        self.undecodable: dict[str, int] = {}

    def _opened(self, paths: Sequence[Path]) -> list[McapFile]:
        """Return the files; of several those that can be read, the others are warned of."""
        files, refused = list[McapFile](), list[InputError]()
        for path in paths:
            try:
                plain = path
                if path.suffix in metadata.COMPRESSED_WHOLE:
                    self._folder = self._folder or TemporaryDirectory(prefix="spool_bag_")
                    plain = decompressed(path, Path(self._folder.name))
                files.append(McapFile(plain))
            except InputError as error:
                refused.append(error)
        if refused and not files:
            raise refused[0]
        self.warnings.extend(f"{str(error).partition(': name a ')[0]}: it is left out" for error in refused)
        return files

    @property
    def topics(self) -> dict[str, TopicInformation]:
        """Type and number of messages by topic; an unfinished bag is read through once for it."""
        if self._topics is None:
            found: dict[str, TopicInformation] = {}
            for file, repeated in zip(self.files, self._repeated, strict=True):
                counts = file.counts
                if counts is None:
                    counts = Counter(record.channel for record in self._records(file, lambda _: True))
                for number, topic in file.topics.items():
                    before = found[topic.name].messages if topic.name in found else 0
                    count = max(counts.get(number, 0) - repeated[number], 0)
                    found[topic.name] = TopicInformation(topic.type, before + count)
            self._topics = dict(sorted(found.items()))
        return self._topics

    @property
    def told(self) -> int:
        """Messages that ``metadata.yaml`` counts, 0 without it; of a recording under way some seconds old."""
        return max(self._told - sum(repeated.total() for repeated in self._repeated), 0)

    @property
    def received(self) -> tuple[int, int] | None:
        """First and last time of reception, ns; ``None`` of an empty bag. Unfinished parts are read."""
        found: list[int] = []
        for file in self.files:
            if file.times is not None:
                found += [time for time in file.times if time]
            else:
                found += [record.log_time for record in self._records(file, lambda _: True)]
        return (min(found), max(found)) if found else None

    @property
    def listed(self) -> str:
        """The names of the topics for one line of text."""
        names = [printable(name, 80) for name in self.topics]
        more = [f"and {len(names) - MOST_LISTED} more"] if len(names) > MOST_LISTED else []
        return ", ".join(names[:MOST_LISTED] + more) or "none"

    @property
    def valves(self) -> list[str]:
        """Namespaces, without the leading slash, that have an ``acceleration`` topic; the root's is empty."""
        return sorted(
            _parts(name)[0]
            for name, topic in self.topics.items()
            if topic.type == metadata.ACCELERATION_BLOCK and _parts(name)[1] == "acceleration"
        )

    def blocks_of(self, valve: str) -> int:
        """Return the number of messages on the acceleration topic of ``valve``."""
        name = self._known(valve)
        return sum(
            topic.messages
            for path, topic in self.topics.items()
            if _parts(path) == (name, "acceleration") and topic.type == metadata.ACCELERATION_BLOCK
        )

    def blocks(self, valve: str) -> Iterator[Block]:
        """Yield the blocks of ``valve`` in order of (stamp, sequence), malformed ones included."""
        for _, item in self._singles({self._known(valve)}, (_ACCELERATION,)):
            assert isinstance(item, Block)
            yield item

    def temperatures(self, valve: str) -> Iterator[tuple[int, float]]:
        """Yield (stamp in ns, deg C) of the oil of ``valve`` by stamp; nothing where none is recorded."""
        for _, item in self._singles({valve.strip("/")}, (_OIL,)):
            assert isinstance(item, cdr.OilTemperature)
            yield item.stamp, item.celsius

    def speeds(self, valve: str) -> Iterator[tuple[int, float]]:
        """Yield (stamp in ns, rev/min) of the shaft beside ``valve``; nothing where no speed is recorded."""
        for _, item in self._singles({valve.strip("/")}, (_ACCELERATION, _SPEED)):
            if isinstance(item, cdr.Speed):
                yield item.stamp, item.rpm

    def stream(self, valve: str) -> Iterator[Block | cdr.Reading]:
        """Yield blocks and slow readings of ``valve`` by stamp, at equal stamps the reading first."""
        for _, item in self._singles({self._known(valve)}, (_ACCELERATION, *_READINGS)):
            yield item

    def runs(self, valve: str) -> Iterator[Item]:
        """Yield what ``stream`` yields; blocks that follow each other to the nanosecond come as runs."""
        for _, item in self._ordered({self._known(valve)}, (_ACCELERATION, *_READINGS)):
            yield item

    def streams(self) -> Iterator[tuple[str, Block | cdr.Reading]]:
        """Yield what ``stream`` yields, of all valves in one pass, with the valve's name."""
        yield from self._singles(set(self.valves), (_ACCELERATION, *_READINGS))

    def records(self, topic: str | None = None) -> Iterator[tuple[Topic, McapMessage]]:
        """Yield the messages of ``topic`` (all topics without it) as recorded, in the order of recording."""
        for place, file in enumerate(self.files):
            repeated = _repeated_at(file) if place else 0
            for record in self._records(file, lambda candidate: topic is None or candidate.name == topic):
                # What a part repeats so that it stands by itself was in the parts before it.
                if (not repeated or record.log_time != repeated) and self.span.holds(record.log_time):
                    yield file.topics[record.channel], record

    def messages(self, topic: str) -> Iterator[Any]:
        """Yield the messages of ``topic`` decoded by the definition that the bag carries; others are counted.

        Raises:
            InputError: the bag has no such topic.
        """
        if topic not in self.topics:
            raise InputError(f"{self.path}: no topic {printable(topic)}: it has {self.listed}")
        bad = 0
        for described, record in self.records(topic):
            message = self._decoded(described, record.data)
            if message is None:
                bad += 1
                self._left_out(topic, bad)
            else:
                yield message

    def decodable(self, topic: Topic, data: bytes) -> bool:
        """Return whether ``data`` fits the definition that the bag carries for ``topic``."""
        return self._decoded(topic, data) is not None

    def _decoded(self, topic: Topic, data: bytes) -> Any:
        """Return the message in ``data``, ``None`` where that does not fit the bag's definition."""
        try:
            store = metadata.types_in(topic.schema, topic.type)
            return None if store is None else store.deserialize_cdr(data, topic.type)
        except Exception:  # rosbags, struct, NumPy, RecursionError: whatever a bad byte brings
            return None

    def _left_out(self, topic: str, count: int) -> None:
        """Count what one pass left out; another pass leaves out the same messages again."""
        self.undecodable[topic] = max(self.undecodable.get(topic, 0), count)

    def _known(self, valve: str) -> str:
        name = valve.strip("/")
        if name not in self.valves:
            known = ", ".join(printable(one, 80) for one in self.valves[:MOST_LISTED]) or "none"
            raise InputError(f"{self.path}: no valve {printable(valve)!r}: the bag has {known}")
        return name

    def _singles(
        self, valves: set[str], sources: tuple[_Source, ...]
    ) -> Iterator[tuple[str, Block | cdr.Reading]]:
        """Yield what ``_ordered`` yields, runs block by block."""
        for valve, item in self._ordered(valves, sources):
            if isinstance(item, BlockRun):
                for block in item.blocks():
                    yield valve, block
            else:
                yield valve, item

    def _ordered(self, valves: set[str], sources: tuple[_Source, ...]) -> Iterator[tuple[str, Item]]:
        """Yield decoded messages by valve in order of (stamp, sequence, arrival) in a window.

        A speed has no stamp: it holds when it was received. Where the sensor's clock is not the recorder's,
        the newest block before it gives the difference.
        """
        decoders = {(source.name, source.type): source.decode for source in sources}

        def wanted(topic: Topic) -> bool:
            valve, leaf = _parts(topic.name)
            return valve in valves and (leaf, topic.type) in decoders

        windows, bad, arrival, whole = OrderingWindows(), dict[str, int](), 0, self.span.is_all
        late = dict[str, int]()
        for file in self.files:
            channels: dict[int, tuple[str, _Decode]] = {}
            for batch in file.batches(wanted, self._damage_of(file)):
                for channel, size, messages, starts in _alike(batch):
                    found = channels.get(channel)
                    if found is None:
                        topic = file.topics[channel]
                        valve, leaf = _parts(topic.name)
                        found = channels[channel] = valve, decoders[leaf, topic.type]
                    valve, decode = found
                    blocks, behind = decode is _ACCELERATION.decode, late.get(valve, 0)
                    received = [batch.log_time(one) - behind for one in (starts[-1:] if blocks else starts)]
                    for item, count in decode(messages, received):
                        if item is None:
                            name = file.topics[channel].name
                            bad[name] = bad.get(name, 0) + 1
                            self._left_out(name, bad[name])
                            continue
                        if blocks:
                            newest = item.last.stamp if isinstance(item, BlockRun) else item.stamp
                            step = received[0] + behind - newest
                            late[valve] = step if abs(step) > SHARED_CLOCK else 0
                        for part, messages_of in ((item, count),) if whole else self.span.cut(item):
                            arrival += 1
                            yield from windows.take(valve, keyed_of(part, arrival, size, messages_of))
        yield from windows.rest()

    def _records(self, file: McapFile, wanted: Callable[[Topic], bool]) -> Iterator[McapMessage]:
        return file.records(wanted, self._damage_of(file))

    @cached_property
    def _repeated(self) -> list[Counter[int]]:
        """Messages by channel that each file repeats at its beginning."""
        return [_repeated(file) if place else Counter() for place, file in enumerate(self.files)]

    def _damage_of(self, file: McapFile) -> Callable[[Damage], None] | None:
        """Return what takes note of damage, ``None`` where that is an error."""

        def note(damage: Damage) -> None:
            if damage not in self._noted.setdefault(file.path, []):
                self._noted[file.path].append(damage)
                self.damages.append(damage)

        return note if self._skip else None

    def lost(self) -> tuple[int, bool]:
        """Return the messages lost at the ``damages`` and whether that is estimated in part.

        Where no index behind a damaged chunk tells, its size does, by what as large chunks of the file held.
        """
        counted, estimated, unknown = 0, 0.0, False
        for file in self.files:
            for damage in self._noted.get(file.path, []):
                counted += damage.lost or 0
                if damage.lost is None:
                    estimated += file.density * damage.size
                    unknown = True
        return counted + round(estimated), unknown


def _repeated_at(file: McapFile) -> int:
    """Return the log time (ns) of the messages that a part repeats of those before it, 0 for none."""
    begin = begin_of(file.path)
    return begin.repeated_at if begin is not None else 0


def _repeated(file: McapFile) -> Counter[int]:
    """Return by channel how many messages a part repeats; as far as its beginning can be read."""
    at = _repeated_at(file)
    records = file.records(lambda _: True, lambda _: None) if at else iter(())
    return Counter(record.channel for record in takewhile(lambda record: record.log_time == at, records))


def _stated_losses(files: Sequence[McapFile]) -> list[str]:
    """Return what the parts of a recording say was not recorded."""
    found = []
    for file in files:
        begin = begin_of(file.path)
        if begin is None:
            continue
        if begin.cut_off:
            found.append(
                f"{file.path}: the recorder was cut off before this part: data not yet on the disk is missing"
            )
        losses = [("before", str(begin.lost), begin.reason)] if begin.lost else []
        losses += [
            ("in", one.get("lost_messages", ""), one.get("lost_because", "")) for one in losses_of(file.path)
        ]
        for where, count, because in losses:
            many = "message was" if count == "1" else "messages were"
            text = f"{printable(count, 20)} {many} not recorded {where} {file.path.name}"
            found.append(f"{text}: {printable(because, 200)}")
    return found


def _parts(topic: str) -> tuple[str, str]:
    """Return the namespace of a topic, without slashes around it, and its last name."""
    namespace, _, leaf = topic.rpartition("/")
    return namespace.strip("/"), leaf


def _alike(batch: MessageBatch) -> Iterator[tuple[int, int, list[bytes], list[int]]]:
    """Yield channel, length, bytes and places of messages in a row that have the first two in common."""
    messages: list[bytes] = []
    starts: list[int] = []
    data, present, size = batch.records, -1, -1
    for channel, start, end in batch.places:
        if channel != present or end - start != size:
            if messages:
                yield present, size, messages, starts
            present, size, messages, starts = channel, end - start, [], []
        messages.append(data[start:end])
        starts.append(start)
    if messages:
        yield present, size, messages, starts

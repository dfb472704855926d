"""Read a bag by acquisition time: blocks, oil temperature and any other message."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import TypesysError
from rosbags.typesys.store import Typestore
from spool_stream.block import Block
from spool_stream.errors import InputError

from .cdr import CdrError, OilTemperature, decode_block, decode_temperature
from .definitions import ACCELERATION_BLOCK, TEMPERATURE
from .mcap_file import Damage, McapFile, Record, Topic
from .metadata import storage_files

WINDOW = 5_000_000_000
LONGEST_QUEUE = 20_000


class TopicInformation(NamedTuple):
    """A topic of a bag: its type and number of messages."""

    type: str
    messages: int


class BagReader:
    """A rosbag2 directory or an ``.mcap`` file.

    Everything is read in passes over the file; of the messages at most two
    ``WINDOW`` (10 s of stamps, and never more than ``LONGEST_QUEUE`` messages) are held, so that messages up
    to 5 s late are put in order of (header.stamp, sequence). A stamp that goes back further is a new start of
    time and is passed on where it stands.

    Attributes:
        warnings: what is missing or not as it should be, one line each.
        closed: the recording was finished properly.
        damages: with ``skip_damage`` what was stepped over so far, else empty: damage is an error then.

    Raises:
        InputError: there is no bag at ``path``, or (from any method) it is damaged.
    """

    def __init__(self, path: Path | str, *, skip_damage: bool = False) -> None:
        self.path = Path(path)
        self.damages: list[Damage] = []
        self._skip = skip_damage
        self.warnings: list[str] = []
        if self.path.is_dir():
            paths, self.warnings = storage_files(self.path)
        elif self.path.is_file():
            paths = [self.path]
        else:
            raise InputError(f"{self.path}: no such bag: name a rosbag2 directory or an .mcap file")
        self.files = [McapFile(path) for path in paths]
        self.closed = all(file.closed for file in self.files)
        self.warnings.extend(
            f"{file.path}: the recording was not finished; up to one second at its end may be missing"
            for file in self.files
            if not file.closed
        )
        self._topics: dict[str, TopicInformation] | None = None
        self._stores: dict[str, Typestore] = {}

    @property
    def topics(self) -> dict[str, TopicInformation]:
        """Type and number of messages by topic; an unfinished bag is read through once for it."""
        if self._topics is None:
            found: dict[str, TopicInformation] = {}
            for file in self.files:
                counts = file.counts if file.counts is not None else self._count(file)
                for number, topic in file.topics.items():
                    before = found[topic.name].messages if topic.name in found else 0
                    found[topic.name] = TopicInformation(topic.type, before + counts.get(number, 0))
            self._topics = dict(sorted(found.items()))
        return self._topics

    @property
    def valves(self) -> list[str]:
        """Namespaces, without the leading slash, that have an ``acceleration`` topic."""
        return sorted(
            name.rpartition("/")[0].lstrip("/")
            for name, topic in self.topics.items()
            if topic.type == ACCELERATION_BLOCK and name.endswith("/acceleration")
        )

    def blocks(self, valve: str) -> Iterator[Block]:
        """Yield the blocks of ``valve`` in order of (stamp, sequence), malformed ones included."""
        for item in self._ordered([self._acceleration(valve)]):
            assert isinstance(item, Block)
            yield item

    def temperatures(self, valve: str) -> Iterator[tuple[int, float]]:
        """Yield (stamp in ns, deg C) of the oil of ``valve`` by stamp; nothing where none is recorded."""
        for item in self._ordered([_oil_temperature(valve)]):
            assert isinstance(item, OilTemperature)
            yield item.stamp, item.celsius

    def stream(self, valve: str) -> Iterator[Block | OilTemperature]:
        """Yield blocks and oil temperatures of ``valve`` by stamp, at equal stamps the temperature first."""
        yield from self._ordered([self._acceleration(valve), _oil_temperature(valve)])

    def records(self, topic: str | None = None) -> Iterator[tuple[Topic, Record]]:
        """Yield the messages of ``topic`` (all topics without it) as recorded, in the order of recording."""
        for file in self.files:
            for record in self._records(file, lambda candidate: topic is None or candidate.name == topic):
                yield file.topics[record.channel], record

    def messages(self, topic: str) -> Iterator[Any]:
        """Yield the messages of ``topic`` decoded by the definition that the bag carries.

        Raises:
            InputError: the bag has no such topic, or its messages do not fit its definition.
        """
        if topic not in self.topics:
            raise InputError(f"{self.path}: no topic {topic}: it has {', '.join(self.topics) or 'none'}")
        for described, record in self.records(topic):
            try:
                yield self._store(described).deserialize_cdr(record.data, described.type)
            except (SerdeError, TypesysError) as error:
                raise InputError(
                    f"{self.path}: message of {topic} logged at {record.log_time} ns: {error}"
                ) from error

    def decodable(self, topic: Topic, data: bytes) -> bool:
        """Return whether ``data`` fits the definition that the bag carries for ``topic``."""
        try:
            self._store(topic).deserialize_cdr(data, topic.type)
        except (SerdeError, TypesysError, InputError):
            return False
        return True

    def _acceleration(self, valve: str) -> _Source:
        name = valve.strip("/")
        if name not in self.valves:
            known = ", ".join(self.valves) or "none"
            raise InputError(f"{self.path}: no valve {valve!r}: the bag has {known}")
        return _Source(f"/{name}/acceleration", ACCELERATION_BLOCK, _block)

    def _ordered(self, sources: list[_Source]) -> Iterator[Block | OilTemperature]:
        """Yield decoded messages in order of (stamp, sequence, arrival) within a window of stamps."""
        decoders = {(source.topic, source.type): source.decode for source in sources}
        queue: list[_Keyed] = []
        lowest = highest = 0
        for file in self.files:
            channels: dict[int, Callable[[bytes], _Keyed]] = {}
            for record in self._records(file, lambda topic: (topic.name, topic.type) in decoders):
                decode = channels.get(record.channel)
                if decode is None:
                    topic = file.topics[record.channel]
                    decode = channels[record.channel] = decoders[topic.name, topic.type]
                try:
                    keyed = decode(record.data)
                except CdrError as error:
                    name = file.topics[record.channel].name
                    raise InputError(
                        f"{file.path}: message of {name} logged at {record.log_time} ns: {error}"
                    ) from error
                stamp = keyed[0]
                if not queue:
                    lowest = highest = stamp
                elif stamp > highest:
                    highest = stamp
                elif stamp < highest - WINDOW:
                    yield from _sorted_items(queue)
                    queue, lowest, highest = [], stamp, stamp
                elif stamp < lowest:
                    lowest = stamp
                queue.append(keyed)
                if highest - lowest > 2 * WINDOW or len(queue) > LONGEST_QUEUE:
                    queue.sort(key=_KEY)
                    split = bisect_left(queue, highest - WINDOW, key=_STAMP)
                    split = max(split, len(queue) // 2) if len(queue) > LONGEST_QUEUE else split
                    for held in queue[:split]:
                        yield held[2]
                    del queue[:split]
                    lowest = queue[0][0]
        yield from _sorted_items(queue)

    def _count(self, file: McapFile) -> dict[int, int]:
        counts: dict[int, int] = {}
        for record in self._records(file, lambda _: True):
            counts[record.channel] = counts.get(record.channel, 0) + 1
        return counts

    def _records(self, file: McapFile, wanted: Callable[[Topic], bool]) -> Iterator[Record]:
        return file.records(wanted, self._note if self._skip else None)

    def _note(self, damage: Damage) -> None:
        if damage not in self.damages:
            self.damages.append(damage)

    def _store(self, topic: Topic) -> Typestore:
        store = self._stores.get(topic.type)
        if store is None:
            store = get_typestore(Stores.EMPTY)
            try:
                store.register(get_types_from_msg(topic.schema, topic.type))
            except TypesysError as error:
                raise InputError(f"{self.path}: definition of {topic.type}: {error}") from error
            self._stores[topic.type] = store
        return store


_Keyed = tuple[int, int, "Block | OilTemperature"]


class _Source(NamedTuple):
    """A topic that is read by stamp, its type and how to decode it."""

    topic: str
    type: str
    decode: Callable[[bytes], _Keyed]


def _oil_temperature(valve: str) -> _Source:
    return _Source(f"/{valve.strip('/')}/oil_temperature", TEMPERATURE, _temperature)


def _block(data: bytes) -> _Keyed:
    block = decode_block(data)
    return block.stamp, block.sequence, block


def _temperature(data: bytes) -> _Keyed:
    item = decode_temperature(data)
    return item.stamp, -1, item


_STAMP, _KEY = itemgetter(0), itemgetter(0, 1)


def _sorted_items(queue: list[_Keyed]) -> Iterator[Block | OilTemperature]:
    queue.sort(key=_KEY)
    for keyed in queue:
        yield keyed[2]

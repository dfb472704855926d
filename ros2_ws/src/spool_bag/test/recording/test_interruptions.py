"""Interruptions of a recording at any moment: all else is as without them, what is lost is counted."""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import signal
import struct
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st
from spool_bag import metadata as metadata_module
from spool_bag import part_records
from spool_bag import recording as recording_module
from spool_bag import snapshot as snapshot_module
from spool_bag.information import describe
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.part_records import begin_of
from spool_bag.parts import Output, numbered
from spool_bag.reader import BagReader
from spool_bag.recorder import LossCount, Recorded
from spool_bag.recording import Recording, RecordingSettings
from spool_bag.snapshot import MOST_KEPT, Snapshot, SnapshotKeeper, SnapshotWriter
from spool_bag.verification import verify
from spool_bag.writer import PartLimits
from spool_core.block import Block
from spool_core.cdr import encode_block

from .test_parts import KIND, START, Quiet, wait_for
from .test_snapshot import block as stamped_block
from .test_snapshot import event

STEP = 20_000_000
SECOND = 1_000_000_000
ACCELERATION, VALVE, EVENTS, REFIT = (
    f"/valve_1/{name}" for name in ("acceleration", "valve", "events", "refit")
)
#: Parts of a second, so that a stretch of messages spans some of them.
LIMITS = PartLimits(duration=1.0)
LEAST_FREE = 10**9
ENOSPC = 28


def few(count: int) -> settings:
    """Return settings of ``count`` examples, many where new ones are searched for; none is made smaller."""
    examples = count if settings().derandomize else 300
    return settings(max_examples=examples, phases=(Phase.explicit, Phase.generate))


@dataclass
class Publishers:
    """Nodes of a valve, with a clock that can be set and what each sends; each message is sent once."""

    now: int = START
    sent: Counter[str] = field(default_factory=Counter)
    topics: list[str] = field(default_factory=lambda: [VALVE, EVENTS])
    latched: set[str] = field(default_factory=lambda: {VALVE})
    sources: int = 1
    moving: bool = True

    def message(self, topic: str) -> Recorded:
        self.sent[topic] += 1
        text = f"{topic} {self.sent[topic]}".encode() + b"\0"
        data = b"\0\1\0\0" + struct.pack("<I", len(text)) + text
        return Recorded(topic, KIND, self.now, self.now, data, topic in self.latched)

    def block(self, source: int) -> Recorded:
        number = self.sent[f"source {source}"]
        self.sent[f"source {source}"] += 1
        rows = np.random.default_rng(number + 1_000_000 * source).standard_normal((2, 4)).astype(np.float32)
        made = Block(self.now, number, 0.0005, *rows)
        return Recorded(ACCELERATION, ACCELERATION_BLOCK, self.now, self.now, encode_block(made, "valve_1"))

    def stretch(self, count: int) -> list[Recorded]:
        """Return ``count`` messages: blocks, and every tenth one of another topic in turn."""
        found = []
        for place in range(count):
            self.now += STEP
            if place % 10 == 4:
                found.append(self.message(self.topics[place // 10 % len(self.topics)]))
            elif self.moving:
                found.append(self.block(place % self.sources))
        return found

    def again(self) -> list[Recorded]:
        """Return what a recorder that is started hears of latched topics."""
        return [self.message(topic) for topic in sorted(self.latched)]


class Disk:
    """Disk that is full once the files of a bag take ``most`` B, ``free`` B otherwise, and kills on demand.

    ``die`` is called in the write behind ``left`` more, after a ``share`` of it.
    """

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.heal()
        write, write_durably = Output.write, metadata_module.write_durably

        def writes(output: Output, data: bytes) -> int:
            self.left -= 1
            if self.left < 0:
                write(output, data[: round(self.share * len(data))])
                self.die()
            room = self.room()
            if len(data) <= room:
                return write(output, data)
            write(output, data[:room])
            raise self.full()

        def writes_durably(path: Path, text: str) -> None:
            if len(text) > self.room():
                raise self.full()
            write_durably(path, text)

        def lists_durably(path: Path, text: str) -> None:
            self.left -= 1
            if self.left < 0 and self.share < 0.5:
                self.die()
            writes_durably(path, text)
            if self.left < 0:
                self.die()

        patch.setattr(Output, "write", writes)
        patch.setattr(part_records, "write_durably", lists_durably)
        patch.setattr(metadata_module, "write_durably", writes_durably)
        patch.setattr(recording_module, "_free", lambda _: self.free)

    def heal(self) -> None:
        """Have room, and let live."""
        self.free, self.tries, self.bag = 10**12, 0, Path()
        self.left, self.share, self.most = math.inf, 0.0, math.inf
        self.die: Callable[[], None] = lambda: None

    def fill(self, bag: Path, room: int) -> None:
        """Leave ``room`` B for the files of ``bag``."""
        self.bag, self.most = bag, room + self.taken(bag)

    def room(self) -> int:
        return 10**9 if math.isinf(self.most) else max(int(self.most) - self.taken(self.bag), 0)

    @staticmethod
    def taken(bag: Path) -> int:
        return sum(path.stat().st_size for path in bag.iterdir())

    def full(self) -> OSError:
        self.tries += 1
        return OSError(ENOSPC, "No space left on device")


class Trouble(NamedTuple):
    """Disk with ``room`` for so many B, or less free than is to be (``low``), while messages come.

    ``stays``: until the recorder has ended.
    """

    low: bool
    room: int
    meanwhile: list[Recorded]
    stays: bool


class Kill(NamedTuple):
    """End by kill -9 in the write behind ``writes`` more, after a ``share`` of it."""

    writes: int
    share: float


@dataclass
class Life:
    """Recorder from its start to its end: stretches of messages and troubles, and how it ends."""

    steps: list[list[Recorded] | Trouble] = field(default_factory=list)
    kill: Kill | None = None


@dataclass
class Result:
    """What became of a life: messages ``confirmed``, those before its last stretch, ``lost`` by topic.

    ``unstated``: lost ones that the bag does not state. ``parts``: numbers of its parts, of which so many
    were ``removed``.
    """

    confirmed: int = 0
    before: int = 0
    lost: dict[str, int] = field(default_factory=dict)
    unstated: int = 0
    parts: range = range(0)
    removed: int = 0


def lived(folder: Path, life: Life, disk: Disk, report: Callable[[Result], None]) -> None:
    """Run a recorder; report what became of it, just before it is killed if it is."""
    disk.heal()
    result = Result()
    one = Recording(folder, RecordingSettings(LIMITS, LEAST_FREE, flush_interval=0.01, resume=True), Quiet())

    def tell() -> None:
        state = one.state
        result.confirmed, result.lost = state.messages, one.lost
        result.unstated, result.removed = state.unstated, state.removed
        report(result)

    def die() -> None:
        tell()
        os.kill(os.getpid(), signal.SIGKILL)

    for place, step in enumerate(life.steps):
        if isinstance(step, Trouble):
            troubled(one, step, disk)
            continue
        result.before = one.state.messages
        if life.kill is not None and place == len(life.steps) - 1:
            disk.die, disk.share, disk.left = die, life.kill.share, life.kill.writes
        expected = result.before + len(step)
        for message in step:
            one.put(message)
        wait_for(lambda expected=expected: one.state.messages == expected)
    assert one.close(180.0)
    if life.kill is not None:
        die()
    tell()


def troubled(one: Recording, trouble: Trouble, disk: Disk) -> None:
    """Let the disk fail while messages come, and heal if it does."""
    if trouble.low:
        disk.free = 10**6
        wait_for(lambda: one.state.paused != "")
    else:
        disk.fill(one.path, trouble.room)
    for message in trouble.meanwhile:
        one.put(message)
    if not trouble.low:
        wait_for(lambda: disk.tries > 3 or one.state.waiting == 0)
    if not trouble.stays:
        disk.heal()
        wait_for(lambda: one.state.paused == "" and one.state.waiting == 0 == one.state.unstated)


def killed(folder: Path, life: Life, disk: Disk) -> Result:
    """Run a recorder in a process that is killed."""
    reading, writing = os.pipe()
    process = os.fork()
    if not process:
        with contextlib.suppress(BaseException), os.fdopen(writing, "wb") as pipe:

            def report(result: object) -> None:
                pickle.dump(result, pipe)
                pipe.flush()

            try:
                lived(folder, life, disk, report)
            except BaseException:
                report(traceback.format_exc())
        os._exit(1)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        result = pickle.load(pipe)
    assert os.waitpid(process, 0)[1] == signal.SIGKILL, result
    assert isinstance(result, Result)
    return result


def lives_of(plan: Plan) -> list[Life]:
    """Return what a plan's publishers and its interruptions make of recorders."""
    nodes, lives = Publishers(), [Life()]

    def stretch(count: int) -> list[Recorded]:
        life = lives[-1]
        return [*(nodes.again() if not life.steps else []), *nodes.stretch(count)]

    for count, (kind, *details) in plan:
        lives[-1].steps.append(stretch(count))
        if kind == "clock":
            nodes.now += details[0] * SECOND
        elif kind == "second source":
            nodes.sources = 2
            lives[-1].steps.append(nodes.stretch(details[0]))
            nodes.sources = 1
        elif kind == "silence":
            nodes.moving = False
            lives[-1].steps.append(nodes.stretch(details[0]))
            nodes.moving = True
        elif kind == "latched later":
            nodes.latched.add(EVENTS)
        elif kind == "late publisher" and REFIT not in nodes.topics:
            nodes.topics.append(REFIT)
            nodes.latched.add(REFIT)
        elif kind == "disk":
            low, room, meanwhile, stays = details
            lives[-1].steps.append(Trouble(low, room, nodes.stretch(meanwhile), stays))
            if stays:
                lives.append(Life())
        elif kind == "end":
            lives.append(Life())
        elif kind == "kill":
            lives[-1].kill = Kill(*details)
            lives.append(Life())
    lives[-1].steps.append(stretch(30))
    return lives


Plan = list[tuple[int, tuple]]
SHARES = st.sampled_from([0.0, 0.5, 1.0]) | st.floats(0.0, 1.0)
INTERRUPTIONS = st.one_of(
    st.tuples(st.just("clock"), st.sampled_from([1, 3600, 86_400, -1, -3600, -86_400])),
    st.tuples(st.just("second source"), st.integers(1, 60)),
    st.tuples(st.just("silence"), st.integers(1, 120)),
    st.tuples(st.just("latched later")),
    st.tuples(st.just("late publisher")),
    st.tuples(st.just("disk"), st.booleans(), st.integers(0, 12_000), st.integers(0, 150), st.booleans()),
    st.tuples(st.just("end")),
    st.tuples(st.just("kill"), st.integers(0, 40), SHARES),
)
PLANS = st.lists(st.tuples(st.integers(0, 70), INTERRUPTIONS), min_size=1, max_size=4)


@pytest.fixture(scope="module")
def disk() -> Iterator[Disk]:
    """A disk that fails on command, looked at often, under recorders with a small queue."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("TURN", "LOOK", "RETRY"):
            patch.setattr(recording_module, name, 0.005)
        patch.setattr(recording_module, "LARGEST_QUEUE", 34_000)
        yield Disk(patch)


@few(20)
@given(PLANS)
@example([(60, ("clock", 1))])  # messages that a part repeats counted in info and recover
@example([(3, ("kill", 0, 0.5))])  # a part without a whole beginning was called edited
@example([(70, ("kill", 8, 0.5))])  # so was one without a whole index
@example([(70, ("kill", 9, 0.0))])  # and before and after each list of parts on the way
@example([(70, ("kill", 11, 0.0))])
@example([(70, ("kill", 13, 0.5))])
@example([(70, ("kill", 14, 0.0))])
@example([(70, ("kill", 14, 0.5))])
@example([(70, ("kill", 15, 0.5))])
@example([(70, ("kill", 12, 0.5))])  # nothing told of the kill where no part was open
@example([(20, ("disk", False, 500, 150, False))])  # a loss stated twice
@example([(44, ("disk", False, 7000, 40, False))])  # a message hidden that had the time of repeated ones
@example([(44, ("disk", False, 0, 40, False))])  # a part that began with what came later
@example([(30, ("disk", False, 2000, 40, False))])  # a part that held nothing yet was called removed
@example([(44, ("disk", True, 0, 120, False))])  # the newest state lost with the rest of a full queue
@example([(44, ("disk", True, 0, 120, True))])  # what a pause cost stated nowhere at the end
def test_interruptions_cost_a_recording_nothing_but_what_it_counts(disk: Disk, plan: Plan) -> None:
    with tempfile.TemporaryDirectory() as folder:
        bag, lives, results = Path(folder) / "bag", lives_of(plan), list[Result]()
        for life in lives:
            first = following(bag)
            if life.kill is None:
                lived(bag, life, disk, results.append)
            else:
                results.append(killed(bag, life, disk))
            results[-1].parts = range(first, following(bag))
            disk.heal()
            assert verify(bag).wrong == []
        judge_whole(bag, lives, results)
        judge_parts(bag, lives, results)


def following(bag: Path) -> int:
    """Return the number of the next part, behind those whose beginning is whole."""
    return 1 + max((number for number, path in numbered(bag) if begin_of(path) is not None), default=-1)


def judge_whole(bag: Path, lives: list[Life], results: list[Result]) -> None:
    """What was put is there once and in order, but for what was counted or not on the disk at a kill."""
    reader = BagReader(bag)
    kept = [(topic.name, bytes(record.data)) for topic, record in reader.records()]
    known = {data for _, data in kept}
    put = [one for life in lives for step in life.steps for one in put_in(step)]
    gone = removed(bag, put, results)
    for topic in {one.topic for one in put}:
        found = [data for name, data in kept if name == topic]
        assert found == [one.data for one in put if one.topic == topic and one.data in known]
    cut_off = False
    for life, result in zip(lives, results, strict=True):
        over = [step.meanwhile for step in life.steps if isinstance(step, Trouble) and not step.stays]
        for messages in over:
            newest = {one.topic: one.data for one in messages if one.latched and one.data not in gone}
            assert known.issuperset(newest.values())
        sure = [step for step in life.steps if not isinstance(step, Trouble)]
        missing = Counter(
            one.topic for step in life.steps for one in put_in(step) if one.data not in known | gone
        )
        if life.kill is None:
            assert missing == Counter(result.lost) or gone
            assert result.unstated == 0 or disk_full_at_end(life)
        else:
            sure[-1] = sure[-1][: result.confirmed - result.before]
            cut_off |= missing.total() > sum(result.lost.values())
        assert [one for step in sure for one in step if one.data not in known | gone] == []
    if not gone:
        lost = sum(sum(result.lost.values()) for result in results)
        unstated = sum(result.unstated for result in results)
        lines = [line for line in reader.warnings if "not recorded" in line]
        assert lost - unstated <= sum(int(line.split()[0]) for line in lines) <= lost
        said = ("not finished", "cut off before this part")
        assert not cut_off or any(text in line for line in reader.warnings for text in said)
    counted = {one.name: one.messages for one in describe(bag).topics if one.messages}
    assert counted == Counter(name for name, _ in kept)


def disk_full_at_end(life: Life) -> bool:
    last = life.steps[-1]
    return isinstance(last, Trouble) and not last.low


def put_in(step: list[Recorded] | Trouble) -> list[Recorded]:
    return step.meanwhile if isinstance(step, Trouble) else step


def removed(bag: Path, put: list[Recorded], results: list[Result]) -> set[bytes]:
    """Return the messages that went with the oldest parts, which the recorder removed for want of room."""
    first, path = numbered(bag)[0]
    assert (first > 0) == any(result.removed for result in results)
    begin = begin_of(path)
    assert begin is not None
    own = [record.data for _, record in BagReader(path).records() if record.log_time != begin.repeated_at]
    return {one.data for one in put[: [one.data for one in put].index(own[0])]} if first else set()


def judge_parts(bag: Path, lives: list[Life], results: list[Result]) -> None:
    """Each further part of a recorder begins with the newest message of each topic latched by then."""
    latched = {one.data for life in lives for step in life.steps for one in put_in(step) if one.latched}
    for result in results:
        newest: dict[str, bytes] = {}
        for number in result.parts:
            path = bag / f"bag_{number}.mcap"
            begin = begin_of(path) if path.exists() else None
            if begin is None:
                continue
            records = [
                (topic.name, record.log_time, bytes(record.data))
                for topic, record in BagReader(path).records()
            ]
            repeated = [(name, data) for name, time, data in records if begin.repeated_at == time]
            if records and number > result.parts[0] and number > numbered(bag)[0][0]:
                assert sorted(repeated) == sorted(newest.items())
            assert [(name, data) for name, _, data in records[: len(repeated)]] == repeated
            for name, _, data in records:
                if name in newest or data in latched:
                    newest[name] = data


@few(40)
@example([(0, ("exchange",))])
@example([(0, ("second source", -20, 5))])
@given(
    st.lists(
        st.tuples(
            st.integers(0, 60),
            st.one_of(
                st.tuples(st.just("clock"), st.sampled_from([1, 3600, 86_400, -1, -3600, -86_400])),
                st.tuples(st.just("restart"), st.integers(0, 1000)),
                st.tuples(st.just("loss"), st.integers(1, 50)),
                st.tuples(st.just("exchange")),
                st.tuples(st.just("second source"), st.integers(-500, 500), st.integers(1, 20)),
            ),
        ),
        max_size=5,
    )
)
def test_of_all_interruptions_only_a_loss_counts_as_lost_blocks(plan: Plan) -> None:
    count, number, now, lost = LossCount(), 1000, START, 0

    def take(sequence: int) -> None:
        nonlocal now
        now += STEP
        count.take(ACCELERATION, sequence, now)

    def stretch(blocks: int) -> None:
        nonlocal number
        for _ in range(blocks):
            take(number)
            number += 1

    for blocks, (kind, *details) in plan:
        stretch(2 + blocks)
        if kind == "clock":
            now += details[0] * SECOND
        elif kind == "restart":
            number = details[0] if details[0] < number - 1 else 0
        elif kind == "loss":
            lost += details[0]
            number += details[0]
            now += details[0] * STEP
        elif kind == "exchange":
            for sequence in (number + 1, number):
                take(sequence)
            number += 2
        elif kind == "second source":
            for other in range(details[1]):
                take(number + other + details[0])
                stretch(1)
    stretch(5)
    assert count.lost == {ACCELERATION: lost}


@few(20)
@example(tenths=20, interruption=("clock", -3600), after_tenths=10)
@given(
    st.integers(5, 80),
    st.tuples(st.just("clock"), st.sampled_from([-86_400, -3600, -1, 0, 1, 3600, 86_400]))
    | st.tuples(st.just("pause"), st.sampled_from([1, 3600, 86_400])),
    st.integers(1, 80),
)
def test_an_alarm_after_an_interruption_gets_all_that_came_since(
    tenths: int, interruption: tuple[str, int], after_tenths: int
) -> None:
    """What came up to 3 s before it, where the clock was not set meanwhile, and up to 2 s after it."""
    kind, seconds = interruption
    before, after = 0.1 * tenths, 0.1 * after_tenths
    keeper, clock, arrival = SnapshotKeeper(3.0, 2.0), 0.0, 0.0
    taken: list[tuple[float, Recorded]] = []
    done: list[Snapshot] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(snapshot_module, "time", SimpleNamespace(monotonic=lambda: arrival))
        for place in range(round(50 * (before + after + 4.0))):
            arrival += 0.02
            clock += 0.02
            if place == round(50 * before):
                clock += seconds
                arrival += seconds if kind == "pause" else 0.0
            message = shifted(place, clock)
            keeper.take(message)
            taken.append((arrival, message))
            if place == round(50 * (before + after)):
                alarm, raised = event(clock), arrival
                keeper.take(alarm)
            done += keeper.due(message.received + 2_000_000)
    (snapshot,) = done
    assert alarm in snapshot.messages
    interrupted = taken[round(50 * before)][0]
    sure = [one for at, one in taken if max(raised - 2.97, interrupted) <= at <= raised + 1.97]
    held = [one for one in snapshot.messages if one.kind == ACCELERATION_BLOCK]
    assert [one for one in sure if one not in held] == []
    assert len({one.data for one in held}) == len(held)


@few(10)
@example(7, False)
@given(st.integers(1, 7), st.booleans())
def test_each_snapshot_that_a_full_disk_refuses_is_written_later_or_reported_as_lost(
    count: int, heals: bool
) -> None:
    keeper, log, tries, full, write = SnapshotKeeper(3.0, 2.0), Quiet(), [0], [True], Snapshot.write

    def writes(snapshot: Snapshot, folder: Path) -> Path:
        tries[0] += 1
        if full[0]:
            raise OSError(ENOSPC, "No space left on device")
        return write(snapshot, folder)

    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(Snapshot, "write", writes)
        writer = SnapshotWriter(keeper, Path(folder), log)
        for number in range(count):
            keeper.take(stamped_block(50 * number))
            assert keeper.ask("/valve_1", START + number * SECOND) == ""
            writer.watch(START + (number + 10) * SECOND, 100)
        wait_for(lambda: tries[0] >= count)
        full[0] = not heals
        writer.close()
        written = len(list(Path(folder).iterdir()))
    assert written == writer.written
    assert written + sum("is lost" in line for line in log.said) == count
    assert written == (min(count, MOST_KEPT) if heals else 0)


def shifted(number: int, seconds: float) -> Recorded:
    """Return a block that was measured and received at ``seconds`` of a clock that can be set."""
    return stamped_block(number)._replace(
        received=START + round(seconds * SECOND) + 1_000_000, published=START + round(seconds * SECOND)
    )

"""Hub of a process's blocks: who gets them, and how many at a time; the subscription is a stub."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Verdict
from spool_core.cdr import encode_block
from spool_core.node import block_hub
from spool_core.node.block_hub import HOSTED_DEPTH, BlockHub, TopicTimes, Worker
from spool_core.node.messages import from_block
from spool_core.system import ThreadTimes, thread_times
from spool_msgs.msg import AccelerationBlocks

SIZE, PERIOD = 40, 5e-4
#: s that a test waits at most: machines are busy.
PATIENCE = 180.0


class Node:
    """Node without ROS 2: messages are handed to ``hear``, or wait in ``mailbox`` for ``hub``."""

    def __init__(self, hub: BlockHub) -> None:
        self.hub = hub
        self.hear: Callable[[bytes], None] | None = None
        self.mailbox: list[bytes] = []

    def get_parameter(self, _name: str) -> SimpleNamespace:
        return SimpleNamespace(value=False)

    def resolve_topic_name(self, name: str) -> str:
        return f"/valve_1/{name}"

    def create_subscription(
        self, _kind: Any, _name: str, hear: Callable[[bytes], None], *_: Any, **__: Any
    ) -> int:
        self.hear = hear
        return 1

    def open_mailbox(self, *_: Any) -> Any:
        def empty() -> Iterator[bytes]:
            while self.mailbox:
                yield self.mailbox.pop(0)

        self.hear = self.mailbox.append
        return SimpleNamespace(empty=empty, subscription=1)

    def destroy_subscription(self, _: int) -> None:
        self.hear = None

    def send(self, *sequences: int) -> None:
        self.put(*sequences)
        while self.mailbox:
            self.hub.collect()

    def put(self, *sequences: int) -> None:
        for sequence in sequences:
            samples = np.full(SIZE, sequence, np.float32)
            block = Block(10**18 + sequence * 20_000_000, sequence, PERIOD, samples, samples)
            assert self.hear is not None
            self.hear(encode_block(block, "valve_1"))


class Taker:
    """Taker of blocks that tells which came together."""

    def __init__(self, room: int = 10**6) -> None:
        self.room = room
        self.taken: list[list[int]] = []
        self.changed = threading.Condition()

    def take(self, blocks: list[Block]) -> None:
        with self.changed:
            self.taken.append([block.sequence for block in blocks])
            self.changed.notify()

    def wait(self, count: int) -> None:
        with self.changed:
            assert self.changed.wait_for(lambda: sum(map(len, self.taken)) >= count, PATIENCE)


@pytest.fixture
def hosted() -> Iterator[BlockHub]:
    hub = BlockHub()
    hub.worker, hub.together = Worker(), 0.1
    yield hub
    hub.worker.close()


def settle(hub: BlockHub) -> None:
    """Wait until the worker has done all that it was asked for."""
    done = threading.Event()
    assert hub.worker is not None
    hub.worker.put(done, lambda _: done.set(), None)
    assert done.wait(PATIENCE)


def test_a_process_of_one_node_takes_each_block_as_it_comes() -> None:
    hub, taker = BlockHub(), Taker()
    node = Node(hub)
    hub.subscribe(node, "acceleration", taker.take, lambda: taker.room)
    node.send(0, 1, 2)
    assert taker.taken == [[0], [1], [2]]


def test_a_source_of_this_process_hands_its_blocks_over_and_no_other_is_heard() -> None:
    hub, taken = BlockHub(), []
    node = Node(hub)
    hub.offer("/valve_1/acceleration")
    end = hub.subscribe(node, "acceleration", taken.extend, lambda: 1)
    assert node.hear is None
    samples = np.zeros(SIZE, np.float32)
    block = Block(10**18, 7, PERIOD, samples, samples, "valve_1")
    hub.hand_over("/valve_1/acceleration", block)
    assert taken[0] is block
    hub.withdraw("/valve_1/acceleration")
    node.send(8)
    assert [one.sequence for one in taken] == [7, 8]
    hub.offer("/valve_1/acceleration")
    assert node.hear is None
    end()
    assert hub.takers("/valve_1/acceleration") == 0
    hub.hand_over("/valve_1/acceleration", block)
    assert len(taken) == 2


def test_a_host_takes_a_tenth_of_a_second_together(hosted: BlockHub) -> None:
    node, taker = Node(hosted), Taker()
    hosted.subscribe(node, "acceleration", taker.take, lambda: taker.room)
    node.send(0)
    taker.wait(1)
    node.send(1, 2, 3, 4)
    assert taker.taken == [[0]]
    node.send(5)
    taker.wait(6)
    settle(hosted)
    assert taker.taken == [[0], [1, 2, 3, 4, 5]]
    assert hosted.times["/valve_1/acceleration"].messages == 6


def test_an_estimate_that_falls_due_does_not_wait(hosted: BlockHub) -> None:
    node, one, other = Node(hosted), Taker(), Taker(room=2 * SIZE)
    hosted.subscribe(node, "acceleration", one.take, lambda: one.room)
    hosted.subscribe(node, "acceleration", other.take, lambda: other.room)
    node.send(0)
    one.wait(1)
    other.wait(1)
    node.send(1, 2)
    other.wait(3)
    assert one.taken == other.taken == [[0], [1, 2]]


def test_a_block_in_a_message_of_many_waits_as_one_by_itself(hosted: BlockHub) -> None:
    """A source in this process goes before it, and a valve that nobody takes has none."""
    node, shared, taker = Node(hosted), Node(hosted), Taker()
    hosted.share(shared, "accelerations")
    samples = np.ones(SIZE, np.float32)

    def send(*sequences: int) -> None:
        assert shared.hear is not None
        for number in sequences:
            block = from_block(Block(10**18 + number * 20_000_000, number, PERIOD, samples, samples), "soft")
            both = AccelerationBlocks(names=["valve_1", "valve_9"], blocks=[block, block])
            shared.hear(bytes(serialize_message(both)))
        hosted.collect()

    send(0)
    end = hosted.subscribe(node, "acceleration", taker.take, lambda: taker.room)
    send(1)
    taker.wait(1)
    settle(hosted)
    send(2, 3, 4, 5)
    node.send(6)
    taker.wait(6)
    settle(hosted)
    assert taker.taken == [[1], [2, 3, 4, 5, 6]]
    hosted.offer("/valve_1/acceleration")
    send(7)
    assert hosted.times["/valve_1/acceleration"].waiting == 0
    end()


@pytest.mark.parametrize("lost", [0, 1, 500])
def test_lost_blocks_are_counted_as_the_gate_counts_them(lost: int) -> None:
    samples = np.zeros(SIZE, np.float32)
    blocks = [Block(10**18 + n * 20_000_000, n, PERIOD, samples, samples) for n in range(100 + lost)]
    stream = blocks[:30] + blocks[30 + lost :]
    stream.insert(10, replace(blocks[10], sequence=10**9))  # one false number is no loss
    restarted = [replace(block, sequence=number) for number, block in enumerate(blocks[-40:])]
    times, gate = TopicTimes(), BlockGate()
    for block in stream[:-40] + restarted:
        times.take([block], 0.0, 0.0, 0.0)
        gate.judge(block)
    assert times.blocks_lost == gate.lost == lost
    times.take([replace(blocks[-1], sample_period=float("nan"))], 0.0, 0.0, 0.0)
    assert times.blocks_lost == lost


def test_blocks_that_stopped_coming_wait_for_no_others(
    hosted: BlockHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That they waited for each other does not count as late."""
    node, taker, now = Node(hosted), Taker(), [100.0]
    clock = SimpleNamespace(monotonic=lambda: now[0], time=lambda: 0.0)
    monkeypatch.setattr(block_hub, "time", clock)
    hosted.subscribe(node, "acceleration", taker.take, lambda: taker.room)
    node.send(0)
    settle(hosted)
    node.send(1)
    node.put(2)
    hosted.collect()
    assert len(node.mailbox) == 1  # no turn can be due yet
    now[0] += 0.1
    hosted.collect()
    now[0] += 0.3
    hosted.flush(0.4)
    settle(hosted)
    assert taker.taken == [[0]]
    hosted.flush(0.2)
    settle(hosted)
    assert taker.taken == [[0], [1, 2]]
    times = hosted.times["/valve_1/acceleration"]
    assert (times.messages, times.late, times.waiting) == (3, 0, 0)


def test_of_more_than_a_second_that_waits_the_newest_samples_alone_are_decoded(
    hosted: BlockHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first block says how many were dropped ahead of it; of a second or less nothing is dropped."""
    taken: list[Block] = []
    decoded: list[int] = []

    def decode(data: bytes) -> Block:
        block = block_hub_decode(data)
        decoded.append(block.sequence)
        return block

    block_hub_decode = block_hub.decode_block
    monkeypatch.setattr(block_hub, "decode_block", decode)
    node, begin, end = Node(hosted), threading.Event(), threading.Event()
    hosted.subscribe(node, "acceleration", taken.extend, lambda: 10**6)
    node.send(0)
    settle(hosted)
    assert hosted.worker is not None

    def hold(_: object) -> None:
        begin.set()
        end.wait(PATIENCE)

    for first, count in ((1, 51), (100, 52)):
        begin.clear(), end.clear()
        hosted.worker.put("another valve", hold, None)
        assert begin.wait(PATIENCE)
        node.send(*range(first, first + count))
        assert hosted.waits(node, "acceleration")
        assert hosted.behind == pytest.approx((count - hosted_together(hosted)) * SIZE * PERIOD)
        end.set()
        while hosted.times["/valve_1/acceleration"].waiting:
            settle(hosted)
        settle(hosted)
    assert decoded == [block.sequence for block in taken] == [*range(52), *range(132, 152)]
    assert [block.dropped for block in taken if block.dropped] == [32]
    assert hosted.times["/valve_1/acceleration"].dropped == 32


def test_what_a_process_drops_while_it_starts_is_no_loss(hosted: BlockHub) -> None:
    node, gate, taken = Node(hosted), BlockGate(), list[tuple[Block, Verdict]]()
    hosted.starting = True
    hosted.subscribe(
        node, "acceleration", lambda blocks: taken.extend(gate.admitted(blocks, lambda: 1)), lambda: 1
    )
    node.send(0)
    settle(hosted)
    begin, end = threading.Event(), threading.Event()
    assert hosted.worker is not None
    hosted.worker.put("another valve", lambda _: (begin.set(), end.wait(PATIENCE)), None)
    assert begin.wait(PATIENCE)
    node.send(*range(1, 101))
    end.set()
    while hosted.times["/valve_1/acceleration"].waiting:
        settle(hosted)
    settle(hosted)
    assert [(block.sequence, verdict) for block, verdict in taken[:2]] == [
        (0, Verdict.RESTARTS),
        (81, Verdict.RESTARTS),
    ]
    assert (gate.accepted, gate.lost, gate.faults) == (21, 0, {})


def hosted_together(hub: BlockHub) -> int:
    return round(hub.together / (SIZE * PERIOD))


def test_who_stays_takes_what_the_one_who_left_had_asked_for(hosted: BlockHub) -> None:
    first, second, leaves, stays = Node(hosted), Node(hosted), Taker(), Taker()
    end = hosted.subscribe(first, "acceleration", leaves.take, lambda: leaves.room)
    hosted.subscribe(second, "acceleration", stays.take, lambda: stays.room)
    first.send(0)
    settle(hosted)
    first.send(1, 2)
    end()
    assert first.hear is None
    second.send(3)
    stays.wait(4)
    assert stays.taken == [[0], [1, 2, 3]]
    assert leaves.taken == [[0]]


def test_a_message_that_is_no_block_costs_no_other(hosted: BlockHub) -> None:
    said: list[str] = []
    node, taker = Node(hosted), Taker()
    node.get_logger = lambda: type("Log", (), {"warning": staticmethod(said.append)})  # type: ignore[attr-defined]
    hosted.subscribe(node, "acceleration", taker.take, lambda: taker.room)
    assert node.hear is not None
    node.mailbox.append(b"nothing")
    node.send(0)
    taker.wait(1)
    assert taker.taken == [[0]]
    assert len(said) == 1


def test_what_nobody_takes_any_more_does_not_pile_up(hosted: BlockHub) -> None:
    """A job that never returns keeps its topic's turn; the others of the topic have the blocks then."""
    hanging, node, taker = Node(hosted), Node(hosted), Taker()
    began, release = threading.Event(), threading.Event()

    def hang(_: object) -> None:
        began.set()
        release.wait()

    hosted.subscribe(hanging, "acceleration", hang, lambda: 1)
    hanging.send(0)
    assert began.wait(PATIENCE)
    send = hanging.hear
    assert send is not None
    data = encode_block(Block(10**18, 1, PERIOD, *[np.zeros(SIZE, np.float32)] * 2), "valve_1")
    for _ in range(3 * HOSTED_DEPTH):
        send(data)
    hosted.collect()
    assert hosted.times["/valve_1/acceleration"].waiting <= HOSTED_DEPTH
    hosted.subscribe(node, "acceleration", taker.take, lambda: taker.room)
    assert hosted.worker is not None
    assert not hosted.worker.give_up(node)
    assert hosted.worker.give_up(hanging)
    hosted.give_up(hanging)
    node.send(2000)
    with taker.changed:
        assert taker.changed.wait_for(lambda: taker.taken and taker.taken[-1][-1] == 2000, PATIENCE)
    release.set()


@dataclass
class Machine:
    """A machine on which a worker's thread is served so many s of each second, or sleeps."""

    share: float = 1.0
    sleeps: bool = False
    now: float = 0.0
    used: float = 0.0
    busy: float = 0.0

    def times(self, number: int) -> ThreadTimes:
        if number == threading.get_native_id():
            return ThreadTimes(self.busy * self.now, 0.0, True)
        waited = 0.0 if self.sleeps else self.now - self.used
        return ThreadTimes(self.used, waited, not self.sleeps)

    def found(self, worker: Worker) -> float:
        """Return after how many s a job counts as hanging, at most 100."""
        while worker.hanging(1.0) is None and self.now < 100.0:
            self.now += 0.25
            self.used += 0.0 if self.sleeps else 0.25 * self.share
            worker.look(0.5)
        return self.now


@pytest.mark.parametrize(
    ("machine", "seconds"),
    [
        pytest.param(Machine(sleeps=True), 1.25, id="a deadlock"),
        pytest.param(Machine(sleeps=True, busy=0.5), 2.25, id="a deadlock beside a busy thread"),
        pytest.param(Machine(), 1.25, id="an endless loop"),
        pytest.param(Machine(share=0.1), 10.25, id="an endless loop on a busy machine"),
        pytest.param(Machine(share=0.0), 100.0, id="a job that other programs keep from a processor"),
        pytest.param(Machine(sleeps=True, busy=1.0), 100.0, id="a job that waits for the thread that looks"),
    ],
)
def test_a_job_hangs_that_does_not_return_though_it_is_served(machine: Machine, seconds: float) -> None:
    worker, began, release = Worker(lambda: machine.now, machine.times), threading.Event(), threading.Event()

    def job(_: object) -> None:
        began.set()
        release.wait(PATIENCE)

    worker.put("owner", job, None)
    assert began.wait(PATIENCE)
    worker.look(0.5)
    assert machine.found(worker) == pytest.approx(seconds, abs=0.26)
    release.set()
    worker.close()


def test_the_time_of_a_pause_of_the_whole_process_makes_no_job_hang() -> None:
    machine = Machine(sleeps=True)
    worker, began, release = Worker(lambda: machine.now, machine.times), threading.Event(), threading.Event()
    worker.put("owner", lambda _: (began.set(), release.wait(PATIENCE)), None)
    assert began.wait(PATIENCE)
    machine.now = 3600.0
    worker.look(0.5)
    assert worker.hanging(1.0) is None
    release.set()
    worker.close()


def test_a_worker_is_busy_from_job_to_job_until_it_rests() -> None:
    machine, turn = Machine(), threading.Semaphore(0)
    worker, begun = Worker(lambda: machine.now, machine.times), threading.Semaphore(0)

    def job(_: object) -> None:
        begun.release()
        assert turn.acquire(timeout=PATIENCE)

    assert worker.busy == 0.0
    for seconds in (0.0, 3.0):  # without a moment of rest between both
        worker.put("owner", job, None)
        machine.now = seconds
        assert seconds or begun.acquire(timeout=PATIENCE)
    assert worker.busy == 3.0
    turn.release()
    assert begun.acquire(timeout=PATIENCE)
    machine.now = 5.0
    assert worker.busy == 5.0
    turn.release()
    while worker.busy:
        threading.Event().wait(0.001)
    machine.now = 7.0
    worker.put("owner", job, None)
    assert begun.acquire(timeout=PATIENCE)
    machine.now = 8.0
    assert worker.busy == 1.0
    turn.release()
    worker.close()


def test_the_system_tells_what_a_thread_used_and_that_it_waits() -> None:
    own = thread_times(threading.get_native_id())
    assert own is not None
    assert (own.used > 0.0, own.ready) == (True, True)
    release = threading.Event()
    sleeper = threading.Thread(target=release.wait)
    sleeper.start()
    assert sleeper.native_id is not None
    states = {found.ready for _ in range(10_000) if (found := thread_times(sleeper.native_id))}
    release.set()
    sleeper.join()
    assert False in states
    assert thread_times(0) is None

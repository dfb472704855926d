"""Managed node ``recorder``: every topic of the valves, as received, into a bag."""

from __future__ import annotations

import contextlib
import importlib
import math
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from spool_core.cdr import CdrError, block_head, decode_blocks, encode_block, header_stamp
from spool_core.errors import InputError, operator_missing
from spool_core.node import qos
from spool_core.node.block_hub import Throttle
from spool_core.node.diagnostics import DiagnosticPublisher, Level, Status
from spool_core.node.managed_node import ManagedNode
from spool_core.node.parameters import NodeParameter, Value
from spool_core.node.running import run
from spool_core.system import expanded
from spool_core.text import plural, printable
from spool_msgs.srv import TakeSnapshot

from spool_bag import check_valve, recorder
from spool_bag.metadata import ACCELERATION_BLOCK, ACCELERATION_BLOCKS, MACHINE, starts_with_header
from spool_bag.recording import LARGEST_QUEUE, Recording, RecordingSettings
from spool_bag.snapshot import SnapshotKeeper, SnapshotWriter
from spool_bag.verification import signer
from spool_bag.writer import PartLimits

#: s between looks for new topics: a late one loses at most that much.
DISCOVERY_PERIOD = 0.5
#: s between looks at what publishers offer where their number stays: one may have replaced another.
ASKED_AGAIN = 5.0
#: s after which a chunk is synced, and between looks if it is due: a kill costs less than the last second.
FLUSH_INTERVAL = 0.7
FLUSH_PERIOD = 0.2
DIAGNOSTICS_PERIOD = 1.0
#: s for a disk to take what waits when the recording ends.
LONGEST_CLOSE = 20.0
#: s for which a lost block makes the recording's level a warning.
RECENT = 60.0
#: What rosbag2 writes of a time that is not limited: the largest int64, ns.
UNLIMITED = QosTime(9223372036, 854775807)

_structural = partial(NodeParameter, structural=True)


class RecorderNode(ManagedNode):
    """Record while active; each activation makes a new bag."""

    PARAMETERS: ClassVar[tuple[NodeParameter, ...]] = (
        _structural(
            "output", "",
            "Path of the bag to write; empty: recording_<UTC time> in the working directory. "
            "A second activation appends _1, and so on.",
        ),
        _structural(
            "number_output", False,
            "Append _1, and so on, if output exists, instead of refusing it: for a recorder that restarts "
            "automatically.",
        ),
        _structural(
            "valves", [""],
            "Namespaces to record, e.g. [valve_1, valve_2]; empty: every namespace that has an acceleration, "
            "estimate, health or events topic of spool_msgs.",
        ),
        _structural(
            "machine", "", "Name of the machine, kept in the bag: distinguishes the bags of a fleet."
        ),
        _structural(
            "depth", 1000, "Messages per topic that may wait for the disk; 1000 are 20 s at 50 blocks/s.",
            "", 10, 100000,
        ),
        _structural(
            "max_part_duration", 600.0, "Length of a part of the recording, by the times of reception.",
            "s", 1.0, 86400.0 * 365.0,
        ),
        _structural(
            "max_part_size", 200_000_000, "Size of a part, at most a quarter of max_total_size.",
            "B", 1_000_000,
        ),
        _structural(
            "max_total_size", 0,
            "Quota of the recording, beyond which the oldest parts are removed; 0: only minimum_free_space.",
            "B", 0,
        ),
        _structural(
            "minimum_free_space", 200_000_000,
            "Free space on the disk below which the oldest parts are removed and then recording pauses until "
            "twice as much is free; the recorder warns below twice as much.",
            "B", 0,
        ),
        _structural("resume", False, "Continue an existing recording in output with its next part."),
        _structural(
            "thin_after", 0.0,
            "Age of a part at which accelerations and diagnostics are removed from it, so that estimates, "
            "health and events reach further back; 0: never.",
            "d", 0.0, 36500.0,
        ),
        _structural(
            "signing_key", "", "Private key (Ed25519, PEM) that signs each part's hash; empty: hashes only."
        ),
        _structural(
            "snapshot_folder", "",
            "Folder for bags with the data around each alarm; empty: snapshots next to the bag.",
        ),
        _structural("snapshot_before", 60.0, "Time kept before an alarm.", "s", 0.0, 600.0),
        _structural("snapshot_after", 60.0, "Time kept after an alarm.", "s", 0.0, 600.0),
        NodeParameter(
            "snapshot_limit", 100,
            "Number of snapshots beyond which the oldest are removed; 0: no snapshots.", "", 0, 100000,
        ),
        _structural(
            "snapshot_max_total_size", 2_000_000_000,
            "Quota of the snapshots, beyond which the oldest are removed; 0: no quota.", "B", 0,
        ),
    )  # fmt: skip

    def __init__(self, **options: Any) -> None:
        super().__init__("recorder", **options)
        self._recording: Recording | None = None
        self._diagnostics: DiagnosticPublisher | None = None
        self._subscriptions_by_topic: dict[str, _Subscribed] = {}
        self._throttle = Throttle()
        self._activations = 0
        self._snapshots: SnapshotWriter | None = None
        self._own_clock = self.get_clock()

    def configure(self) -> None:
        """Check the parameters before anything is made."""
        for valve in self._valves():
            check_valve(valve)
        self._new_bag()
        self._diagnostics = DiagnosticPublisher(self)
        self.serve(TakeSnapshot, "~/take_snapshot", self._take_snapshot)

    def activate(self) -> None:
        """Make the bag and start to listen."""
        path = self._new_bag()
        machine = printable(self.value("machine"), 100)
        settings = RecordingSettings(
            PartLimits(
                self.value("max_part_duration"), self.value("max_part_size"), self.value("max_total_size")
            ),
            self.value("minimum_free_space"),
            FLUSH_INTERVAL,
            {MACHINE: machine} if machine else {},
            self.value("resume"),
            signer(self.value("signing_key")),
            86400.0 * self.value("thin_after"),
        )
        self._recording = Recording(path, settings, self.get_logger())
        self._activations += 1
        self._losses, self._dropped = recorder.LossCount(), 0
        self._watch, self._last_loss = recorder.MonitoringWatch(), -math.inf
        self._missed: set[str] = set()
        self._left_out: set[str] = set()
        self._offered: dict[str, list[Qos]] = {}
        self._snapshot_limit = self.value("snapshot_limit")
        self._snapshots = SnapshotWriter(
            SnapshotKeeper(self.value("snapshot_before"), self.value("snapshot_after")),
            expanded(self.value("snapshot_folder") or path.absolute().parent / "snapshots"),
            self.get_logger(),
            self.value("snapshot_max_total_size"),
        )
        self.get_logger().info(f"recording to {path}")
        self._discover()
        self.every(DISCOVERY_PERIOD, self._discover, steady=True)
        self.every(ASKED_AGAIN, lambda: self._discover(again=True), steady=True)
        self.every(FLUSH_PERIOD, self._keep_snapshots, steady=True)
        self.every(DIAGNOSTICS_PERIOD, self._report, steady=True)

    def deactivate(self) -> None:
        """Finish the bag."""
        if self._diagnostics is not None:
            self._diagnostics.rest("inactive: nothing is recorded")
        self._subscriptions_by_topic.clear()
        if self._snapshots is not None:
            self._snapshots.close()
            self._snapshots = None
        recording, self._recording = self._recording, None
        if recording is not None:
            done = recording.close(LONGEST_CLOSE)
            text = f"closed {recording.path}: {plural(recording.state.messages, 'message')}"
            if done:
                self.get_logger().info(text)
            else:
                self.get_logger().error(f"{text}; disk not responding: the last file was not finalised")

    def apply_change(self, changes: dict[str, Value]) -> None:
        """Keep as many snapshots as are wanted from now on."""
        del changes
        self._snapshot_limit = self.value("snapshot_limit")

    def cleanup(self) -> None:
        """Take the publisher away."""
        if self._diagnostics is not None:
            self._diagnostics.destroy()
            self._diagnostics = None

    def _new_bag(self) -> Path:
        return recorder.new_bag(
            self.value("output"),
            activation=self._activations,
            number=self.value("number_output"),
            resume=self.value("resume"),
        )

    def _valves(self) -> list[str]:
        return [valve.strip("/") for valve in self.value("valves") if valve.strip("/")]

    def _discover(self, *, again: bool = False) -> None:
        """Subscribe to what is not recorded yet, or offered more weakly now; ``again`` asks of all."""
        if self._recording is None:
            return
        graph = dict(self.get_topic_names_and_types())
        for topic, kind in recorder.select_topics(graph, self._valves()).items():
            if topic in self._left_out:
                continue
            # What each publisher offers costs ten times as much to ask as how many there are.
            publishers = self.count_publishers(topic)
            # Blocks are lost where nobody listens; all else waits for its publisher, who says how it is sent.
            if not publishers and topic.rpartition("/")[2] != "acceleration":
                continue
            known = self._subscriptions_by_topic.get(topic)
            if known is not None and known.publishers == publishers and not again:
                continue
            offered = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
            if known is not None and known.fits(offered):
                self._subscriptions_by_topic[topic] = known._replace(publishers=len(offered))
                continue
            if known is not None:
                self.destroy_subscription(known.subscription)
            try:
                self._record(topic, kind, offered)
            except Exception as error:  # rclpy and rosbags: a type that is not installed, or not supported
                self._left_out.add(topic)
                self.get_logger().warning(f"{topic} is not recorded: {' '.join(str(error).split())}")

    def _record(self, topic: str, kind: str, offered: Sequence[QoSProfile]) -> None:
        package, _, type_name = kind.split("/")
        try:
            message_type: Any = getattr(importlib.import_module(f"{package}.msg"), type_name)
        except (ImportError, AttributeError) as error:
            raise InputError(f"type {kind} is not installed") from error
        namespace, _, name = topic.rpartition("/")
        one = _Intake(topic, kind, namespace, starts_with_header(kind), name in recorder.LATCHED)
        # The strongest quality of service that every publisher offers.
        latched = one.latched
        reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
        if offered:
            latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
        wanted = qos.profile(self.value("depth"), reliable=reliable, latched=latched)

        def keep(data: bytes) -> None:
            (self._keep_each if kind == ACCELERATION_BLOCKS else self._keep)(one, data)

        subscription = self.subscribe(message_type, topic, keep, wanted, raw=True)
        self._subscriptions_by_topic[topic] = _Subscribed(subscription, wanted, len(offered))

    def _keep_each(self, one: _Intake, data: bytes) -> None:
        """Take each block of many valves as a message of its valve, which is what readers of bags know."""
        wanted, refused = self._valves(), ""
        try:
            for name, block in decode_blocks(data):
                valve = name.strip("/")
                if wanted and valve not in wanted:
                    continue
                try:
                    check_valve(valve)
                except InputError as error:
                    refused = str(error)
                    continue
                intake = _Intake(f"/{valve}/acceleration", ACCELERATION_BLOCK, f"/{valve}", True, False)
                self._keep(intake, encode_block(block, block.source))
        except CdrError as error:
            refused = str(error)
        if refused and (count := self._throttle.take(one.topic)):
            self.get_logger().warning(f"{one.topic}: {count} messages not recorded whole: {refused}")

    def _keep(self, one: _Intake, data: bytes) -> None:
        """Take a message: some thousand times a second."""
        recording = self._recording
        if recording is None:
            return
        published = received = self._received()
        sequence = None
        try:
            if one.kind == ACCELERATION_BLOCK:
                sequence, published = block_head(data)
            elif one.stamped:
                published = header_stamp(data)
        except CdrError:
            with contextlib.suppress(CdrError):  # a damaged block whose header can be read
                published = header_stamp(data)
        topic = one.topic
        offers = self._offered.get(topic)
        if offers is None:  # what its publishers offer, asked with its first message
            profiles = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
            # Times are left unlimited, as ROS 2 does by default.
            offers = self._offered[topic] = [
                Qos(
                    history=QosHistory[profile.history.name],
                    depth=profile.depth,
                    reliability=QosReliability[profile.reliability.name],
                    durability=QosDurability[profile.durability.name],
                    deadline=UNLIMITED,
                    lifespan=UNLIMITED,
                    liveliness=QosLiveliness.AUTOMATIC,
                    liveliness_lease_duration=UNLIMITED,
                    avoid_ros_namespace_conventions=False,
                )
                for profile in profiles
            ]
        message = recorder.Recorded(topic, one.kind, received, max(published, 0), data, one.latched, offers)
        recording.put(message)
        if one.kind == ACCELERATION_BLOCK:
            now = time.monotonic()
            self._watch.saw_data(one.namespace, now)
            if sequence is not None and self._losses.take(topic, sequence, published):
                self._last_loss = now
        elif one.kind == recorder.TOPICS["health"]:
            self._watch.saw_health(one.namespace, time.monotonic())
        if self._snapshots is not None and self._snapshot_limit > 0:
            self._snapshots.keeper.take(message)

    def _received(self) -> int:
        """Return the time of now, ns; with use_sim_time the clock says 0 until it is first heard."""
        clock = self._own_clock
        return (clock.now().nanoseconds if clock.ros_time_is_active else 0) or time.time_ns()

    def _keep_snapshots(self) -> None:
        if self._snapshots is not None:
            self._snapshots.watch(self._received(), self._snapshot_limit)

    def _take_snapshot(
        self, request: TakeSnapshot.Request, response: TakeSnapshot.Response
    ) -> TakeSnapshot.Response:
        """Begin a snapshot that somebody asked for; its bag is made ``snapshot_after`` s later.

        Raises:
            InputError: it cannot be made; the reason is given.
        """
        valve, limit = request.valve.strip("/"), self.value("snapshot_limit")
        check_valve(valve)
        if not request.who.strip():
            raise InputError(operator_missing())
        if self._snapshots is None or limit == 0:
            raise InputError("snapshot_limit is 0: no snapshots are made")
        refused = self._snapshots.keeper.ask(f"/{valve}", self._received())
        if refused:
            raise InputError(f"{valve}: {refused}")
        comment = request.comment.strip()
        text = f"snapshot of {valve} requested by {request.who.strip()}{comment and f': {comment}'}"
        self.get_logger().info(printable(text, 300))
        response.success = True
        return response

    def _report(self) -> None:
        """Publish the state of the recording and of what is monitored."""
        values: dict[str, object] = dict.fromkeys(("free_space_B", "messages", "recorded_B"), math.nan)
        level, text = Level.ERROR, "not recording"
        if self._recording is not None:
            state = self._recording.state
            now = time.monotonic()
            if state.lost > self._dropped:
                self._dropped, self._last_loss = state.lost, now
            level, text = Level.OK, f"recording to {self._recording.path}"
            if state.paused:
                level, text = Level.ERROR, f"recording pauses: {state.paused}"
            elif state.free < 2 * self.value("minimum_free_space"):
                level, text = Level.WARNING, f"only {state.free / 1e6:.0f} MB are free"
            elif now - self._last_loss < RECENT:
                level, text = Level.WARNING, "blocks were lost on the way in the last minute"
            elif state.waiting > LARGEST_QUEUE // 2:
                level, text = Level.WARNING, "the disk is slow: messages wait for it"
            values |= {
                "free_space_B": state.free,
                "messages": state.messages,
                "recorded_B": state.bytes,
                "messages_not_recorded": state.lost,
                "waiting_B": state.waiting,
                "parts": state.parts,
                "parts_removed": state.removed,
                "total_size_B": state.size,
            }
        values["snapshots"] = 0 if self._snapshots is None else self._snapshots.written
        lost = dict.fromkeys(self._valves(), 0)
        lost |= {topic.rpartition("/")[0].strip("/"): count for topic, count in self._losses.lost.items()}
        values |= {f"blocks_lost_{valve}": count for valve, count in lost.items()}
        if self._diagnostics is not None:
            self._diagnostics.publish(Status("recording", level, text, values), self._supervision())

    def _supervision(self) -> Status:
        """Return which valves nobody monitors; a monitor can't report its own end."""
        states = {valve.strip("/"): state for valve, state in self._watch.states(time.monotonic()).items()}
        missed = {valve for valve, state in states.items() if state is recorder.Monitored.NO}
        for valve in sorted(missed - self._missed):
            self.get_logger().error(
                f"{valve} is not monitored: no health message from its monitor; restart it"
            )
        for valve in sorted(self._missed - missed):
            self.get_logger().info(f"{valve} is monitored again")
        self._missed = missed
        waited = sorted(valve for valve, state in states.items() if state is recorder.Monitored.NOT_YET)
        level, text = Level.OK, "every valve that sends is monitored"
        if missed:
            level, text = Level.ERROR, f"not monitored: {', '.join(sorted(missed))}"
        elif waited:
            level, text = Level.WARNING, f"not monitored yet: {', '.join(waited)}"
        told = dict.fromkeys(self._valves(), recorder.Monitored.IDLE) | states
        values = {f"state_{valve}": state.value for valve, state in told.items()}
        return Status("monitoring", level, text, values)


class _Subscribed(NamedTuple):
    """Subscription, the quality of service that it asks for, and how many publishers offered it."""

    subscription: Any
    wanted: QoSProfile
    publishers: int

    def fits(self, offered: Sequence[QoSProfile]) -> bool:
        """Return whether it gets the messages of publishers that offer this."""
        strict = self.wanted.reliability == ReliabilityPolicy.RELIABLE
        latched = self.wanted.durability == DurabilityPolicy.TRANSIENT_LOCAL
        return all(
            (not strict or profile.reliability == ReliabilityPolicy.RELIABLE)
            and (not latched or profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)
            for profile in offered
        )


class _Intake(NamedTuple):
    """Topic that is recorded, with what each of its messages must have."""

    topic: str
    kind: str
    namespace: str
    stamped: bool
    latched: bool


def main() -> None:
    """Run the node as a process."""
    sys.exit(run(RecorderNode))


if __name__ == "__main__":
    main()

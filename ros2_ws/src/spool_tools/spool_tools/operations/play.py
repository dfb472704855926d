"""`./spool play`: a record sent to live nodes, and what they make of it."""

from __future__ import annotations

import heapq
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import yaml
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature
from spool_bag.blocks import ALWAYS, Span
from spool_core.block import Block, BlockRun
from spool_core.cdr import Command, OilTemperature, Reading
from spool_core.errors import InputError
from spool_core.node import qos
from spool_core.node.messages import from_block, to_time
from spool_core.node.network import isolate
from spool_core.node.parameters import rule
from spool_msgs.msg import AccelerationBlock
from spool_report.records.record_loading import ChosenValve, Source, choose_valves, open_source
from spool_report.records.record_sources import TableSource, span_of
from spool_report.requests import PlayRequest
from spool_report.terminal import warn
from std_msgs.msg import Float64

from spool_tools.operations.live_run import START_UP, Display, LiveRun, live_run

#: s between two times that are sent on ``/clock``, and after which what waits is shown.
TURN = 0.1
#: Blocks of a second that subscribers may fall behind, at the highest speed.
DEPTH = 1000
#: Valves that are played at most: each starts an estimator and a monitor.
MOST = 8
#: ns by which samples are sent ahead of the estimates, at most: one comes each second of the record.
AHEAD = 1_500_000_000
#: s for which estimates are waited for.
PATIENCE = 2.0
#: s of quiet after the last block in which the nodes say what it brought.
SETTLE = 1.0


class Player:
    """Topics of a record's valves, whose ``ids`` stand by name, with its time on ``/clock``."""

    def __init__(self, node: Node, ids: dict[str, str]) -> None:
        offered = qos.samples_offered(DEPTH)
        self._ids, self._node = ids, node
        self._clock = node.create_publisher(Clock, "/clock", 1)
        self._topics = {
            (name, kind): node.create_publisher(message, f"/{name}/{topic}", offered)
            for name in ids
            for kind, message, topic in (
                ("Block", AccelerationBlock, "acceleration"),
                ("OilTemperature", Temperature, "oil_temperature"),
                ("Speed", Float64, "speed"),
                ("Command", Float64, "command"),
            )
        }

    @property
    def heard(self) -> bool:
        """Whether estimator and monitor listen to the samples of each valve; others may listen, too."""

        def listeners(name: str) -> set[str]:
            return {
                one.node_name for one in self._node.get_subscriptions_info_by_topic(f"/{name}/acceleration")
            }

        return all(listeners(name) >= {"estimator", "monitor"} for name in self._ids)

    def tell(self, stamp: int) -> None:
        """Send the time ``stamp`` (ns)."""
        self._clock.publish(Clock(clock=to_time(stamp)))

    def send(self, name: str, item: Block | Reading) -> None:
        """Send a block or a reading of the valve ``name``."""
        topic = self._topics[name, type(item).__name__]
        if isinstance(item, Block):
            topic.publish(from_block(item, self._ids[name]))
        elif isinstance(item, OilTemperature):
            message = Temperature(temperature=item.celsius, variance=item.variance)
            message.header.stamp = to_time(item.stamp)
            topic.publish(message)
        else:
            topic.publish(Float64(data=item.value if isinstance(item, Command) else item.rpm))


def run_play(request: PlayRequest) -> int:
    """Play a record to live nodes; return the exit code: 130 where it was interrupted.

    Its stamps are moved so that the record ends when playing ends. The page, if there is one, stays until
    somebody ends the command.

    Raises:
        InputError: no record, no valve in it, wrong request, or a node ended.
    """
    path = request.record
    span = span_of(path, request.when)
    source = open_source(path, request.columns, span)
    if not source.valves:
        raise InputError(f"{path}: no acceleration topic in it, so there is nothing to play")
    if len(source.valves) > MOST:
        raise InputError(
            f"{path}: {len(source.valves)} valves in it, and at most {MOST} can be played: "
            f"./spool replay {path} judges them all"
        )
    valves = choose_valves(source, source.valves, request.valve)
    for name, chosen in valves.items():
        if chosen.warning(name):
            warn(chosen.warning(name))
    seconds = _duration(source, span) / request.speed
    folder = Path(tempfile.mkdtemp(prefix="spool_play_"))
    display = Display(seconds, tuple(source.valves))
    domain = isolate()
    display.say(f"playing {path}, {seconds:.0f} s (ROS_DOMAIN_ID={domain}, this host only)")
    with live_run("player", display, folder / "nodes.log") as run:
        _start(run, folder, valves, request)
        player = Player(run.node, {name: chosen.valve.id for name, chosen in valves.items()})
        page = _ready(run, player, request)
        _play(run, player, merged(source), seconds, request.speed)
        _show(run, SETTLE)
        if page and not run.asked:
            display.say(f"the record has ended; the page stays at {page}, Ctrl-C ends it")
            _show(run)
            run.asked.clear()
    shutil.rmtree(folder)
    return 130 if run.asked else 0


def merged(source: Source) -> Iterator[tuple[int, str, Block | Reading]]:
    """Yield blocks and readings of all valves of ``source`` by the time (ns) at which they are complete."""

    def of(name: str) -> Iterator[tuple[int, str, Block | Reading]]:
        for item in source.runs(name):
            for one in item.blocks() if isinstance(item, BlockRun) else (item,):
                length = round(1e9 * one.sample_period * len(one.body)) if isinstance(one, Block) else 0
                yield one.stamp + length, name, one

    yield from heapq.merge(*map(of, source.valves), key=lambda found: found[0])


def _duration(source: Source, span: Span) -> float:
    """Return about how long the record is, s."""
    if isinstance(source, TableSource):
        return source.record.time.size * source.record.period
    begin, end = source.received or (0, 0)
    return 1e-9 * max(0, min(end, span.until) - max(begin, span.since))


def _start(run: LiveRun, folder: Path, valves: dict[str, ChosenValve], request: PlayRequest) -> None:
    given = ["--params-file", str(request.params_file)] if request.params_file else []
    state = rule("state_folder", str(request.state or folder / "state"))
    for number, (name, chosen) in enumerate(valves.items()):
        file = folder / f"valve_{number}.yaml"
        described = chosen.valve.model_dump(mode="json", exclude_unset=True, exclude_none=True)
        file.write_text(yaml.safe_dump(described), encoding="utf-8")
        common = ["--ros-args", "-r", f"__ns:=/{name}", *given, *rule("use_sim_time", True)]
        valve_file = rule("valve_file", str(file))
        run.nodes.start(f"estimator {name}", "spool_estimator", "estimator", [*common, *valve_file])
        run.nodes.start(f"monitor {name}", "spool_monitor", "monitor", [*common, *state])
    if not request.no_web:
        page = [*rule("port", request.port), *rule("valves", list(valves)), *state]
        run.nodes.start("page", "spool_view", "page", ["--ros-args", *page])


def _ready(run: LiveRun, player: Player, request: PlayRequest) -> str:
    """Wait until the nodes listen; return the page's address, empty without a page."""
    deadline = time.monotonic() + START_UP
    page = None
    while not run.asked and not (player.heard and (page or request.no_web)):
        run.turn()
        page = re.search(r"the page is at (\S+)", run.nodes.log.read_text(errors="replace"))
        if time.monotonic() > deadline:
            raise InputError(
                f"the nodes do not listen after {START_UP:g} s: see {run.nodes.log}, or try ./spool doctor"
            )
    if page:
        run.display.say(f"the page is at {page[1]}")
    _show(run, 0.5)  # who is seen by us may not have seen us yet
    return page[1] if page else ""


def _play(
    run: LiveRun,
    player: Player,
    items: Iterator[tuple[int, str, Block | Reading]],
    seconds: float,
    speed: float,
) -> None:
    first = shift = 0
    turned = run.started = time.monotonic()
    for stamp, name, item in items:
        if not first:
            first = item.stamp
            shift = time.time_ns() - round(1e9 * seconds * (speed - 1.0)) - first
        due = run.started + 1e-9 * (stamp - first) / speed
        while not run.asked and ((now := time.monotonic()) < due or now - turned > TURN):
            if now - turned >= TURN:
                player.tell(first + shift + round(1e9 * (now - run.started) * speed))
                run.turn(0.0)
                turned = now
            time.sleep(max(0.0, min(due - time.monotonic(), TURN)))
        patience = time.monotonic() + PATIENCE
        while not run.asked and stamp + shift - _judged(run) > AHEAD and time.monotonic() < patience:
            run.turn(0.01)
        if run.asked:
            return
        player.send(name, replace(item, stamp=item.stamp + shift))


def _judged(run: LiveRun) -> int:
    """Return the time (ns) of the oldest of the valves' newest estimates; late without any."""
    stamps = [valve.estimate.header.stamp for valve in run.listener.valves.values() if valve.estimate]
    return min((stamp.sec * 1_000_000_000 + stamp.nanosec for stamp in stamps), default=ALWAYS)


def _show(run: LiveRun, seconds: float | None = None) -> None:
    """Show what comes for ``seconds``, or until somebody asks for the end."""
    end = None if seconds is None else time.monotonic() + seconds
    while not run.asked and (end is None or time.monotonic() < end):
        run.turn()

"""Process that hosts the nodes of many valves, and the sources of their samples."""

from __future__ import annotations

import contextlib
import gc
import math
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import rclpy
from rclpy.lifecycle import TransitionCallbackReturn
from spool_core.discovery import offered
from spool_core.errors import InputError
from spool_core.node.block_hub import BlockHub, Throttle, TopicTimes, Worker
from spool_core.node.diagnostics import DiagnosticPublisher, Level, Status
from spool_core.node.managed_node import HostContext, ManagedNode, Ticker
from spool_core.node.parameters import NodeParameter, refuse_other_files, refuse_other_nodes, rule
from spool_core.node.running import REFUSED, NodeExecutor, ensure_log_folder, finished, one_line
from spool_core.node.stop import STOP, Phase, StopRequested
from spool_core.system import BUDGET, resident_memory
from spool_core.text import plural
from spool_estimator.estimator_node import EstimatorNode
from spool_estimator.warm_up import warm_up_estimator
from spool_monitor.monitor_node import MonitorNode
from spool_monitor.warm_up import warm_up_monitor

from spool_bringup.host.arguments import (
    FirstList,
    ListedValve,
    arguments_of_nodes,
    arguments_of_process,
    names_for_all,
    node_name,
    read_valves,
    share,
)
from spool_bringup.host.supervisor import Heartbeat, notify

#: s between looks for a signal without work, and between looks at the nodes: noticed later by that, chosen.
TURN, LOOK = 0.1, 0.25
#: s that the start of a node is held up at most, and at least, for what waits of the nodes that run already,
#: and a turn of it.
LONGEST_TURNS, TURNS, IDLE = 0.05, 0.005, 0.001
#: Share of a core that refits may take, of which a start of 50 valves asks for more than two.
REFITS = 0.2
#: s after which a callback counts as hanging: it takes a millisecond.
LONGEST_CALL = 1.0
#: s between two reports of the host, and times within an hour that a node that hung or would not start is
#: begun again.
REPORT, TRIES = 1.0, 20
#: s from one try to the next: chosen, sooner fills the log, later leaves the valve unwatched.
AGAIN = 5.0
#: s after its start for which a process may be behind without a word.
STARTS = 20.0
#: s of samples that are taken together: 30 valves cost 0.58 core with each block by itself, 0.47 with 0.1 s,
#: 0.34 with 0.2 s, no less with 0.3 s; an event comes later by that.
TOGETHER = 0.2
#: s that blocks wait, or that were dropped of a valve in the last SPAN s: a warning, an error.
WARNS, FAILS = 0.5, 2.0
#: s without a moment of rest after which a process does not keep up, however short blocks wait: longer turns
#: save half of the work, so that the wait grows slowly. Of ten valves that keep up the longest was 0.2 s.
RESTLESS = 1.0
#: s of the clock that losses are looked back on.
SPAN = 10.0

#: Group of entry points, as ``simulator = spool_sim.simulator_node:SimulatorNode``. A driver joins by
#: another one: a managed node that sends by :class:`~spool_core.node.block_hub.BlockPublisher`.
SOURCES = "spool.sources"
NONE = "none"
CANNOT = "it cannot be started: see its log"


@dataclass(slots=True)
class Workload:
    """Workload of the valves of a process.

    Attributes:
        level: what it is now.
        wait: s, longest that blocks of a valve waited since the last :meth:`take`.
        text: what operators read, empty where the process keeps up.
    """

    level: Level = Level.OK
    wait: float = 0.0
    text: str = ""
    _restless: float = -math.inf
    _before: deque[tuple[float, dict[str, tuple[int, int, float]]]] = field(default_factory=deque)

    def take(self, now: float, times: Mapping[str, TopicTimes], behind: float, busy: float = 0.0) -> str:
        """Judge waits and losses at ``now`` (s, steady); return what to log where that became worse, else "".

        ``behind``: s of samples that wait now; ``busy``: s without a moment of rest until now.
        """
        self._restless = now if busy >= RESTLESS else self._restless
        counts = {name: (one.messages, one.dropped, one.seconds_dropped) for name, one in times.items()}
        self._before.append((now, counts))
        while self._before[0][0] < now - SPAN:
            self._before.popleft()
        first = self._before[0][1]
        new = [
            tuple(count - before for count, before in zip(count, first.get(name, count), strict=True))
            for name, count in counts.items()
        ]
        self.wait = max([behind, *(one.longest_wait for one in times.values())])
        worst = max([self.wait, *(one[2] for one in new)])
        before, self.level = self.level, Level.ERROR if worst >= FAILS else Level.WARNING
        if worst < WARNS and now - self._restless >= SPAN:
            self.level, self.text = Level.OK, ""
            return ""
        waited = [
            (one[1] > 0, held.longest_wait >= WARNS) for one, held in zip(new, times.values(), strict=True)
        ]
        judged, dropped = (sum(one[place] for one in new) for place in (0, 1))
        late = max([1, *map(sum, zip(*waited, strict=True))])
        self.text = (
            f"the controller is too busy: {judged:.0f} of {judged + dropped:.0f} blocks judged in the last "
            f"{SPAN:g} s, {late} of {len(times)} valves behind by up to {worst:.1f} s: use more processes or "
            "fewer valves"
        )
        return self.text if before is Level.OK else ""


@dataclass(slots=True)
class Hosted:
    """Node that is hosted: its state, and when it was begun again within the last hour."""

    node: ManagedNode
    valve: str
    tries: list[float] = field(default_factory=list)
    failed: str = ""
    due: float = 0.0

    def tried(self, now: float) -> int:
        """Return how often it was begun again in the hour before ``now``."""
        self.tries = [at for at in self.tries if now - at < 3600.0]
        return len(self.tries)


class HostNode(ManagedNode):
    """Node ``host``: estimators and monitors of many valves in a few processes."""

    PARAMETERS: ClassVar = (
        NodeParameter("valves_file", "", "YAML list of valves: namespace, and optionally valve_file."),
        NodeParameter(
            "state_folder",
            "",
            "Where the monitors keep alarms, baselines and trends; empty: as in the parameter file.",
        ),
        NodeParameter(
            "together",
            TOGETHER,
            "Samples of a valve that are taken together, which costs little more than one block; an estimate "
            "that falls due does not wait. 0: each block by itself, as it comes.",
            "s",
            0.0,
            0.4,
        ),
        NodeParameter(
            "source",
            NONE,
            "Source of each valve's blocks that runs in the host, which hands them over as they are: none, "
            "simulator, adapter, or what another package offers.",
        ),
        NodeParameter("processes", 1, "Processes over which the valves are spread.", minimum=1, maximum=64),
    )

    def deactivate(self) -> None:
        """Say that this stops none of the hosted nodes."""
        self.get_logger().warning("the hosted nodes stay active: each has its own life cycle")


@dataclass(slots=True)
class HostProcess:
    """Host process ``number`` of ``processes``."""

    arguments: Sequence[str]
    number: int = 0
    heartbeat: Heartbeat | None = None
    first_list: FirstList | None = None
    hosted: list[Hosted] = field(default_factory=list)
    _hub: BlockHub = field(default_factory=BlockHub)
    _context: HostContext = field(init=False)
    _worker: Worker = field(init=False)
    _node: HostNode = field(init=False)
    _executor: Any = field(init=False)
    _diagnostics: DiagnosticPublisher = field(init=False)
    _timer: Any = field(init=False)
    _started: float = 0.0
    _looked: float = 0.0
    _reported: float = 0.0
    _cpu: float = 0.0
    _throttle: Throttle = field(default_factory=Throttle)
    _workload: Workload = field(default_factory=Workload)

    @staticmethod
    def warm_up() -> None:
        """Compile what estimators and monitors need, or load it from the disk."""
        warm_up_estimator()
        warm_up_monitor()

    def run(self) -> int:
        """Start the nodes, spin until a signal, end them; return the exit code."""
        STOP.install()
        code = 0
        try:
            STOP.phase = Phase.STARTING
            ensure_log_folder()
            refuse_other_files(self.arguments)
            self.arguments = arguments_of_process(self.arguments, self.number)
            rclpy.init(args=self.arguments, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
            self._begin()
            code = 1  # from here on nothing that was given is wrong
            STOP.phase = Phase.RUNNING
            # The events executor has no end of a spin that is not a busy one.
            while not STOP.requested:
                self._guarded(self._executor.spin_once, TURN)
                now = time.monotonic()
                self._guarded(self._look, now)
                if now - self._reported >= REPORT:
                    self._guarded(self._report, now)
            code = 0
        except StopRequested:
            code = 0
        except (InputError, *REFUSED) as error:
            print(one_line(error), file=sys.stderr, flush=True)
            code = code or 2
        STOP.phase = Phase.ENDING
        if self._hub.worker is not None:
            self._hub.worker.close()
        for one in self.hosted:
            with contextlib.suppress(Exception):
                one.node.trigger_shutdown()
        if hasattr(self, "_executor"):
            with contextlib.suppress(Exception):
                self._node.trigger_shutdown()
            self._executor.shutdown()
        return finished(code, compiling=any(one.node.compiling for one in self.hosted))

    def _begin(self) -> None:
        # A section for nodes of every name holds parameters of some of them. What none of them has is refused
        # by the hosted nodes, when it is known which there are.
        shared, hub, ticker = names_for_all(self.arguments), self._hub, Ticker()
        self._context = HostContext(hub, ticker, shared, self._beat)
        self._node = HostNode(node_name(self.number), host=self._context)
        self._executor = NodeExecutor()
        self._executor.add_node(self._node)
        file = self._node.value("valves_file")
        valves = read_valves(file) if self.first_list is None else self.first_list.read(file)
        self._worker = hub.worker = Worker()
        hub.share(self._node, "accelerations")
        hub.together, hub.starting = self._node.value("together"), True
        BUDGET.share = REFITS
        steady = rclpy.clock.Clock(clock_type=rclpy.clock.ClockType.STEADY_TIME)

        def tick() -> None:
            hub.collect()
            ticker.run()

        self._timer = self._node.create_timer(Ticker.STEP, tick, clock=steady)
        self._diagnostics = DiagnosticPublisher(self._node)
        self._reported = self._looked = time.monotonic()
        # Each node costs more than the one before, as the middleware announces all end points: what takes
        # long is done before the first one listens. What lives then stays: no collector looks at it again.
        source = load_source(self._node.value("source"))
        kinds = (EstimatorNode, MonitorNode, *((source,) if source is not None else ()))
        mine = share(valves, self.number, self._node.value("processes"))
        tables = (parameter for kind in (HostNode, *kinds) for parameter in kind.PARAMETERS)
        self._context.of_others = shared & {parameter.name for parameter in tables}
        autostart = self._node.value("autostart")
        if autostart:
            self._node.trigger_configure()
        gc.disable()  # until all nodes live: each look of it goes through all that there are already
        for valve in mine:
            for kind in kinds:
                self._add(kind, valve)
                self._turns()
            if valve is mine[0]:
                self._check_names(valves)
        gc.collect()
        gc.freeze()
        for one in self.hosted:
            # An operator, or a new try after a failure, may have been sooner.
            if one.node.value("autostart") and one.node.is_inactive and not one.failed:
                self._change(one, one.node.trigger_activate)
                # What listens already is served while the others begin.
                self._turns()
        if autostart:
            self._node.trigger_activate()
        gc.freeze()
        gc.enable()
        self._started = time.monotonic()
        notify("READY=1")
        self._node.get_logger().info(f"{plural(len(self.hosted), 'node')} of {plural(len(mine), 'valve')}")

    def _check_names(self, valves: Sequence[ListedValve]) -> None:
        """Check that what was given is for nodes of the host, in whichever process.

        Raises:
            InputError: it is not.
        """
        kinds = [one.node.get_name() for one in self.hosted]
        own = self._node.get_fully_qualified_name()
        nodes = [f"/{valve.namespace}/{kind}" for valve in valves for kind in kinds]
        processes = range(1, self._node.value("processes"))
        nodes += [f"{own.removesuffix(f'_{self.number}')}_{number}" for number in processes]
        for doubt in refuse_other_nodes(self.arguments, own, nodes):
            self._node.get_logger().warning(doubt)

    def _add(self, kind: type[ManagedNode], valve: ListedValve) -> None:
        given = ["--ros-args", *arguments_of_nodes(self.arguments)]
        taken = {parameter.name for parameter in kind.PARAMETERS}
        own = {"valve_file": valve.valve_file, "state_folder": self._node.value("state_folder")}
        for name, value in own.items():
            if value and name in taken:
                given += rule(name, value)
        for name in ("autostart", "use_sim_time"):
            if name in self._node.given:
                given += rule(name, self._node.value(name))
        # The host's own arguments, its name among them, are not those of its nodes.
        node = kind(
            namespace=f"/{valve.namespace}", host=self._context, cli_args=given, use_global_arguments=False
        )
        one = Hosted(node, valve.namespace)
        self.hosted.append(one)
        self._executor.add_node(node)
        if node.value("autostart"):
            self._change(one, one.node.trigger_configure)

    @staticmethod
    def _change(one: Hosted, transition: Callable[[], TransitionCallbackReturn]) -> None:
        if transition() != TransitionCallbackReturn.SUCCESS:
            one.failed, one.due = CANNOT, time.monotonic() + AGAIN

    def _turns(self) -> None:
        """Work off what waits in executor and worker, so that a start delays no node that runs already."""
        self._beat()
        begun = time.monotonic()
        while not STOP.requested and (now := time.monotonic()) < begun + LONGEST_TURNS:
            self._guarded(self._executor.spin_once, IDLE)
            self._guarded(self._look, now)
            self._hub.collect()
            if now - begun >= TURNS and not self._worker.waiting:
                return

    def _guarded(self, action: Callable[[float], object], argument: float) -> None:
        """Do something; what it raises ends none of the nodes."""
        try:
            action(argument)
        except Exception as error:  # of the middleware, or of a callback that does not guard itself
            if self._throttle.take(type(error).__name__):
                self._node.get_logger().error(f"a callback failed: {error}")

    def _beat(self) -> None:
        if self.heartbeat is not None:
            self.heartbeat.beat(self.number)
        else:
            notify("WATCHDOG=1")

    def _look(self, now: float) -> None:
        """Give up what hangs, and begin again what failed."""
        if now - self._looked < LOOK:
            return
        self._looked = now
        self._beat()
        self._hub.flush(2.0 * self._hub.together)
        self._judge_workload(now)
        # A callback of this thread that took long, or a pause of the whole process, holds up the others.
        self._worker.look(2.0 * LOOK)
        owner = self._worker.hanging(LONGEST_CALL)
        if owner is not None and self._worker.give_up(owner):
            valve = next((one.valve for one in self.hosted if one.node is owner), None)
            for one in self.hosted:
                # Those that take the blocks of its valve stop together: they share them.
                if one.valve != valve or not isinstance(one.node, EstimatorNode | MonitorNode):
                    continue
                one.node.give_up()
                self._hub.give_up(one.node)
                one.failed, one.due = f"a callback did not return within {LONGEST_CALL:g} s", now + AGAIN
                self._node.get_logger().error(
                    f"{one.node.get_fully_qualified_name()}: {one.failed}; it is stopped, all others go on"
                )
        for one in self.hosted:
            if one.failed and now >= one.due and not one.node.busy and one.tried(now) < TRIES:
                one.tries.append(now)
                self._worker.admit(one.node)
                one.node.admit()
                self._begin_again(one)

    def _judge_workload(self, now: float) -> None:
        """Judge whether it keeps up, and save work where it does not; a change for the worse is reported."""
        hub = self._hub
        if hub.starting:  # what piles up meanwhile is no overload
            hub.starting = not self._started or (hub.behind >= WARNS and now - self._started <= STARTS)
            return
        busy = self._worker.busy
        level, worse = self._workload.level, self._workload.take(now, hub.times, hub.behind, busy)
        BUDGET.behind = busy >= RESTLESS or self._workload.wait >= WARNS
        if worse and (count := self._throttle.take("workload")):
            self._node.get_logger().warning(f"{worse} ({plural(count, 'time')})" if count > 1 else worse)
        if self._workload.level.value > level.value:
            self._report(now)

    def _begin_again(self, one: Hosted) -> None:
        one.failed = ""
        with contextlib.suppress(Exception):  # from whatever state it is in
            one.node.trigger_deactivate()
        with contextlib.suppress(Exception):
            one.node.trigger_cleanup()
        try:
            self._change(one, one.node.trigger_configure)
            if not one.failed:
                self._change(one, one.node.trigger_activate)
        except REFUSED:  # it is in a state that has no such transition: an operator shut it down
            one.failed, one.due = CANNOT, time.monotonic() + AGAIN

    def _report(self, now: float) -> None:
        times, cpu = self._hub.times, time.process_time()
        elapsed = max(now - self._reported, 1e-3)
        share_of_core = (cpu - self._cpu) / elapsed
        self._cpu, self._reported = cpu, now
        failed = [one for one in self.hosted if one.failed]
        level, text = self._workload.level, self._workload.text or f"{len(self.hosted)} nodes"
        if failed:
            level = Level.ERROR
            text = "; ".join(f"{one.node.get_fully_qualified_name()}: {one.failed}" for one in failed[:5])
        wait = max((one.longest_wait for one in times.values()), default=0.0)
        resident = resident_memory()
        valves = valve_timings(times, elapsed, resident)
        values: dict[str, object] = {
            "nodes": len(self.hosted),
            "nodes_failed": len(failed),
            "cpu_share": share_of_core,
            "cpu_time_s": f"{cpu:.3f}",
            "resident_B": resident,
            "jobs_waiting": self._worker.waiting,
            "longest_wait_s": wait,
            "blocks_dropped": sum(one.dropped for one in times.values()),
        }
        self._diagnostics.publish(Status("host", level, text, values), *valves)


def load_source(name: str) -> type[ManagedNode] | None:
    """Return the class of the source ``name``, ``None`` for none.

    Raises:
        InputError: no package offers it.
    """
    if name == NONE:
        return None
    entries = {one.name: one for one in offered(SOURCES)}
    if name not in entries:
        known = ", ".join([NONE, *entries])
        raise InputError(f"source: no package offers {name!r}; there are {known}")
    kind = entries[name].load()
    if not (isinstance(kind, type) and issubclass(kind, ManagedNode)):
        raise InputError(f"source: {entries[name].value} of {name!r} is no managed node")
    return kind


def valve_timings(times: Mapping[str, TopicTimes], elapsed: float, resident: int) -> list[Status]:
    """Return a task for each valve, and begin its next interval.

    Args:
        times: of each topic of blocks.
        elapsed: s, since the last call.
        resident: B, of the process; a valve is given its share.
    """
    found = []
    for topic, one in times.items():
        new = one.since()
        values: dict[str, object] = {
            "blocks": one.messages,
            "blocks_late": one.late,
            "blocks_lost": one.blocks_lost,
            "blocks_dropped": one.dropped,
            "blocks_waiting": one.waiting,
            "block_age_s": one.age,
            "longest_wait_s": one.longest_wait,
            "cpu_share": new.work / elapsed,
            "cpu_time_s": f"{one.work:.3f}",
            "resident_B": resident // len(times),
        }
        one.longest_wait = 0.0
        told = [f"{new.late} blocks late"] * (new.late > 0)
        told += [f"{new.blocks_lost} blocks lost"] * (new.blocks_lost > 0)
        told = told if new.messages else ["no blocks"]
        level = Level.WARNING if told else Level.OK
        found.append(Status(topic.strip("/").rpartition("/")[0], level, ", ".join(told) or "in time", values))
    return found

"""Demonstration: the main job live, its recording, the analysis of that and a report."""

from __future__ import annotations

import signal
import time
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from spool_bag.reading.information import BagInformation, describe
from spool_bag.reading.reader import BagReader
from spool_core.errors import InputError
from spool_core.node import qos
from spool_core.node.free_domain import isolate
from spool_core.node.parameters import rule
from spool_msgs.msg import HealthEvent, ModelEstimate, ValveHealth

from spool_tools.console.outputs import write_json
from spool_tools.operations.record_replay import replay_bag

from .display import Display
from .processes import Nodes
from .recording_report import write_report
from .scenario import DRIFT, VALVES, DemoValve

#: What is said of an event, by whether it was raised live and from the bag.
_RAISED = {
    (True, True): "raised live and again from the bag",
    (True, False): "raised live, but NOT from the bag",
    (False, True): "NOT raised live, but from the bag",
    (False, False): "NOT RAISED, neither live nor from the bag",
}

#: s, within which every node must be up and the first estimates be there.
START_UP = 30.0


def run_demo(seconds: float, out: Path) -> int:
    """Run the demonstration for ``seconds`` s into the folder ``out``; return the exit code.

    0: every event of the scenario was raised and no block was lost; 1: not so; 130: it was interrupted.

    Raises:
        InputError: ``out`` can't be used.
    """
    folder = _folder(out)
    domain = isolate()
    display = Display(seconds, tuple(valve.name for valve in VALVES))
    display.say(f"starting 7 nodes (ROS_DOMAIN_ID={domain}, this host only), recording to {folder / 'bag'}")
    events, whole = _live(seconds, folder, display)
    if not whole:
        return _say_interrupted(display, folder)
    information = describe(folder / "bag")
    display.say("analysing the bag ...")
    analysis = replay_bag(folder / "bag", [], baseline_time=_baseline(seconds))
    write_json(folder / "analysis.json", analysis)
    reader = BagReader(folder / "bag")
    plots = [write_report(folder, reader, analysis)]
    return _summarise(display, events, information, analysis, plots[0])


def _folder(out: Path) -> Path:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made: {error.strerror}") from error
    if any(out.iterdir()):
        number = 2
        while (out.parent / f"{out.name}_{number}").exists():
            number += 1
        out = out.parent / f"{out.name}_{number}"
        out.mkdir()
    return out


def _baseline(seconds: float) -> float:
    return min(15.0, 0.25 * seconds)


def _live(seconds: float, folder: Path, display: Display) -> tuple[list[tuple[str, HealthEvent]], bool]:
    """Run the nodes for ``seconds`` s; return the events as they came, and whether it ran to its end."""
    # Without handlers of rclpy a signal ends the wait for messages as it does any other Python.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    before = signal.signal(signal.SIGTERM, _as_interrupt)
    whole = False
    node = Node("demonstration")
    events: list[tuple[str, HealthEvent]] = []
    started: list[float] = []

    def elapsed() -> float:
        return time.monotonic() - started[0] if started else 0.0

    def on_event(name: str, message: HealthEvent) -> None:
        events.append((name, message))
        display.event(name, elapsed(), message)

    for valve in VALVES:
        name = valve.name
        node.create_subscription(
            ModelEstimate, f"/{name}/estimate", partial(display.estimates.__setitem__, name), qos.state()
        )
        node.create_subscription(
            ValveHealth, f"/{name}/health", partial(display.health.__setitem__, name), qos.state()
        )
        node.create_subscription(HealthEvent, f"/{name}/events", partial(on_event, name), qos.state(100))
    try:
        with Nodes(folder / "nodes.log") as nodes, display:
            try:
                _start(nodes, folder, seconds)
                _wait_for_data(node, nodes, display)
                started.append(time.monotonic())
                drifting = False
                while elapsed() < seconds:
                    rclpy.spin_once(node, timeout_sec=0.1)
                    display.refresh(elapsed())
                    _check(nodes)
                    if not drifting and elapsed() >= DRIFT[0] * seconds:
                        drifting = True
                        for valve in VALVES:
                            display.say(f"{elapsed():5.1f} s  · {valve.name}  {valve.story}")
                            _let_drift(node, valve, DRIFT[1] * seconds)
                whole = True
            except KeyboardInterrupt:
                display.say("interrupted: the nodes are ended in order ...")
            _stop(nodes)
    finally:
        signal.signal(signal.SIGTERM, before)
        node.destroy_node()
        rclpy.try_shutdown()
    return events, whole


def _stop(nodes: Nodes) -> None:
    """End the nodes: sources first, the recorder last, so that it keeps what the others say to the end."""
    nodes.stop(*(f"simulator {valve.name}" for valve in VALVES))
    nodes.stop(*(f"{kind} {valve.name}" for valve in VALVES for kind in ("monitor", "estimator")))
    nodes.stop("recorder", patience=20.0)


def _as_interrupt(_number: int, _frame: FrameType | None) -> None:
    """Let a request to end take the way of Ctrl-C."""
    raise KeyboardInterrupt


def _say_interrupted(display: Display, folder: Path) -> int:
    """Say what was recorded before Ctrl-C; return the exit code."""
    try:
        information = describe(folder / "bag")
    except InputError:
        display.say("interrupted before anything was recorded")
        return 130
    blocks = sum(valve.blocks for valve in information.valves)
    lost = sum(valve.lost_blocks for valve in information.valves)
    display.say(
        f"interrupted: {blocks} blocks recorded, {lost} lost, in {folder / 'bag'}; "
        f"see ./spool replay {folder / 'bag'}"
    )
    return 130


def _start(nodes: Nodes, folder: Path, seconds: float) -> None:
    names = [valve.name for valve in VALVES]
    output = [*rule("output", str(folder / "bag")), *rule("valves", names)]
    nodes.start("recorder", "spool_bag", "recorder", ["--ros-args", *output])
    for valve in VALVES:
        space = ["--ros-args", "-r", f"__ns:=/{valve.name}"]
        file = rule("valve_file", str(valve.valve_file))
        excitation = valve.write_excitation(folder, seconds)
        baseline = rule("baseline_time", _baseline(seconds))
        nodes.start(f"estimator {valve.name}", "spool_estimator", "estimator", [*space, *file])
        # A state of its own: what an earlier run learned is not to be compared with.
        kept = rule("state_folder", str(folder / "state"))
        nodes.start(f"monitor {valve.name}", "spool_monitor", "monitor", [*space, *baseline, *kept])
        # Estimator, monitor and recorder: so the bag begins with the first block.
        settings = [
            *rule("wait_for_subscribers", 3),
            *rule("excitation", str(excitation)),
            *rule("coulomb_force", valve.coulomb_force),
        ]
        nodes.start(f"simulator {valve.name}", "spool_sim", "simulator", [*space, *file, *settings])


def _wait_for_data(node: Node, nodes: Nodes, display: Display) -> None:
    deadline = time.monotonic() + START_UP
    while len(display.estimates) < len(VALVES):
        rclpy.spin_once(node, timeout_sec=0.1)
        _check(nodes)
        if time.monotonic() > deadline:
            raise InputError(f"no estimates after {START_UP:g} s: see {nodes.log}, or try ./spool doctor")


def _check(nodes: Nodes) -> None:
    dead = nodes.dead()
    if dead:
        raise InputError(f"node {dead[0]} ended by itself: see {nodes.log}")


def _let_drift(node: Node, valve: DemoValve, duration: float) -> None:
    """Set the simulator's drift parameters through the standard parameter service."""
    client = AsyncParameterClient(node, f"/{valve.name}/simulator")
    client.wait_for_services(timeout_sec=5.0)
    wanted = [
        Parameter("drift_target", value=valve.drift_target),
        Parameter("drift_duration", value=duration),
        Parameter("drift_quantity", value=valve.drift),
    ]
    answer = None
    # A node drops its answer to a client that it has not discovered yet; asking again changes nothing.
    for _ in range(3):
        future = client.set_parameters_atomically(wanted)
        rclpy.spin_until_future_complete(node, future, timeout_sec=2.0)
        answer = future.result() if future.done() else None
        if answer is not None:
            break
    result: SetParametersResult | None = answer.result if answer is not None else None
    if result is None or not result.successful:
        raise InputError(f"{valve.name}: the drift was refused: {result.reason if result else 'no answer'}")


def _summarise(
    display: Display,
    events: list[tuple[str, HealthEvent]],
    information: BagInformation,
    analysis: dict[str, Any],
    report: Path,
) -> int:
    lost = sum(valve.lost_blocks for valve in information.valves)
    blocks = sum(valve.blocks for valve in information.valves)
    raised = {(name, event.kind) for name, event in events if event.state == HealthEvent.STATE_RAISED}
    replayed = {
        (name, event["kind"])
        for name, valve in analysis["valves"].items()
        for event in valve["events"]
        if event["state"] == "raised"
    }
    wanted = {(valve.name, kind) for valve in VALVES for kind in ("resonance", "friction_drift")}
    display.say(f"\n{blocks} blocks recorded, {lost} lost; {information.size / 1e6:.1f} MB")
    for name, kind in sorted(wanted):
        display.say(
            f"{name}  {kind.replace('_', ' '):15} {_RAISED[(name, kind) in raised, (name, kind) in replayed]}"
        )
    for sentence in sorted({valve["limits"]["sentence"] for valve in analysis["valves"].values()}):
        display.say(f"analysed by {sentence}")
    display.say(f"bag, analysis and report: {report.parent}  (open {report.name} in a browser)")
    return 0 if lost == 0 and wanted <= raised and wanted <= replayed else 1

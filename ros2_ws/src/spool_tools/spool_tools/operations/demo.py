"""`./spool demo`: the scenario, what is shown of it, and the analysis at the end."""

from __future__ import annotations

import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
import yaml
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text
from spool_bag.information import describe
from spool_bag.reader import BagReader
from spool_core.errors import InputError
from spool_core.events.language import Language
from spool_core.events.sentences import language_of
from spool_core.node.network import isolate
from spool_core.node.parameters import rule
from spool_core.uncertainty import LEGEND
from spool_monitor.listener import HeardValve, Listener
from spool_msgs.msg import HealthEvent, Quantity, ValveHealth
from spool_report.outputs import write_json
from spool_sim.excitation import from_mapping

from spool_tools.operations.node_processes import Nodes
from spool_tools.operations.service_client import call
from spool_tools.operations.valve_rows import estimate_cells, event_line

#: Text for an event, by whether it was raised live and from the bag.
_RAISED = {
    (True, True): "raised live and again from the bag",
    (True, False): "raised live, but NOT from the bag",
    (False, True): "NOT raised live, but from the bag",
    (False, False): "NOT RAISED, neither live nor from the bag",
}

#: s, within which every node must be up and the first estimates be there.
START_UP = 60.0

#: Shares of the run: the machine runs steadily, passes the resonance, runs steadily while friction drifts.
PASSAGE = (0.38, 0.5, 0.62)
DRIFT = (0.63, 0.10)


@dataclass(frozen=True, slots=True)
class DemoValve:
    """Valve of the demonstration.

    ``steady_speed`` and ``resonant_speed`` (rpm) of the shaft that shakes it; ``drift`` is the quantity that
    changes, from its start value to ``drift_target`` (SI unit).
    """

    name: str
    valve_file: str
    coulomb_force: float
    steady_speed: float
    resonant_speed: float
    drift: str
    drift_target: float
    story: str

    def excitation(self, seconds: float) -> dict[str, Any]:
        """Return the excitation of a run of ``seconds`` s as it stands in the YAML file."""
        begin, middle, end = (share * seconds for share in PASSAGE)
        profile = [
            [0.0, self.steady_speed],
            [begin, self.steady_speed],
            [middle, self.resonant_speed],
            [end, self.steady_speed],
        ]
        return {
            "kind": "machine_orders",
            "speed_profile": profile,
            "orders": [[1.0, 8.0], [2.0, 2.0]],
            "broadband_rms": 1.5,
        }

    def write_excitation(self, folder: Path, seconds: float) -> Path:
        """Write the excitation as a YAML file that the simulator node takes; return its path."""
        mapping = self.excitation(seconds)
        from_mapping(mapping)
        path = folder / f"excitation_{self.name}.yaml"
        path.write_text(yaml.safe_dump(mapping, sort_keys=False), encoding="utf-8")
        return path


VALVES = (
    DemoValve(
        name="valve_1",
        valve_file="4weh10_soft",
        coulomb_force=0.1,
        steady_speed=1500.0,
        resonant_speed=900.0,
        drift="coulomb_force",
        drift_target=0.35,
        story="dirty oil: Coulomb friction rises from 0.10 to 0.35 N",
    ),
    DemoValve(
        name="valve_2",
        valve_file="4weh10_stiff",
        coulomb_force=0.1,
        steady_speed=1080.0,
        resonant_speed=1720.0,
        drift="viscous_coefficient",
        drift_target=1.6,
        story="wear: the viscous coefficient falls from 2.65 to 1.60 N s/m",
    ),
)

_LEVELS = {
    ValveHealth.LEVEL_OK: ("OK", "bold green"),
    ValveHealth.LEVEL_WARNING: ("WARNING", "bold yellow"),
    ValveHealth.LEVEL_ALARM: ("ALARM", "bold red"),
    ValveHealth.LEVEL_STALE: ("STALE", "bold magenta"),
}

#: s between status lines off a terminal.
_LINE_INTERVAL = 5.0


def run_demo(seconds: float, out: Path) -> int:
    """Run the demonstration for ``seconds`` s into the folder ``out``; return the exit code.

    0: every event of the scenario was raised and no block was lost; 1: not so; 130: it was interrupted.

    Raises:
        InputError: ``out`` can't be used.
    """
    from spool_report.recording_report import write_report  # noqa: PLC0415 - matplotlib, after the run only
    from spool_report.runs.record_replay import ReplayOptions, replay_bag  # noqa: PLC0415 - loads SciPy

    folder = _folder(out)
    domain = isolate()
    display = Display(seconds, tuple(valve.name for valve in VALVES))
    display.say(f"starting 7 nodes (ROS_DOMAIN_ID={domain}, this host only), recording to {folder / 'bag'}")
    events, whole = _live(seconds, folder, display)
    if not whole:
        try:
            information = describe(folder / "bag")
        except InputError:
            display.say("interrupted before anything was recorded")
            return 130
        recorded = sum(valve.blocks for valve in information.valves)
        missing = sum(valve.lost_blocks for valve in information.valves)
        display.say(
            f"interrupted: {recorded} blocks recorded, {missing} lost, in {folder / 'bag'}; "
            f"see ./spool replay {folder / 'bag'}"
        )
        return 130
    information = describe(folder / "bag")
    display.say("analysing the bag ...")
    analysis = replay_bag(folder / "bag", [], ReplayOptions(baseline_time=_baseline(seconds)))
    write_json(folder / "analysis.json", analysis)
    reader = BagReader(folder / "bag")
    report = write_report(folder, reader, analysis)
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
    display.say(f"\n{blocks} blocks recorded, {lost} lost; {information.size_bytes / 1e6:.1f} MB")
    for name, kind in sorted(wanted):
        display.say(
            f"{name}  {kind.replace('_', ' '):15} {_RAISED[(name, kind) in raised, (name, kind) in replayed]}"
        )
    for sentence in sorted({valve["limits"]["sentence"] for valve in analysis["valves"].values()}):
        display.say(f"analysed by {sentence}")
    display.say(f"bag, analysis and report: {report.parent}  (open {report.name} in a browser)")
    return 0 if lost == 0 and wanted <= raised and wanted <= replayed else 1


@dataclass(slots=True)
class Display:
    """Display of what arrives; on a terminal a table that is renewed, off it a line now and then."""

    seconds: float
    names: tuple[str, ...]
    console: Console = field(default_factory=lambda: Console(highlight=False))
    language: Language = field(default_factory=language_of)
    valves: Mapping[str, HeardValve] = field(default_factory=dict)
    _live: Live | None = None
    _last: float = 0.0

    def __enter__(self) -> Display:
        self.say(f"estimates {LEGEND}")
        if self.console.is_terminal:
            self._live = Live(self._table(0.0), console=self.console, refresh_per_second=4)
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def refresh(self, elapsed: float) -> None:
        """Show the state ``elapsed`` s after the start."""
        if self._live is not None:
            self._live.update(self._table(elapsed))
        elif time.monotonic() - self._last >= _LINE_INTERVAL:
            self._last = time.monotonic()
            for name in self.names:
                line = "  ".join(cell.plain for cell in self._cells(name))
                self.console.print(f"{elapsed:5.1f} s  {name}  {line}", soft_wrap=True)

    def event(self, name: str, elapsed: float, event: HealthEvent) -> None:
        """Show an event above the status."""
        raised = event.state == HealthEvent.STATE_RAISED
        mark = "▲" if raised else "▼"
        style = "yellow" if raised and event.severity == HealthEvent.SEVERITY_WARNING else "red"
        line = Text(f"{elapsed:5.1f} s  {mark} {name}  ", style=style if raised else "green")
        line.append(event_line(event, self.language), style="default")
        self.console.print(line, soft_wrap=True)

    def say(self, text: str) -> None:
        """Show a line of what is going on."""
        self.console.print(text, soft_wrap=True)

    def _table(self, elapsed: float) -> Group:
        table = Table(box=None, pad_edge=False)
        columns = ("valve", "shakes at", "natural", "stiffness", "viscous", "Coulomb", "health")
        for column in columns:
            table.add_column(column, no_wrap=True)
        for name in self.names:
            table.add_row(name, *self._cells(name))
        left = max(0.0, self.seconds - elapsed)
        return Group(Text(f"{elapsed:5.1f} s of {self.seconds:g} s, {left:.0f} s left", style="dim"), table)

    def _cells(self, name: str) -> list[Text]:
        valve = self.valves.get(name)
        if valve is None or valve.health is None or valve.estimate is None:
            return [Text("waiting", style="dim")]
        health = valve.health
        level, style = _LEVELS.get(health.level, ("?", "dim"))
        known = health.dominant_frequency.validity == Quantity.VALIDITY_VALID
        return [
            Text(f"{health.dominant_frequency.value:5.1f} Hz" if known else "no line "),
            *map(Text, estimate_cells(valve.estimate, "learning")),
            Text(level, style=style).append(f" {health.summary}", style="default"),
        ]


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
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    # Taken note of: an exception might be raised, and lost, while something is finalised.
    asked: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: asked.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    node = Node("demonstration")
    events: list[tuple[str, HealthEvent]] = []
    started: list[float] = []

    def elapsed() -> float:
        return time.monotonic() - started[0] if started else 0.0

    def on_event(name: str, message: HealthEvent) -> None:
        events.append((name, message))
        display.event(name, elapsed(), message)

    listener = Listener(node, display.names, on_event=on_event)
    display.valves = listener.valves
    try:
        with Nodes(folder / "nodes.log") as nodes, display:
            _start(nodes, folder, seconds)
            _wait_for_data(node, nodes, display, asked)
            started.append(time.monotonic())
            drifting = False
            while elapsed() < seconds and not asked:
                rclpy.spin_once(node, timeout_sec=0.1)
                listener.fetch()
                display.refresh(elapsed())
                _check(nodes)
                if not drifting and elapsed() >= DRIFT[0] * seconds:
                    drifting = True
                    for valve in VALVES:
                        display.say(f"{elapsed():5.1f} s  · {valve.name}  {valve.story}")
                        _let_drift(node, valve, DRIFT[1] * seconds)
            if asked:
                display.say("interrupted: the nodes are ended in order ...")
            # Sources first, the recorder last, so that it keeps what the others say to the end.
            nodes.stop(*(f"simulator {valve.name}" for valve in VALVES))
            nodes.stop(*(f"{kind} {valve.name}" for valve in VALVES for kind in ("monitor", "estimator")))
            nodes.stop("recorder", patience=20.0)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        listener.close()
        node.destroy_node()
        rclpy.try_shutdown()
    return events, not asked


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
        # A separate state: what an earlier run learned is not to be compared with.
        kept = rule("state_folder", str(folder / "state"))
        nodes.start(f"monitor {valve.name}", "spool_monitor", "monitor", [*space, *baseline, *kept])
        # Estimator, monitor and recorder: so the bag begins with the first block.
        settings = [
            *rule("wait_for_subscribers", 3),
            *rule("excitation", str(excitation)),
            *rule("coulomb_force", valve.coulomb_force),
        ]
        nodes.start(f"simulator {valve.name}", "spool_sim", "simulator", [*space, *file, *settings])


def _wait_for_data(node: Node, nodes: Nodes, display: Display, asked: list[int]) -> None:
    deadline = time.monotonic() + START_UP
    while any(valve.estimate is None for valve in display.valves.values()) and not asked:
        rclpy.spin_once(node, timeout_sec=0.1)
        _check(nodes)
        if time.monotonic() > deadline:
            raise InputError(f"no estimates after {START_UP:g} s: see {nodes.log}, or try ./spool doctor")


def _check(nodes: Nodes) -> None:
    dead = nodes.dead()
    if dead:
        raise InputError(f"node {dead[0]} ended unexpectedly: see {nodes.log}")


def _let_drift(node: Node, valve: DemoValve, duration: float) -> None:
    """Set the simulator's drift parameters through the standard parameter service."""
    wanted = {"drift_target": valve.drift_target, "drift_duration": duration, "drift_quantity": valve.drift}
    request = SetParametersAtomically.Request(
        parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in wanted.items()]
    )
    server = f"{valve.name}/simulator"
    result = call(node, server, "set_parameters_atomically", request, SetParametersAtomically).result
    if not result.successful:
        raise InputError(f"{valve.name}: the drift was refused: {result.reason}")

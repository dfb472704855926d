"""`./spool demo`: the scenario, what is shown of it, and the analysis at the end."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from spool_bag.information import describe
from spool_bag.reader import BagReader
from spool_core.errors import InputError
from spool_core.node.network import isolate
from spool_core.node.parameters import rule
from spool_msgs.msg import HealthEvent
from spool_report.outputs import write_json
from spool_sim.excitation import from_mapping

from spool_tools.operations.live_run import Display, live_run
from spool_tools.operations.node_processes import Nodes
from spool_tools.operations.service_client import call

#: Text for an event, by whether it was raised live and from the bag.
_RAISED = {
    (True, True): "raised live and again from the bag",
    (True, False): "raised live, but NOT from the bag",
    (False, True): "NOT raised live, but from the bag",
    (False, False): "NOT RAISED, neither live nor from the bag",
}

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


def run_demo(seconds: float, out: Path) -> int:
    """Run the demonstration for ``seconds`` s into the folder ``out``; return the exit code.

    0: every event of the scenario was raised and no block was lost; 1: not so; 130: it was interrupted.

    Raises:
        InputError: ``out`` can't be used.
    """
    from spool_report.recording_report import write_report  # noqa: PLC0415 - matplotlib, after the run only
    from spool_report.requests import ReplayRequest  # noqa: PLC0415
    from spool_report.runs.record_replay import replay_bag  # noqa: PLC0415 - loads SciPy

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
    analysis = replay_bag(ReplayRequest(record=folder / "bag"), baseline_time=_baseline(seconds))
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
    with live_run("demonstration", display, folder / "nodes.log") as run:
        nodes = run.nodes
        _start(nodes, folder, seconds)
        run.wait_for_estimates()
        drifting = False
        while run.elapsed() < seconds and not run.asked:
            run.turn()
            if not drifting and run.elapsed() >= DRIFT[0] * seconds:
                drifting = True
                for valve in VALVES:
                    display.say(f"{run.elapsed():5.1f} s  · {valve.name}  {valve.story}")
                    _let_drift(run.node, valve, DRIFT[1] * seconds)
        if run.asked:
            display.say("interrupted: the nodes are ended in order ...")
        # Sources first, the recorder last, so that it keeps what the others say to the end.
        nodes.stop(*(f"simulator {valve.name}" for valve in VALVES))
        nodes.stop(*(f"{kind} {valve.name}" for valve in VALVES for kind in ("monitor", "estimator")))
        nodes.stop("recorder", patience=20.0)
    return run.events, not run.asked


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


def _let_drift(node: Node, valve: DemoValve, duration: float) -> None:
    wanted = {"drift_target": valve.drift_target, "drift_duration": duration, "drift_quantity": valve.drift}
    request = SetParametersAtomically.Request(
        parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in wanted.items()]
    )
    server = f"{valve.name}/simulator"
    result = call(node, server, "set_parameters_atomically", request, SetParametersAtomically).result
    if not result.successful:
        raise InputError(f"{valve.name}: the drift was refused: {result.reason}")

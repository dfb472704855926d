"""Many valves in one process: each node as before, and one that raises or hangs alone."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import yaml
from spool_core.node import qos
from spool_core.node.messages import from_block, to_block
from spool_core.node.parameters import rule
from spool_msgs.msg import AccelerationBlock, AccelerationBlocks, ModelEstimate
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve
from spool_tools.operations.node_processes import find_executable

if TYPE_CHECKING:
    from .conftest import Process, System, Topic

VALVES = [f"valve_{number}" for number in range(4)]
#: What one valve's estimator does with some blocks from number 300 on.
FAULTS = {
    "raises": "raise RuntimeError('broken on purpose')",
    "hangs": "\n            while True: pass",
    "deadlocks": "__import__('threading').Event().wait()",
    "never returns from a kernel": "forever()",
}
PROGRAM = """
import sys, numba
from spool_estimator.estimator_node import EstimatorNode
from spool_bringup.host.program import main

@numba.njit(nogil=True)
def forever():
    at = 0
    while at >= 0:
        at = (at + 1) % 1000
    return at

faults = 0
take = EstimatorNode._take

class Failing:
    def __init__(self, core):
        self.core = core

    def __getattr__(self, name):
        return getattr(self.core, name)

    def update(self, block, verdict):
        global faults
        if block.sequence >= 300 and faults < MOST:
            faults += 1
            FAULT
        return self.core.update(block, verdict)

def faulty(self, blocks):
    if self.get_namespace() == "/valve_1" and not isinstance(self._core, Failing):
        self._core = Failing(self._core)
    take(self, blocks)

EstimatorNode._take = faulty
sys.exit(main())
"""


class Feed:
    """Feed of all valves in real time, the same record for each."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.blocks = list(Simulator(find_valve("4weh10_soft"), PRESETS["multisine"]).records(40.0))
        self.sent = 0
        self.publishers = {
            name: system.node.create_publisher(
                AccelerationBlock, f"/{name}/acceleration", qos.samples_offered(50)
            )
            for name in VALVES
        }
        self.begin = 0.0

    def heard(self) -> bool:
        return all(publisher.get_subscription_count() for publisher in self.publishers.values())

    def turn(self) -> None:
        """Send what is due; after a pause of the machine only as much as a queue holds."""
        now = time.monotonic()
        self.begin = max(self.begin or now, now - (self.sent + 25) / 50.0)
        due = math.floor((now - self.begin) * 50.0)
        while self.sent < min(due, len(self.blocks)):
            message = from_block(self.blocks[self.sent], "4weh10_soft")
            for publisher in self.publishers.values():
                publisher.publish(message)
            self.sent += 1

    def until(self, met: Callable[[], object], what: str) -> None:
        def done() -> object:
            self.turn()
            return met()

        self.system.until(done, what)


@pytest.fixture(name="feed")
def _feed(system: System) -> Feed:
    return Feed(system)


@pytest.fixture(name="host")
def _host(system: System, tmp_path: Path) -> Callable[..., Process]:
    valves = tmp_path / "valves.yaml"
    valves.write_text("".join(f"- {{namespace: {name}}}\n" for name in VALVES), "utf-8")

    def start(program: str, *words: str, params_file: str = "", **parameters: str) -> Process:
        parameters.setdefault("valves_file", str(valves))
        given = [word for name, value in parameters.items() for word in rule(name, value)]
        files = ["--params-file", params_file] if params_file else []
        return system.fork(["-c", program, *words, "--ros-args", *files, *given], "host")

    return start


PLAIN = "import sys; from spool_bringup.host.program import main; sys.exit(main())"


def estimates(system: System) -> dict[str, Topic]:
    return {name: system.listen(ModelEstimate, f"/{name}/estimate", latched=True) for name in VALVES}


def stamps(topic: Topic) -> list[float]:
    return [one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec for one in topic.messages]


@pytest.mark.slow
def test_each_node_is_there_as_in_a_process_of_its_own(
    system: System, feed: Feed, host: Callable[..., Process], tmp_path: Path
) -> None:
    told = estimates(system)
    _ = system.diagnostics
    # A section for all nodes may hold parameters of some of them; one for the host holds for each process.
    sections = {
        "/**": {"together": 0.15, "memory": 3.0},
        "/host": {"state_folder": str(tmp_path / "2026")},
        "/valve_1/estimator": {"memory": 2.0},
    }
    text = yaml.safe_dump({name: {"ros__parameters": values} for name, values in sections.items()})
    (tmp_path / "my.yaml").write_text(text, "utf-8")
    process = host(PLAIN, "--processes", "2", params_file=str(tmp_path / "my.yaml"))
    feed.until(feed.heard, "all valves are heard")
    feed.until(lambda: all(len(one.heard) >= 8 for one in told.values()), "all valves are estimated")
    for name in VALVES:
        assert system.state(f"/{name}/estimator") == "active"
        assert system.state(f"/{name}/monitor") == "active"
        assert system.parameter(f"/{name}/monitor", "state_folder") == str(tmp_path / "2026")
        assert system.parameter(f"/{name}/estimator", "memory") == (2.0 if name == "valve_1" else 3.0)
    for name in ("/host", "/host_1"):
        assert system.state(name) == "active"
        assert system.parameter(name, "together") == 0.15
    (result,) = system.set_parameters("/valve_2/estimator", stale_after=2.5)
    assert result.successful
    system.change("/valve_3/monitor", "deactivate", "activate")
    last = {name: one.last for name, one in told.items()}
    stiffness = {name: one.parameters[0].value for name, one in last.items()}
    assert all(abs(value / 1632.0 - 1.0) < 0.02 for value in stiffness.values()), stiffness
    feed.until(
        lambda: float(system.numbers("host: valve_0")["cpu_share"]) > 0.0, "the processor's share is measured"
    )
    timing = system.numbers("host: valve_0")
    assert timing["blocks_lost"] == "0"
    assert float(timing["cpu_share"]) < 0.5
    assert 0.0 <= float(timing["longest_wait_s"]) < 1.0
    doctor = system.fork([str(find_executable("spool_bringup", "spool")), "doctor", "--live"], "doctor")
    feed.until(lambda: not doctor.alive, "the doctor is done")
    said = doctor.said
    assert "4 valves are hosted: blocks at most" in said
    assert "host_1: 4 nodes" in said
    assert process.end() == 0


def test_a_host_runs_the_sources_itself_and_others_hear_them_as_well(
    system: System, host: Callable[..., Process], tmp_path: Path
) -> None:
    """What its estimators have without a message comes over DDS as well, and costs them no block."""
    told = estimates(system)
    heard = system.listen(AccelerationBlock, "/valve_1/acceleration")
    # Few blocks: a machine that is too busy for more would lose some.
    (tmp_path / "my.yaml").write_text("/**: {ros__parameters: {block_rate: 10.0}}\n", "utf-8")
    listed = (tmp_path / "valves.yaml").read_text("utf-8")
    stiff = "- {namespace: valve_0, valve_file: 4weh10_stiff}"
    (tmp_path / "valves.yaml").write_text(listed.replace("- {namespace: valve_0}", stiff), "utf-8")
    process = host(PLAIN, source="simulator", params_file=str(tmp_path / "my.yaml"))
    system.until(lambda: all(len(one.heard) >= 5 for one in told.values()), "all valves are estimated")
    system.until(lambda: len(heard.heard) > 50, "others hear the blocks")
    sequences = [to_block(message).sequence for message in heard.messages]
    assert sequences == sorted(set(sequences))
    # With data sharing each of the readers, ten a valve, would have a thread.
    threads = [task.read_text("utf-8") for task in Path(f"/proc/{process.popen.pid}/task").glob("*/comm")]
    assert not [name for name in threads if name.startswith("dds.dsha")]
    for name, topic in told.items():
        assert system.state(f"/{name}/simulator") == "active"
        assert topic.last.lost_blocks == 0
        valve = find_valve("4weh10_stiff" if name == "valve_0" else "4weh10_soft")
        assert topic.last.parameters[0].value == pytest.approx(valve.spring_stiffness, rel=0.02)
    system.change("/valve_1/simulator", "deactivate")
    system.until(lambda: told["valve_1"].last.state == ModelEstimate.STATE_STALE, "its estimate is stale")
    assert told["valve_2"].last.state == ModelEstimate.STATE_TRACKING
    assert process.end() == 0


def test_one_message_has_the_blocks_of_many_valves(
    system: System, feed: Feed, host: Callable[..., Process]
) -> None:
    """Valves that it names are judged as by their own topics; one may send by itself, and none suffers."""
    told = estimates(system)
    _ = system.diagnostics
    single = feed.publishers.pop("valve_3")
    for publisher in feed.publishers.values():
        system.node.destroy_publisher(publisher)
    shared = system.node.create_publisher(AccelerationBlocks, "/accelerations", qos.samples_offered(50))
    names = ["valve_0", "/valve_1", "valve_2", "nobody's"]

    class Both:
        def publish(self, message: AccelerationBlock) -> None:
            single.publish(message)
            missing = message.sequence == 200  # two names, no block: it counts as lost
            shared.publish(AccelerationBlocks(names=names, blocks=[] if missing else [message] * len(names)))

    feed.publishers = {"both": Both()}  # type: ignore[dict-item]
    process = host(PLAIN)
    listening = shared.get_subscription_count, single.get_subscription_count
    feed.system.until(lambda: all(count() for count in listening), "the host listens")
    stiffness = pytest.approx(find_valve("4weh10_soft").spring_stiffness, rel=0.02)

    def right(topic: Topic) -> bool:
        return any(one.last_sequence > 200 and one.parameters[0].value == stiffness for one in topic.messages)

    feed.until(lambda: all(map(right, told.values())), "all valves are estimated")

    def lost(name: str) -> int:  # on the way: a host that is too busy drops others, and says so
        numbers = system.numbers(f"host: {name}")
        return int(numbers["blocks_lost"]) - int(numbers["blocks_dropped"])

    wanted = [1, 1, 1, 0]
    system.until(lambda: [lost(name) for name in VALVES] == wanted, "the message without blocks is lost")
    assert (
        "/accelerations: ignored 1 messages that are not blocks: not an AccelerationBlocks: 4 names"
        in process.said
    )
    assert process.end() == 0


@pytest.mark.parametrize(
    ("words", "parameters", "said"),
    [
        (
            ["--processes", "2"],
            {"source": "nothing"},
            "no package offers 'nothing'; there are none, adapter, ",
        ),
        ([], {"valves_file": "none.yaml"}, "give a list of valves"),
        ([], {"params_file": "my.yaml"}, "/valve_0/estimator: parameter memry is unknown"),
        (["--cpus", "9999"], {}, "cpus: "),
        (["--priority", "100"], {}, "priority: "),
    ],
)
def test_what_a_host_cannot_do_is_refused_in_a_line(
    host: Callable[..., Process], tmp_path: Path, words: list[str], parameters: dict[str, str], said: str
) -> None:
    (tmp_path / "my.yaml").write_text("/**: {ros__parameters: {memry: 3.0}}\n", "utf-8")
    (tmp_path / "none.yaml").write_text("[]", "utf-8")
    process = host(PLAIN, *words, **parameters)
    assert process.popen.wait(180) == 2
    assert any(said in line for line in process.said.splitlines())
    assert "Traceback" not in process.said


@pytest.mark.parametrize(
    "fault", [pytest.param(one, marks=() if one == "raises" else pytest.mark.slow) for one in FAULTS]
)
def test_a_valve_that_fails_costs_the_others_nothing(
    system: System, feed: Feed, host: Callable[..., Process], fault: str
) -> None:
    told = estimates(system)
    _ = system.diagnostics
    most = 20 if fault == "raises" else 3  # each hang costs the valve 6 s
    process = host(PROGRAM.replace("FAULT", FAULTS[fault]).replace("MOST", str(most)))
    feed.until(feed.heard, "all valves are heard")
    feed.until(lambda: feed.sent > 320, "the fault began")
    # A queue holds 50 blocks, 1 s: an estimator that stood still for longer would have lost some.
    late = 1e-9 * feed.blocks[900].stamp
    for name in (name for name in VALVES if name != "valve_1"):
        feed.until(lambda name=name: stamps(told[name])[-1:] > [late], f"{name} goes on")
        assert told[name].last.lost_blocks == 0
    said = process.said
    if fault == "raises":
        assert "broken on purpose" in said
    else:
        assert "/valve_1/estimator: a callback did not return within 1 s" in said
    if fault == "hangs":
        feed.until(lambda: stamps(told["valve_1"])[-1] > stamps(told["valve_0"])[-1] - 3.0, "it is back")
    process.end()


@pytest.mark.slow
def test_a_hundred_namespaces_answer_for_their_life_cycles(
    system: System, host: Callable[..., Process], tmp_path: Path
) -> None:
    names = [f"valve_{number}" for number in range(100)]
    (tmp_path / "valves.yaml").write_text("".join(f"- {{namespace: {name}}}\n" for name in names), "utf-8")
    process = host(PLAIN, "--processes", "4")
    for name in names:
        for node in ("estimator", "monitor"):
            system.until(lambda node=f"/{name}/{node}": system.state(node) == "active", "it is active")
    assert process.end() == 0

"""All nodes of one valve in one process on a virtual clock: what they publish, record, keep and serve.

    ./spool python chain.py FOLDER

Only public calls of ROS are replaced: publish, call a service, read a clock. So real nodes with real messages
run faster than real time and in the same order each time, whatever they do inside. Then the clock stops,
and commands reach the nodes in the ROS domain that the line ``ready DOMAIN`` names, until the input ends.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import itertools
import json
import os
import socket
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from concurrent import futures
from pathlib import Path
from typing import Any

STEP, START, STEPS = 10_000_000, 1_735_732_800_000_000_000, 4600
clock = {"now": START}


def virtual(name: str, value: Callable[[], Any]) -> None:
    """Give modules of the suite a virtual clock; servers and libraries keep theirs."""
    real = getattr(time, name)

    def called() -> Any:
        return value() if sys._getframe(1).f_globals.get("__name__", "").startswith("spool_") else real()

    setattr(time, name, called)


virtual("time", lambda: clock["now"] * 1e-9)
virtual("time_ns", lambda: clock["now"])
virtual("monotonic", lambda: (clock["now"] - START) * 1e-9 + 1000.0)
os.environ["RCUTILS_CONSOLE_OUTPUT_FORMAT"] = "{severity} {name}: {message}"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
sys.path.append(str(Path(__file__).resolve().parent))

import rclpy  # noqa: E402 - after the clocks
from rclpy.client import Client  # noqa: E402
from rclpy.clock import Clock  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.publisher import Publisher  # noqa: E402
from rclpy.qos import DurabilityPolicy  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from rclpy.task import Future  # noqa: E402
from rclpy.time import Time  # noqa: E402
from reading import page_text, plain  # noqa: E402
from spool_core.node.network import claimed_domain  # noqa: E402

#: (s, topic, message) in order; (topic, data) not yet delivered; what late subscribers get.
said: list[tuple[float, str, Any]] = []
waiting: collections.deque[tuple[str, bytes]] = collections.deque()
latched: dict[str, collections.deque[bytes]] = {}
nodes: list[Any] = []
#: Timers with the time at which they are due, and subscriptions that are known.
due: dict[Any, int] = {}
joined: list[Any] = []
_publish, _call, _ready = Publisher.publish, Client.call_async, Client.service_is_ready


def seconds() -> float:
    return round((clock["now"] - START) * 1e-9, 3)


def publish(self: Any, message: Any) -> None:
    """Take a message; health goes by DDS as well, where readers fetch it themselves."""
    data = message if isinstance(message, bytes) else serialize_message(message)
    said.append((seconds(), self.topic_name, deserialize_message(data, self.msg_type)))
    if self.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        latched.setdefault(self.topic_name, collections.deque(maxlen=self.qos_profile.depth)).append(data)
    waiting.append((self.topic_name, data))
    if self.topic_name.endswith("/health"):
        _publish(self, message)


def service_of(name: str) -> Any:
    return next((one for node in nodes for one in node.services if one.service_name == name), None)


def call_async(self: Any, request: Any) -> Future:
    future, service = Future(), service_of(self.service_name)
    future.set_result(service.callback(request, service.srv_type.Response()))
    return future


def done_at_once(work: Any, loop: asyncio.AbstractEventLoop) -> Any:
    """Hand ``work`` to a server's thread and wait for it."""
    futures.wait([future := _threadsafe(work, loop)])
    return future


_threadsafe, asyncio.run_coroutine_threadsafe = asyncio.run_coroutine_threadsafe, done_at_once
Publisher.publish, Client.call_async = publish, call_async
Publisher.get_subscription_count = lambda self: 1
Client.service_is_ready = lambda self: service_of(self.service_name) is not None
Clock.now = lambda self: Time(nanoseconds=clock["now"], clock_type=self.clock_type)


def hand(subscription: Any, data: bytes) -> None:
    subscription.callback(data if subscription.raw else deserialize_message(data, subscription.msg_type))


def deliver() -> None:
    """Deliver what was published, in its order; a new subscription first gets what is latched."""
    while True:
        listening = [one for node in nodes for one in node.subscriptions]
        for one in [one for one in listening if one not in joined]:
            joined.append(one)
            for data in tuple(latched.get(one.topic_name, ())):
                if one.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
                    hand(one, data)
        if not waiting:
            return
        topic, data = waiting.popleft()
        for one in [one for one in listening if one.topic_name == topic]:
            hand(one, data)


def step() -> None:
    """Advance the clock by one step: deliver, then run the timers that are due."""
    clock["now"] += STEP
    deliver()
    for timer in [timer for node in nodes for timer in node.timers]:
        if due.setdefault(timer, clock["now"] - STEP + timer.timer_period_ns) <= clock["now"]:
            due[timer] += timer.timer_period_ns
            timer.callback()
            deliver()


def changed(node: Any, **values: Any) -> Any:
    return plain(node.set_parameters([Parameter(name, value=value) for name, value in values.items()]))


def started(kind: Any, *namespace: str, **values: Any) -> Any:
    node = kind(*namespace)
    nodes.append(node)
    changed(node, **values)
    node.trigger_configure()
    node.trigger_activate()
    deliver()
    return node


def ended(node: Any) -> None:
    node.trigger_deactivate()
    deliver()
    node.trigger_cleanup()
    nodes.remove(node)
    node.destroy_node()


def simulated() -> list[tuple[int, str, bytes]]:
    """Return what the simulator publishes: friction grows, blocks get lost, a pause, a dead sensor."""
    from spool_sim.simulator_node import SimulatorNode  # noqa: PLC0415

    node = started(SimulatorNode, "valve_1", seed=11, excitation="orders")
    feed: list[tuple[int, str, bytes]] = []
    for number in range(STEPS):
        before, now = len(said), number / 100
        if now == 14.0:
            changed(node, drift_target=0.9, drift_duration=3.0, drift_quantity="coulomb_force")
        step()
        for _, topic, message in said[before:] if not (10.0 < now < 10.3 or 28.0 < now < 33.0) else ():
            if now > 36.0 and topic.endswith("/acceleration"):
                message.spool = [0.0] * len(message.spool)
            if topic.startswith("/valve_1/"):
                feed.append((clock["now"], topic, serialize_message(message)))
    ended(node)
    return feed


#: What operators do, by s; parameters of a node or fields of a service.
ACTS: dict[float, tuple[str, str, dict[str, Any]]] = {
    21.0: ("monitor", "shelve_alarm", {"alarm": "resonance", "duration": 6e2, "shelved": True, "who": "Jan"}),
    22.0: ("monitor", "acknowledge_alarm", {"who": ""}),
    24.0: ("monitor", "", {"amplification_on": 2.75}),
    25.0: ("monitor", "acknowledge_alarm", {"alarm": "friction_drift", "who": "Eva", "comment": "known"}),
    26.0: ("monitor", "", {"stale_after": 2.5}),
    34.0: ("monitor", "reset_alarms", {"who": "Jan"}),
    34.5: ("monitor", "manage_baseline", {"action": 0}),
    38.0: ("recorder", "take_snapshot", {"valve": "valve_1", "who": "Eva", "comment": "look"}),
    39.0: ("monitor", "suppress_alarm", {"alarm": "stale", "suppressed": True, "who": "Eva"}),
    42.0: ("monitor", "", {"amplification_on": 0.1}),
}


def acted(name: str, service: str, fields: dict[str, Any]) -> Any:
    node = next(one for one in nodes if one.get_name() == name)
    if not service:
        return changed(node, **fields)
    found = service_of(f"{node.get_fully_qualified_name()}/{service}")
    try:
        return plain(found.callback(found.srv_type.Request(**fields), found.srv_type.Response()))
    except (AttributeError, AssertionError) as error:  # not known to this repository
        return str(error)


def lived(feed: list[tuple[int, str, bytes]], page: int, opcua: int) -> list[Any]:
    """Run all other nodes over ``feed``; return what operators were answered."""
    from spool_bag.recorder_node import RecorderNode  # noqa: PLC0415
    from spool_estimator.estimator_node import EstimatorNode  # noqa: PLC0415
    from spool_monitor.monitor_node import MonitorNode  # noqa: PLC0415
    from spool_opcua import opcua_node  # noqa: PLC0415
    from spool_view.page_node import PageNode  # noqa: PLC0415

    late = START + STEP - feed[0][0]
    clock["now"] = START
    said.clear()
    latched.clear()
    kept = {"snapshot_before": 2.0, "snapshot_after": 1.0, "depth": 100_000}
    started(RecorderNode, output="bag", valves=["valve_1"], machine="press", **kept)
    started(EstimatorNode, "valve_1")
    started(MonitorNode, "valve_1", state_folder="state", baseline_time=4.0)
    started(PageNode, state_folder="state", operator=True, metrics=True, port=page)
    opcua_node.START = 200.0  # s, on a busy machine
    started(opcua_node.OpcUaNode, port=opcua)
    answers, place = [], 0
    for number in range(STEPS):
        while place < len(feed) and feed[place][0] + late <= clock["now"] + STEP:
            waiting.append(feed[place][1:])
            place += 1
        step()
        if seconds() in ACTS:
            answers.append([*ACTS[seconds()], acted(*ACTS[seconds()])])
        if number % 100 == 0:
            time.sleep(0.03)  # DDS brings health
    return answers


def asked(address: str, path: str, body: str | None = None, **headers: str) -> dict[str, Any]:
    """Return the status, type and text of an answer; of a stream its first events."""
    request = urllib.request.Request(address + path, body.encode() if body else None, headers)
    lines, end = [], time.monotonic() + 20.0
    try:
        with urllib.request.urlopen(request, timeout=5.0 if "stream" in path else 30.0) as answer:
            with contextlib.suppress(TimeoutError):  # a stream does not end
                lines += (
                    line.decode() for line in itertools.takewhile(lambda _: time.monotonic() < end, answer)
                )
            if "stream" in path:
                lines = [one for one in dict.fromkeys(lines) if one not in ("event: beat\n", "data: {}\n")]
            text = "".join(lines)
            shown = page_text(text) if text.startswith("<!doc") else text.splitlines()
            return {"status": answer.status, "type": answer.headers["content-type"], "text": shown}
    except urllib.error.HTTPError as error:
        return {"status": error.code, "text": error.read().decode()}


def pages(address: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what the page's server answers, by request."""
    for path in (
        "/", "/alarms", "/history", "/valve/valve_1", "/valve/valve_9", "/trend?valve=valve_1", "/sparks",
        "/history.json", "/history.csv", "/gap?valve=valve_1", "/metrics", "/static/page.html",
        "/stream/machine", "/stream/valve/valve_1", "/nothing",
    ):  # fmt: skip
        yield f"page: GET {path}", asked(address, path)
    token = next(Path("state").rglob("token_*")).read_text("utf-8").strip()
    act = {"act": "acknowledge", "valve": "valve_1", "alarm": "data_fault", "occurrence": 1, "who": "Eva"}
    body, kind = json.dumps(act | {"comment": "x"}), {"Content-Type": "application/json", "Origin": address}
    allowed = kind | {"Authorization": f"Bearer {token}"}
    yield "page: POST /act without a token", asked(address, "/act", body, **kind)
    yield "page: POST /operator", asked(address, "/operator", "{}", **allowed)
    yield "page: POST /act of nothing", asked(address, "/act", '{"act": "dance"}', **allowed)
    with futures.ThreadPoolExecutor() as pool:
        answer = pool.submit(asked, address, "/act", body, **allowed)
        while not answer.done():  # the page asks the monitor in its turns
            for timer in [timer for node in nodes if node.get_name() == "page" for timer in node.timers]:
                timer.callback()
            time.sleep(0.01)
    yield "page: POST /act", answer.result()


async def browsed(address: str) -> dict[str, Any]:
    """Return type, value and quality of each variable, and the class of all else, by place."""
    from asyncua import Client as OpcUa  # noqa: PLC0415
    from asyncua.ua import NodeClass  # noqa: PLC0415

    found: dict[str, Any] = {}

    async def look(node: Any, path: str) -> None:
        for child in await node.get_children():
            place = f"{path}/{(await child.read_browse_name()).Name}"
            if place in found or (path == "" and place not in ("/Machines", "/Valves")):
                continue
            kind = await child.read_node_class()
            found[place] = kind.name
            if kind is NodeClass.Variable:
                data = await child.read_data_value(raise_on_bad_status=False)
                found[place] = f"{data.Value.VariantType.name} {data.Value.Value} {data.StatusCode.name}"
            await look(child, place)

    async with OpcUa(address) as client:
        await look(client.nodes.objects, "")
    return found


def hosted(domain: int) -> None:
    """Let other processes use services and latched topics until the input ends; the clock stands still."""
    executor = rclpy.executors.SingleThreadedExecutor()
    for node in [node for node in nodes if node.get_name() in ("monitor", "recorder", "estimator")]:
        type(node).subscriptions = property(lambda self: iter(()))
        executor.add_node(node)
    Publisher.publish, Client.call_async, Client.service_is_ready = _publish, _call, _ready
    for one in {one.topic_name: one for node in nodes for one in node.publishers}.values():
        for data in latched.get(one.topic_name, ()):
            _publish(one, data)
    print(f"ready {domain}", flush=True)
    os.set_blocking(0, False)
    while sys.stdin.buffer.raw.read(1) is None:
        executor.spin_once(timeout_sec=0.02)
    Publisher.publish = publish


def by_topic(name: str) -> dict[str, Any]:
    topics: dict[str, Any] = {}
    for when, topic, message in said:
        one = topics.setdefault(f"{name}: {topic}", {"type": type(message).__name__, "content": []})
        one["content"].append({"at": when, **plain(message)})
    return topics


def main(folder: Path) -> None:
    """Run the nodes, write what they said and serve, and let commands talk to them."""
    folder.mkdir(parents=True)
    os.chdir(folder)
    ports = []
    for _ in range(2):
        with socket.create_server(("127.0.0.1", 0)) as one:
            ports.append(one.getsockname()[1])
    with claimed_domain() as domain:
        rclpy.init(args=[], domain_id=domain)
        feed = simulated()
        results = by_topic("simulator")
        results["nodes: services"] = {"answers": lived(feed, *ports)}
        results |= by_topic("nodes") | dict(pages(f"http://127.0.0.1:{ports[0]}"))
        results["opcua"] = asyncio.run(browsed(f"opc.tcp://127.0.0.1:{ports[1]}"))
        Path("results.json").write_text(json.dumps(results), encoding="utf-8")
        hosted(domain)
        for node in reversed(nodes[:]):
            ended(node)
        rclpy.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())

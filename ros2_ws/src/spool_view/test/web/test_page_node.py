"""Each parameter of the page's node changes what browsers get."""

from __future__ import annotations

import json
import socket
import threading
import urllib.request
from pathlib import Path

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from spool_core.node import qos
from spool_msgs.msg import ValveHealth
from spool_view import recorded
from spool_view.page_node import PageNode

from .conftest import until


def test_each_parameter_changes_what_browsers_get(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without them: loopback and the usual folder, all valves, read only, no metrics and no recording."""
    read: list[tuple[Path, str]] = []
    monkeypatch.setattr(recorded, "recorded_spectra", lambda bags, name, *_: read.append((bags, name)) or [])
    with socket.socket() as probe:
        probe.bind(("127.0.0.2", 0))
        port = probe.getsockname()[1]
    values = {
        "address": "127.0.0.2", "port": port, "operator": True, "metrics": True, "valves": ["valve_2"],
        "state_folder": str(tmp_path / "own"), "bags": str(tmp_path / "bags"),
    }  # fmt: skip
    own, url = tmp_path / "own" / "web_page", f"http://127.0.0.2:{port}"
    rclpy.init()
    node, other, ended = PageNode(), rclpy.create_node("other"), threading.Event()
    node.alone = False
    assert set(values) == {one.name for one in node.PARAMETERS}
    node.set_parameters([Parameter(name, value=value) for name, value in values.items()])
    made = [other.create_publisher(ValveHealth, f"/valve_{n}/health", qos.state()) for n in (1, 2)]
    until(lambda: node.count_publishers("/valve_1/health"), "both valves are known")
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin() -> None:
        while not ended.is_set():
            executor.spin_once(timeout_sec=0.05)
            for publisher in made:
                publisher.publish(ValveHealth())

    def get(path: str, body: bytes | None = None, **headers: str) -> str:
        with urllib.request.urlopen(urllib.request.Request(url + path, body, headers)) as answer:
            return str(answer.read().decode())

    def serves() -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.2", port)) == 0

    thread = threading.Thread(target=spin)
    try:
        assert node.trigger_configure() == node.trigger_activate() == TransitionCallbackReturn.SUCCESS
        thread.start()
        until(serves, "the page is served")
        until(lambda: 'spool_valve_namur_status{valve="valve_2"}' in get("/metrics"), "the metrics")
        assert "valve_1" not in get("/metrics")
        token = (own / f"token_{port}").read_text().strip()
        headers = {"origin": url, "authorization": f"Bearer {token}"}
        assert json.loads(get("/operator", b"", **headers))["text"] == "right"
        with urllib.request.urlopen(f"{url}/stream/valve/valve_2"):
            until(lambda: read, "the recording is read")
        assert read[0] == (tmp_path / "bags", "valve_2")
    finally:
        ended.set()
        if thread.is_alive():
            thread.join()
        node.trigger_shutdown()
        executor.shutdown()
        for one in (node, other):
            one.destroy_node()
        rclpy.shutdown()
    assert not (own / f"token_{port}").exists()

"""Load of the page, measured: many valves, many readers; processor time and memory of the page's process.

./spool python ros2_ws/src/spool_view/test/web/measure_load.py --valves 100 --readers 10 --seconds 60

With --metrics the page serves /metrics, which is scraped once a second 50 times, then every 15 s.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from spool_core.node import qos
from spool_monitor.listener import DRIFT
from spool_msgs.msg import Alarm, AlarmList, ModelEstimate, Quantity, ValveHealth

#: s in which the page has to have heard all valves.
SETTLES = 30.0
#: Scrapes whose times are measured, and numbers of alarms of a valve.
SCRAPES, NUMBERS = 50, (100, 202, 301, 801)
#: Clock ticks of /proc a second, B a page.
_TICKS, _PAGE = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")


def main() -> int:
    """Measure, and print a line for no load, for the valves alone, and for valves with readers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--valves", type=int, default=100)
    parser.add_argument("--readers", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=60.0, help="that each load is measured for")
    parser.add_argument("--domain", type=int, default=99, help="ROS domain, of this alone")
    parser.add_argument("--metrics", action="store_true", help="serve and scrape /metrics")
    parser.add_argument("--speak", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    os.environ |= {"ROS_DOMAIN_ID": str(given.domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    if given.speak:
        _speak(given.valves)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        _measure(given.valves, given.readers, given.seconds, Path(folder), metrics=given.metrics)
    return 0


def _measure(valves: int, readers: int, seconds: float, folder: Path, *, metrics: bool) -> None:
    log = folder / "page.log"
    with log.open("wb") as stream:
        page = subprocess.Popen(
            [sys.executable, "-c", "from spool_view.program import page; page()",
             "--ros-args", "-p", "port:=0", "-p", f"metrics:={str(metrics).lower()}"],
            stdout=stream, stderr=stream,
        )  # fmt: skip
    speaker: subprocess.Popen[bytes] | None = None
    stop = threading.Event()
    try:
        while "page is at" not in log.read_text("utf-8"):
            time.sleep(0.1)
        port = int(log.read_text("utf-8").partition("page is at http://127.0.0.1:")[2].partition("/")[0])
        time.sleep(3.0)
        before = _say("no valve, no reader", page.pid, seconds / 4, 0)
        command = [sys.executable, __file__, "--speak", "--valves", str(valves)]
        speaker = subprocess.Popen([*command, "--domain", os.environ["ROS_DOMAIN_ID"]])
        time.sleep(SETTLES)
        if metrics:
            threading.Thread(target=_scrape, args=(port, stop), daemon=True).start()
        _say(f"{valves} valves, no reader", page.pid, seconds, before)
        paths = ["/stream/machine"] * readers
        _read(paths, port, stop)
        time.sleep(3.0)
        _say(f"{valves} valves, {readers} readers", page.pid, seconds, before)
        _read(["/stream/valve/load_0"], port, stop)
        time.sleep(3.0)
        _say(f"{valves} valves, {readers} readers, a valve's page", page.pid, seconds, before)
        begin = time.monotonic()
        page.send_signal(signal.SIGTERM)
        page.wait(10.0)
        print(f"ended after {time.monotonic() - begin:.2f} s with {readers + 1} streams open")
    finally:
        stop.set()
        for process in (page, speaker):
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()


def _say(what: str, process: int, seconds: float, before: int) -> int:
    """Print what ``process`` takes over ``seconds``, % of a core and MB; return the memory, B."""
    begin, ticks = time.monotonic(), _ticks(process)
    time.sleep(seconds)
    share = 100.0 * (_ticks(process) - ticks) / _TICKS / (time.monotonic() - begin)
    memory = int(Path(f"/proc/{process}/statm").read_text("utf-8").split()[1]) * _PAGE
    more = f" ({(memory - before) / 1e6:+.1f})" if before else ""
    print(f"{what}: {share:.2f} % of a core, {memory / 1e6:.1f} MB{more}", flush=True)
    return memory


def _ticks(process: int) -> int:
    fields = Path(f"/proc/{process}/stat").read_text("utf-8").rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12])


def _read(paths: list[str], port: int, stop: threading.Event) -> None:
    """Read streams until ``stop``, each in a thread."""

    def read(path: str) -> None:
        with socket.create_connection(("127.0.0.1", port)) as one:
            one.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
            while not stop.is_set() and one.recv(1 << 20):
                pass

    for path in paths:
        threading.Thread(target=read, args=(path,), daemon=True).start()


def _scrape(port: int, stop: threading.Event) -> None:
    """Scrape the metrics until ``stop``, and print how long the first scrapes took and what they brought."""
    took = []
    while not stop.is_set():
        begin = time.perf_counter()
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics") as answer:
                text = answer.read().decode()
        except OSError:  # the page has ended
            return
        took.append(1e3 * (time.perf_counter() - begin))
        if len(took) == SCRAPES:
            series = sum(not line.startswith("#") for line in text.splitlines())
            late = statistics.quantiles(took, n=100, method="inclusive")[98]
            told = f"median {statistics.median(took):.1f} ms, p99 {late:.1f} ms, longest {max(took):.1f} ms"
            print(f"{SCRAPES} scrapes: {told}, {series} series", flush=True)
        stop.wait(1.0 if len(took) < SCRAPES else 15.0)


def _speak(valves: int) -> None:
    """Publish what the nodes of ``valves`` would: health and estimates once a second, alarms once."""
    rclpy.init()
    node = Node("load")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    publishers = []
    for number in range(valves):
        health = node.create_publisher(ValveHealth, f"/load_{number}/health", qos.state())
        estimate = node.create_publisher(ModelEstimate, f"/load_{number}/estimate", qos.state())
        alarms = node.create_publisher(AlarmList, f"/load_{number}/alarms", qos.state())
        alarms.publish(AlarmList(alarms=[Alarm(name=str(one), code=one, state=2) for one in NUMBERS]))
        publishers.append((health, estimate))
    due = time.monotonic()
    while rclpy.ok():
        for number, (health, estimate) in enumerate(publishers):
            health.publish(_health(number))
            estimate.publish(_estimate())
            due += 1.0 / valves
            time.sleep(max(0.0, due - time.monotonic()))
        executor.spin_once(timeout_sec=0.0)


def _quantity(name: str, unit: str, value: float) -> Quantity:
    value *= random.uniform(0.99, 1.01)
    return Quantity(name=name, unit=unit, value=value, standard_deviation=0.01 * value, validity=1)


def _health(number: int) -> ValveHealth:
    return ValveHealth(
        level=1, baseline=2, summary=f"tracking, baseline learned {number}",
        judgements=[f"{one}: judged" for one in (*DRIFT, "resonance", "stuck_spool", "sensor_dead")],
        dominant_frequency=_quantity("dominant_frequency", "Hz", 21.0),
        amplification=_quantity("amplification", "1", 2.0),
        natural_frequency=_quantity("natural_frequency", "Hz", 28.7),
        viscous_drift=_quantity("viscous_drift", "1", 0.01),
        coulomb_drift=_quantity("coulomb_drift", "N", 0.01),
    )  # fmt: skip


def _estimate() -> ModelEstimate:
    parameters = [
        _quantity("spring_stiffness", "N/m", 5860.0),
        _quantity("viscous_coefficient", "N s/m", 8.2),
        _quantity("coulomb_force", "N", 0.1),
    ]
    natural = _quantity("natural_frequency", "Hz", 28.7)
    return ModelEstimate(model="coulomb", state=2, parameters=parameters, natural_frequency=natural)


if __name__ == "__main__":
    sys.exit(main())

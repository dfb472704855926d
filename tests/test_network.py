"""What other hosts get of nodes that are on this host only, tried from a second network namespace."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
#: Run in a new network namespace: a monitor, and a participant of another namespace that names its address.
TRIAL = """
import os, signal, subprocess, sys, time

def do(*words):
    subprocess.run(words, check=True)

def until(met):
    end = time.monotonic() + 60.0
    while not met():
        assert time.monotonic() < end
        time.sleep(0.1)

do("ip", "link", "set", "lo", "up")
other = subprocess.Popen(["unshare", "-n", "sleep", "600"])
place = ["nsenter", "-t", str(other.pid), "-n"]
own = os.readlink("/proc/self/ns/net")
until(lambda: os.readlink(f"/proc/{other.pid}/ns/net") != own)
do("ip", "link", "add", "here", "type", "veth", "peer", "name", "there", "netns", str(other.pid))
do("ip", "addr", "add", "10.77.0.1/24", "dev", "here")
do("ip", "link", "set", "here", "up")
for words in ("link set lo up", "addr add 10.77.0.2/24 dev there", "link set there up"):
    do(*place, "ip", *words.split())
node = [*sys.argv[1].split(), "--ros-args", "-r", "__ns:=/valve_1"]
inside = subprocess.Popen(node, start_new_session=True)
outside = dict(os.environ, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET", ROS_STATIC_PEERS="10.77.0.1")
outside |= {name: "" for name in outside if name.endswith("_PROFILES_FILE")}
until(lambda: ":7" in subprocess.run(["ss", "-unl"], capture_output=True, text=True).stdout)
try:
    given = (f"{name}={value}" for name, value in outside.items())
    do(*place, "env", *given, sys.executable, "-c", sys.argv[2])
finally:
    os.killpg(inside.pid, signal.SIGKILL)
    other.kill()
"""
LISTENS = """
import time, rclpy
from diagnostic_msgs.msg import DiagnosticArray
rclpy.init()
node, heard = rclpy.create_node("elsewhere"), []
node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)
end = time.monotonic() + 20.0
while not heard and time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
print("heard" if heard else "nothing", flush=True)
"""


def can() -> bool:
    """Return whether this machine lets a user make networks."""
    made = ["unshare", "-rn", "unshare", "-n", "true"]
    tools = all(map(shutil.which, ("unshare", "nsenter", "ip", "ss")))
    return tools and subprocess.run(made, capture_output=True, check=False).returncode == 0


@pytest.mark.skipif(sys.platform != "linux" or not can(), reason="no network can be made here")
@pytest.mark.parametrize(("profile", "said"), [(None, "nothing"), ("", "heard")])
def test_nobody_elsewhere_hears_a_node_that_is_started_for_this_host(profile: str | None, said: str) -> None:
    """With an empty profile, discovery range alone, it does: so the trial sees what it looks for."""
    environment = {name: value for name, value in os.environ.items() if "DISCOVERY_RANGE" not in name}
    environment["ROS_DOMAIN_ID"] = "77"
    if profile is not None:
        environment |= {f"{name}_DEFAULT_PROFILES_FILE": profile for name in ("FASTRTPS", "FASTDDS")}
    node = f"{ROOT / 'spool'} run spool_monitor monitor"
    done = subprocess.run(
        ["unshare", "-rn", sys.executable, "-c", TRIAL, node, LISTENS],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if said == "heard" and done.stdout.splitlines()[-1:] == ["nothing"]:
        pytest.skip("discovery between the two networks does not work here, so the trial shows nothing")
    assert done.stdout.splitlines()[-1:] == [said], done.stderr

"""The demonstration as a newcomer runs it: what it promises is in its bag, read by others' libraries."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from rosbags.highlevel import AnyReader
from spool_msgs.msg import HealthEvent

if TYPE_CHECKING:
    from .conftest import System

ROOT = Path(__file__).resolve().parent.parent
SECONDS = 40


@dataclass
class Demo:
    """A finished demonstration."""

    done: subprocess.CompletedProcess[str]
    folder: Path

    @property
    def bag(self) -> Path:
        return self.folder / "bag"

    def messages(self, topic: str) -> list[Any]:
        """Return the messages of ``topic`` as `rosbags` decodes them."""
        with AnyReader([self.bag]) as reader:
            chosen = [connection for connection in reader.connections if connection.topic == topic]
            return [
                reader.deserialize(data, connection.msgtype)
                for connection, _, data in reader.messages(connections=chosen)
            ]


@pytest.fixture(scope="module", name="demo")
def _demo(
    make_system: Callable[[Path], AbstractContextManager[System]], tmp_path_factory: pytest.TempPathFactory
) -> Demo:
    folder = tmp_path_factory.mktemp("demo") / "out"
    with make_system(folder.parent) as system:
        done = subprocess.run(
            [ROOT / "spool", "demo", "--seconds", str(SECONDS), "--out", folder],
            env={**os.environ, "ROS_DOMAIN_ID": str(system.domain_id)},
            capture_output=True,
            text=True,
            timeout=4 * SECONDS,
            check=False,
        )
    return Demo(done, folder)


pytestmark = pytest.mark.slow


def test_it_ends_well(demo: Demo) -> None:
    assert demo.done.returncode == 0, demo.done.stdout + demo.done.stderr
    assert "Traceback" not in demo.done.stderr
    reports = [path for path in demo.folder.iterdir() if path.suffix in (".html", ".svg", ".png")]
    assert reports
    assert all(path.stat().st_size > 1000 for path in reports)


@pytest.mark.parametrize(("valve", "frame"), [("valve_1", "4weh10_soft"), ("valve_2", "4weh10_stiff")])
def test_no_block_is_lost_and_what_happens_is_raised(demo: Demo, valve: str, frame: str) -> None:
    blocks = demo.messages(f"/{valve}/acceleration")
    assert len(blocks) >= SECONDS * 50
    assert [block.sequence for block in blocks] == list(range(len(blocks)))
    assert {block.header.frame_id for block in blocks} == {frame}
    estimates = demo.messages(f"/{valve}/estimate")
    assert len(estimates) >= SECONDS - 2
    assert estimates[-1].lost_blocks == 0
    assert estimates[-1].refused_blocks == 0
    assert len(demo.messages(f"/{valve}/health")) >= SECONDS - 2
    events = demo.messages(f"/{valve}/events")
    raised = {event.kind for event in events if event.state == HealthEvent.STATE_RAISED}
    assert raised >= {"resonance", "friction_drift"}
    assert len({event.header.frame_id for event in events}) == 1

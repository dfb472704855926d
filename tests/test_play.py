"""A record played to live nodes: its samples arrive as they are, and the page shows the valve."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from spool_bag.reader import BagReader
from spool_msgs.msg import AccelerationBlock, ModelEstimate

from .conftest import PATIENCE

if TYPE_CHECKING:
    from .conftest import System

ROOT = Path(__file__).resolve().parent.parent
BAG = ROOT / "bags" / "practice_03"
#: N/m and N, with which the record was simulated.
STIFFNESS, FRICTION = 1632.0, 0.5


def test_a_record_arrives_whole_and_now_and_the_page_stays(system: System, tmp_path: Path) -> None:
    blocks = system.listen(AccelerationBlock, "/valve_1/acceleration")
    estimates = system.listen(ModelEstimate, "/valve_1/estimate")
    said = tmp_path / "said"
    with said.open("wb") as output:
        process = subprocess.Popen(
            [ROOT / "spool", "play", BAG, "--valve", "4weh10_soft", "--speed", "5", "--port", "0"],
            env={**os.environ, "ROS_DOMAIN_ID": str(system.domain_id)},
            stdout=output,
            stderr=subprocess.STDOUT,
        )
    try:
        ended = "the page stays at "
        system.until(
            lambda: ended in said.read_text() or process.poll() is not None, "the end", 4.0 * PATIENCE
        )
        text = said.read_text()
        address = re.search(rf"{ended}(\S+), Ctrl-C", text)
        assert address, text
        with urllib.request.urlopen(address[1], timeout=PATIENCE) as page:
            assert page.status == 200
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=PATIENCE) == 0
    finally:
        process.kill()
        process.wait()
    (valve,) = BagReader(BAG).valves
    wanted = [block for run in BagReader(BAG).runs(valve) for block in run.blocks()]
    assert [block.sequence for block in blocks.messages] == [block.sequence for block in wanted]
    for name in ("body", "spool"):
        played = np.concatenate([getattr(block, name) for block in blocks.messages])
        assert np.array_equal(played, np.concatenate([getattr(block, name) for block in wanted]))
    last = blocks.last.header.stamp
    assert abs(last.sec - time.time()) < 4.0 * PATIENCE
    # At the end of its sweep the record shakes too fast to determine the stiffness all the time.
    tracked = [one for one in estimates.messages if one.state == ModelEstimate.STATE_TRACKING]
    found = {quantity.name: quantity for quantity in tracked[-1].parameters}
    for name, truth in (("spring_stiffness", STIFFNESS), ("coulomb_force", FRICTION)):
        assert abs(found[name].value - truth) < 4.0 * found[name].standard_deviation

"""What has its final name is whole, however its writing ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from spool_bag.reader import BagReader
from spool_bag.writer import BagWriter
from spool_core.errors import InputError
from spool_core.system import leftovers, staged

WRITE = """
import sys
from spool_core.cdr import encode_block
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.writer import BagWriter
from spool_core.block import Block
import numpy as np
samples = np.zeros(40, np.float32)
try:
    with BagWriter(sys.argv[1], staged=True, flush_interval=0.0) as writer:
        channel = writer.add_topic("/valve_1/acceleration", ACCELERATION_BLOCK)
        for sequence in range(10):
            data = encode_block(Block(10**18 + sequence, sequence, 0.0005, samples, samples), "valve_1")
            writer.write(channel, 10**18 + sequence, data)
        print("half", flush=True)
        sys.stdin.read()
except KeyboardInterrupt:
    sys.exit(130)
"""


def started(target: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", WRITE, str(target)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "half\n"
    return process


def ended(process: subprocess.Popen[str], number: int) -> int:
    process.send_signal(number)
    process.communicate()
    return process.returncode


def test_an_interrupted_bag_leaves_nothing(tmp_path: Path) -> None:
    process = started(tmp_path / "bag")
    assert not (tmp_path / "bag").exists()
    assert ended(process, signal.SIGINT) == 130
    assert list(tmp_path.iterdir()) == []


def test_a_killed_writing_leaves_no_bag_is_told_and_cleaned_by_the_next(tmp_path: Path) -> None:
    assert ended(started(tmp_path / "bag"), signal.SIGKILL) == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".bag.partial-")
    assert leftovers(tmp_path / "bag") == [left]
    with pytest.raises(InputError, match=r"no such bag.*a killed process left .*\.bag\.partial-\d+ behind"):
        BagReader(tmp_path / "bag")
    process = started(tmp_path / "bag")
    assert not left.exists()
    process.communicate()
    assert process.returncode == 0
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    assert len(list(BagReader(tmp_path / "bag").blocks("valve_1"))) == 10


def test_what_another_process_is_writing_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / f".bag.partial-{os.getppid()}").mkdir()
    assert leftovers(tmp_path / "bag") == []


def test_a_file_gets_its_name_at_the_end_or_never(tmp_path: Path) -> None:
    target = tmp_path / "table.csv"
    with staged(target) as part:
        part.write_text("whole", "utf-8")
        assert not target.exists()
    assert target.read_text("utf-8") == "whole"

    def interrupted() -> None:
        with staged(tmp_path / "other.csv") as part:
            part.write_text("half", "utf-8")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == [target]


def test_a_place_taken_meanwhile_is_kept(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", staged=True)
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match="exists already"):
        writer.close()
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


def test_the_file_alone_tells_what_rosbag2_asks_of_it(bag: Path) -> None:
    with (bag / "whole_0.mcap").open("rb") as stream:
        (record,) = [one for one in make_reader(stream).iter_metadata() if one.name == "rosbag2"]
    told = yaml.safe_load(record.metadata["serialized_metadata"])
    in_the_folder = yaml.safe_load((bag / "metadata.yaml").read_text("utf-8"))["rosbag2_bagfile_information"]
    assert told == in_the_folder
    assert (told["ros_distro"], told["message_count"]) == ("jazzy", 200)

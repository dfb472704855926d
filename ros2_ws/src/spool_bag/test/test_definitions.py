from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from spool_bag.metadata import ACCELERATION_BLOCK, TEMPERATURE, definition, starts_with_header
from spool_core.errors import InputError

OURS = [
    f"spool_msgs/msg/{name}" for name in ("AccelerationBlock", "ModelEstimate", "ValveHealth", "HealthEvent")
]


@pytest.mark.parametrize("name", [*OURS, TEMPERATURE, "diagnostic_msgs/msg/DiagnosticArray"])
def test_digest_is_the_one_that_rosidl_wrote(name: str) -> None:
    package, _, kind = name.split("/")
    for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep):
        path = Path(prefix) / "share" / package / "msg" / f"{kind}.json"
        if path.is_file():
            break
    hashes = {
        entry["type_name"]: entry["hash_string"]
        for entry in json.loads(path.read_text("utf-8"))["type_hashes"]
    }
    assert definition(name).digest == hashes[name]


@pytest.mark.parametrize("name", [*OURS, TEMPERATURE])
def test_text_alone_is_enough_to_decode(name: str) -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition(name).text, name))
    assert store.hash_rihs01(name) == definition(name).digest


def test_text_keeps_the_units() -> None:
    assert "# m/s^2, valve body along the spool axis" in definition(ACCELERATION_BLOCK).text


def test_every_type_of_ours_starts_with_a_header() -> None:
    assert all(starts_with_header(name) for name in OURS)
    assert not starts_with_header("std_msgs/msg/String")


def test_unknown_type_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="nobody_msgs/msg/Nothing"):
        definition("nobody_msgs/msg/Nothing")


def test_works_without_rclpy() -> None:
    code = (
        "import sys; sys.modules['rclpy'] = None\n"
        "import spool_bag, spool_bag.reader\n"
        "import spool_bag.verification, spool_bag.information\n"
        "import spool_bag.export, spool_bag.recorder, spool_bag.metadata as d\n"
        "print(d.definition(d.ACCELERATION_BLOCK).digest)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == definition(ACCELERATION_BLOCK).digest

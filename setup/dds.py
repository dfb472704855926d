"""Fast DDS on this machine: UDP ports and shared memory."""

from __future__ import annotations

import socket
from pathlib import Path

# RTPS 2.5, 9.6.2.3: port = 7400 + 250 * domain + offset, one pair for every participant of the machine.
FIRST_PORT = 7400
DOMAIN_GAIN = 250
UNICAST_OFFSET = 10
PARTICIPANTS = 10
SEGMENT_PATTERNS = ("fastrtps_*", "fast_datasharing_*")


def network_problem(domain: int) -> str | None:
    """What keeps a participant of a ROS domain from getting its port, None where nothing does."""
    first = FIRST_PORT + DOMAIN_GAIN * domain + UNICAST_OFFSET
    reason = ""
    for port in range(first, first + 2 * PARTICIPANTS, 2):
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind(("", port))
            return None
        except (OSError, OverflowError) as error:
            reason = str(error)
    return f"no free UDP port from {first} on ({reason}): choose another ROS_DOMAIN_ID"


def left_behind(folder: Path) -> int:
    """How many shared-memory segments of Fast DDS no running process maps.

    Args:
        folder: where the system keeps shared memory.
    """
    segments = {str(path) for pattern in SEGMENT_PATTERNS for path in folder.glob(pattern)}
    # Lock files next to the segments are never mapped.
    segments = {name for name in segments if not name.endswith("_el") and "_port" not in name}
    for maps in Path("/proc").glob("[0-9]*/maps") if segments else ():
        try:
            text = maps.read_text()
        except OSError:
            continue
        segments = {name for name in segments if name not in text}
    return len(segments)

"""Month of recording, as fast as the disk takes it: a valve at 2 kHz, an alarm a day.

Prints the resident memory (kB) at the end of each day.
"""

from __future__ import annotations

import struct
import sys
import time
from pathlib import Path

import numpy as np
from rclpy.serialization import serialize_message
from spool_bag.metadata import ACCELERATION_BLOCK
from spool_bag.recorder import Recorded
from spool_bag.recording import Recording, RecordingSettings
from spool_bag.snapshot import HEALTH_EVENT, SnapshotKeeper, SnapshotWriter
from spool_bag.writer import PartLimits
from spool_core.block import Block
from spool_core.cdr import encode_block
from spool_core.events.event import Event, EventState, Severity
from spool_core.events.language import ENGLISH
from spool_core.node.messages import to_event_message
from spool_core.uncertainty import Quantity, Validity

#: Blocks of 400 samples a day.
SIZE, PERIOD = 400, 0.0005
DAY = round(86400 / (SIZE * PERIOD))
START, STEP = 1_700_000_000_000_000_000, 200_000_000
#: B that may wait while the disk is slower than this.
WAITING = 16_000_000


class Log:
    """Log that says errors only."""

    def info(self, message: str) -> None:
        """Say nothing."""

    def error(self, message: str) -> None:
        """Say what went wrong."""
        print(message, file=sys.stderr)


def resident() -> int:
    """Return the resident memory, kB."""
    lines = Path("/proc/self/status").read_text("utf-8").splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1])


def alarm(stamp: int) -> bytes:
    """Return a resonance alarm at ``stamp`` (ns) as CDR."""
    amplification = Quantity("amplification", "1", 4.0, 0.1, Validity.VALID)
    event = Event(stamp, "resonance", EventState.RAISED, Severity.ALARM, "", amplification, code=100)
    return bytes(serialize_message(to_event_message(event, "valve_1", ENGLISH)))


def main() -> None:
    """Record ``days`` into ``bag`` under ``quota``."""
    bag, snapshots, days, quota = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    rng = np.random.default_rng(1)
    payloads = []
    for _ in range(50):
        body, spool = rng.standard_normal((2, SIZE)).astype(np.float32)
        payloads.append(bytearray(encode_block(Block(START, 0, PERIOD, body, spool), "valve_1")))
    # Stamp and sequence stand where the definition has them: header first, then frame_id "valve_1".
    place = encode_block(Block(START, 2**40 + 7, PERIOD, body, spool), "valve_1").index(
        struct.pack("<Q", 2**40 + 7)
    )
    recording = Recording(Path(bag), RecordingSettings(PartLimits(600.0, 200_000_000, quota)), Log())
    writer = SnapshotWriter(SnapshotKeeper(), Path(snapshots), Log())
    for number in range(days * DAY):
        stamp = START + number * STEP
        data = payloads[number % len(payloads)]
        struct.pack_into("<iI", data, 4, stamp // 10**9, stamp % 10**9)
        struct.pack_into("<Q", data, place, number)
        messages = [Recorded("/valve_1/acceleration", ACCELERATION_BLOCK, stamp, stamp, bytes(data))]
        if number % DAY == DAY // 2:
            event = alarm(stamp)
            messages.append(Recorded("/valve_1/events", HEALTH_EVENT, stamp + 1, stamp, event, latched=True))
        for one in messages:
            recording.put(one)
            writer.keeper.take(one)
        if number % 5 == 0:
            writer.watch(stamp, 1000)
        if number % 500 == 0:
            while recording.state.waiting > WAITING:
                time.sleep(0.002)
        if number % DAY == DAY - 1:
            print(resident(), flush=True)
    writer.close()
    if not recording.close(120.0) or recording.lost:
        sys.exit(f"lost: {recording.lost}")


if __name__ == "__main__":
    main()

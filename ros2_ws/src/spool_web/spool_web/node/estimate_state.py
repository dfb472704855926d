"""State of an estimate, read from the serialised message: a tenth of the cost of decoding it whole."""

from __future__ import annotations

import struct

#: Representation of CDR, little endian (XCDR1), that Fast DDS writes on the machines that this runs on.
_LITTLE = b"\x00\x01"


def estimate_state(raw: bytes) -> int:
    """Return ``state`` of a serialised ``ModelEstimate``, 0 (unknown) where it can't be read.

    The message begins with its header (stamp: 8 B, ``frame_id``) and ``model``; ``state`` follows.
    """
    if raw[:2] != _LITTLE:
        return 0
    try:
        place = 12  # representation 4 B, stamp 8 B
        for _ in range(2):
            place = 4 + -(-(place - 4) // 4) * 4
            (length,) = struct.unpack_from("<I", raw, place)
            place += 4 + length
        return raw[place]
    except (struct.error, IndexError):
        return 0

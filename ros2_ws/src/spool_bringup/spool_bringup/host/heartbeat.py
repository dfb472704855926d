"""Heartbeat: when each host process last made progress, and what the service manager is told of it."""

from __future__ import annotations

import mmap
import os
import socket
import struct
import time


class Heartbeat:
    """Heartbeat of so many processes, in memory that they share after a fork."""

    def __init__(self, count: int) -> None:
        self._map = mmap.mmap(-1, 8 * count)

    def beat(self, number: int) -> None:
        """Say that process ``number`` makes progress."""
        struct.pack_into("<d", self._map, 8 * number, time.monotonic())

    def age(self, number: int) -> float:
        """Return how long ago process ``number`` did so, s."""
        (at,) = struct.unpack_from("<d", self._map, 8 * number)
        return time.monotonic() - float(at)


def notify(text: str) -> None:
    """Tell the service manager ``text`` (sd_notify(3)); without one nothing happens."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as connection:
            connection.connect(address)
            connection.sendall(text.encode())
    except OSError:
        return  # it went away: nobody is left to tell

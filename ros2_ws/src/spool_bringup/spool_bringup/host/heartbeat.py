"""Heartbeat: when each host process last made progress, and what the service manager is told of it."""

from __future__ import annotations

import mmap
import os
import socket
import struct
import time

#: Time of the last beat by the monotonic clock, s, and the process that beats.
_BEAT = struct.Struct("<dq")


class Heartbeat:
    """Heartbeat of so many processes, in memory that they share after a fork."""

    def __init__(self, count: int) -> None:
        self._map = mmap.mmap(-1, _BEAT.size * count)

    def beat(self, number: int, process: int | None = None) -> None:
        """Say that ``process``, this one where it is left out, is number ``number`` and makes progress."""
        _BEAT.pack_into(self._map, _BEAT.size * number, time.monotonic(), process or os.getpid())

    def forget(self, number: int) -> None:
        """Say that no process is number ``number``."""
        _BEAT.pack_into(self._map, _BEAT.size * number, 0.0, 0)

    def process(self, number: int) -> int:
        """Return the identifier of process ``number``, 0 where it never made progress."""
        return int(_BEAT.unpack_from(self._map, _BEAT.size * number)[1])

    def age(self, number: int) -> float:
        """Return how long ago process ``number`` did so, s."""
        return time.monotonic() - float(_BEAT.unpack_from(self._map, _BEAT.size * number)[0])


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

"""First list of valves: as a host read it at its start, for processes that are begun again later."""

from __future__ import annotations

import fcntl
import json
import os

from .valve_list import ListedValve, read_valves

#: B that a list takes at most, which the reader of YAML bounds.
_LARGEST = 1 << 26


class FirstList:
    """First list of valves, shared by the processes of a host after a fork.

    A file that is edited meanwhile changes nothing until the host is started anew: each process would take
    its share of another list, so that some valves had two estimators and some none.
    """

    def __init__(self) -> None:
        self._file = os.memfd_create("valves")

    def read(self, path: str) -> list[ListedValve]:
        """Return the list, read from ``path`` where no process has read it yet.

        Raises:
            InputError: as of :func:`~spool_bringup.host.valve_list.read_valves`.
        """
        fcntl.lockf(self._file, fcntl.LOCK_EX)
        try:
            text = os.pread(self._file, _LARGEST, 0)
            if text:
                return [ListedValve(*one) for one in json.loads(text)]
            valves = read_valves(path)
            os.pwrite(self._file, json.dumps([[one.namespace, one.valve_file] for one in valves]).encode(), 0)
            return valves
        finally:
            fcntl.lockf(self._file, fcntl.LOCK_UN)

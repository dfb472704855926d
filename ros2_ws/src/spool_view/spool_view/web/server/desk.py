"""Desk: what the server is given of the node, and nothing else of ROS."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spool_view.web.operator.act_log import ActLog
from spool_view.web.operator.acts import Act, Outcome
from spool_view.web.operator.token import OperatorToken
from spool_view.web.view.board import Board


@dataclass(frozen=True, slots=True)
class Desk:
    """Desk of a page: valves, where trends are kept, and, with an operator, ``do``, ``token`` and ``log``."""

    board: Board
    address: str
    state_folder: Path
    spectrum: Callable[[list[bytes]], dict[str, Any] | None]
    do: Callable[[Act], Future[Outcome]]
    token: OperatorToken | None
    log: ActLog | None
    warn: Callable[[str], object]

    @property
    def operable(self) -> bool:
        """Whether an operator may act; else the page is read only."""
        return self.token is not None and self.log is not None

"""Finding of a check: how bad it is, and what was found."""

from __future__ import annotations

from typing import NamedTuple


class Finding(NamedTuple):
    """Finding: ``level`` is ``ok``, ``warning`` or ``problem``; ``text`` what was found, and what to do."""

    level: str
    text: str

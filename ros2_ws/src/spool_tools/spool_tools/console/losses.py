"""Losses of a recording in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spool_bag.mcap.mcap_walk import Damage


def damaged_places(damages: Sequence[Damage]) -> str:
    """Return how many places of a bag are damaged, and how much of it."""
    places = "1 damaged place" if len(damages) == 1 else f"{len(damages)} damaged places"
    return f"{places} ({sum(damage.size for damage in damages)} bytes)"


def lost_messages(count: int, *, estimated: bool) -> str:
    """Return how many messages were lost, as well as it is known."""
    if estimated:
        return f"about {count}" if count else "an unknown number of"
    return str(count)

"""Qualities of service by kind of topic."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def profile(depth: int, *, reliable: bool, latched: bool = False) -> QoSProfile:
    """Return the quality of service that keeps the last ``depth`` messages.

    ``latched``: a late subscriber gets them.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def samples_offered(blocks_per_second: float) -> QoSProfile:
    """Offered for blocks of samples: reliable, so that a recorder may ask for it, one second deep."""
    return profile(max(10, round(blocks_per_second)), reliable=True)


def samples_wanted(depth: int = 50) -> QoSProfile:
    """Wanted by consumers of blocks: best effort, so that a slow one never holds the source up.

    The depth is a second at 50 blocks/s; with a busy consumer losses are counted by ``sequence``.
    """
    return profile(depth, reliable=False)


def state(depth: int = 1) -> QoSProfile:
    """Latched: a late subscriber gets the last ``depth`` messages."""
    return profile(depth, reliable=True, latched=True)


def diagnostics() -> QoSProfile:
    """As the standard diagnostics tools expect it."""
    return profile(10, reliable=True)

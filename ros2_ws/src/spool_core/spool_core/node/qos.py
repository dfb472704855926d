"""Qualities of service by kind of topic."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def samples_offered(blocks_per_second: float) -> QoSProfile:
    """Offered for blocks of samples: reliable, so that a recorder may ask for it, one second deep."""
    return _volatile(ReliabilityPolicy.RELIABLE, max(10, round(blocks_per_second)))


def samples_wanted(depth: int = 50) -> QoSProfile:
    """Wanted by consumers of blocks: best effort, so that a slow one never holds the source up.

    The depth is a second at 50 blocks/s; with a busy consumer losses are counted by ``sequence``.
    """
    return _volatile(ReliabilityPolicy.BEST_EFFORT, depth)


def state(depth: int = 1) -> QoSProfile:
    """Latched: a late subscriber gets the last ``depth`` messages."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def diagnostics() -> QoSProfile:
    """As the standard diagnostics tools expect it."""
    return _volatile(ReliabilityPolicy.RELIABLE, 10)


def _volatile(reliability: ReliabilityPolicy, depth: int) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=reliability,
        durability=DurabilityPolicy.VOLATILE,
    )

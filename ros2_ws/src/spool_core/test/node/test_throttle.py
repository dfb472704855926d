from __future__ import annotations

from spool_core.node.block_hub import Throttle


def test_the_first_is_told_at_once_and_later_ones_with_their_number() -> None:
    now = 0.0
    throttle = Throttle(period=10.0, clock=lambda: now)
    assert throttle.take("lost") == 1
    assert [throttle.take("lost") for _ in range(5)] == [0] * 5
    assert throttle.take("late") == 1  # another kind waits for itself only
    now = 10.0
    assert throttle.take("lost") == 6
    assert throttle.take("lost") == 0

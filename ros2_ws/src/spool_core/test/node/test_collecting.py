"""Single samples of two sensors: taken together, in the order of their arrival."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from spool_core.node import qos
from spool_core.node.managed_node import ManagedNode


def test_messages_of_two_topics_keep_their_order_and_one_that_fails_costs_no_other() -> None:
    boxes = {"body": [(b"1", 10), (b"3", 30), (b"5", 50)], "spool": [(b"2", 20), (b"4", 40)]}
    ticks: list[Any] = []
    failures: list[str] = []
    taken: list[tuple[str, bytes, int]] = []
    node = SimpleNamespace(
        open_mailbox=lambda _kind, topic, _profile: SimpleNamespace(
            arrivals=lambda: boxes[topic], subscription=topic
        ),
        every=lambda _period, callback, **_: ticks.append(callback),
        destroy_subscription=lambda _: None,
        _while_active=[],
        _log_failure=lambda what, error: failures.append(f"{what}: {error}"),
    )

    def body(data: bytes, arrival: int) -> None:
        if data == b"3":
            raise ValueError("a driver's mistake")
        taken.append(("body", data, arrival))

    def spool(data: bytes, arrival: int) -> None:
        taken.append(("spool", data, arrival))

    ManagedNode.collect(node, [(int, "body", body), (int, "spool", spool)], qos.samples_wanted())  # type: ignore[arg-type]
    ticks[0]()
    assert taken == [("body", b"1", 10), ("spool", b"2", 20), ("spool", b"4", 40), ("body", b"5", 50)]
    assert failures == ["a message could not be handled: a driver's mistake"]

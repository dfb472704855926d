"""Outcomes of faults, and the table of many."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of one fault.

    ``lost``: blocks that the fault cost, and ``lost_s`` the longest time that they span without the fault's
    own duration; ``unstated`` of these that neither the bag nor ``/diagnostics`` tells of; ``invented``:
    messages in the bag that nobody sent, or twice; ``tracebacks`` printed; ``wrong``: whatever else was
    promised and not kept, in words.
    """

    fault: str
    seed: int
    lost: int = 0
    lost_s: float = 0.0
    unstated: int = 0
    invented: int = 0
    tracebacks: int = 0
    wrong: str = ""

    @property
    def held(self) -> bool:
        """Whether the promise was kept: a second at most, everything stated, nothing made up."""
        return self.lost_s <= 1.0 and not (self.unstated or self.invented or self.tracebacks or self.wrong)


def table(outcomes: Iterable[Outcome]) -> str:
    """Return the outcomes by fault as Markdown."""
    by_fault: dict[str, list[Outcome]] = defaultdict(list)
    for one in outcomes:
        by_fault[one.fault].append(one)
    lines = [
        "| fault | injected | held | blocks lost, most | time lost, most (s) | unstated | invented "
        "| tracebacks |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    groups = [*sorted(by_fault.items()), ("all", [one for group in by_fault.values() for one in group])]
    for fault, group in groups:
        lines.append(
            f"| {fault} | {len(group)} | {sum(one.held for one in group)} "
            f"| {max(one.lost for one in group)} | "
            f"{max(one.lost_s for one in group):.2f} | {sum(one.unstated for one in group)} | "
            f"{sum(one.invented for one in group)} | {sum(one.tracebacks for one in group)} |"
        )
    return "\n".join(lines) + "\n"

"""Benchmarks against peers, on the same work in one run. Each is a module with ``run``."""

from __future__ import annotations

#: Each is a module of this package with ``run() -> Iterator[Row]``, and the options that its ``run`` takes.
BENCHMARKS: dict[str, tuple[str, ...]] = {
    "sim": (),
    "estimate": (),
    "gap": ("seed", "cases"),
    "host": ("seconds", "valves"),
    "record": ("seconds", "valves"),
}

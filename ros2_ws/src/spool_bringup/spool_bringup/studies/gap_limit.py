"""How small an effect is still named, beside the smallest that any program could see."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

from spool_blind.case import make
from spool_blind.effects import EFFECTS
from spool_blind.limit import limit_factor

from ..commands import write_json
from .gap import judge
from .workers import spread

#: Sizes that are tried, over the limit of seeing: this times powers of the step, down from the largest.
LARGEST, STEP, SMALLEST = 512.0, 2.0, 1.0
#: A size beyond this many times the clear one is not made larger.
LARGEST_FACTOR = 2.0


@dataclass(frozen=True, slots=True)
class Limit:
    """One effect under one condition.

    Attributes:
        effect: id.
        seed: of the condition.
        parameter: by which the size is told.
        visible: its value at the limit of seeing; ``None`` where no size is seen.
        named: its value at the smallest size that was named right, ``None`` where none was.
        ratio: of the sizes.
    """

    effect: str
    seed: int
    parameter: str
    visible: float | None
    named: float | None
    ratio: float | None


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[Limit]:
    """Look for the smallest size of each effect under ``cases`` conditions; write the table into ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    items = [(effect, seed + case) for case in range(cases) for effect in EFFECTS]
    limits: list[Limit] = []
    with (out / "limits.jsonl").open("w") as file:
        for limit in spread(smallest_named, items, f"{len(items)} limits", workers):
            limits.append(limit)
            file.write(json.dumps(asdict(limit)) + "\n")
            file.flush()
    write_json(out / "limits.json", [asdict(limit) for limit in limits])
    page = out / "limits.md"
    page.write_text(limits_text(limits, f"./spool study gap-limit --cases {cases} --seed {seed}"))
    print(page.read_text())
    return limits


def smallest_named(item: tuple[str, int]) -> Limit:
    """Halve the size of an effect until it is not named any more; return the smallest that was.

    Halving goes on past one size that is not named: chance decides near the limit.
    """
    effect, seed = item
    seen = limit_factor(seed, effect)
    parameter = next(iter(make(seed, effect, factor=1.0).truth[effect]))
    if math.isinf(seen):
        return Limit(effect, seed, parameter, None, None, None)
    ratio = min(LARGEST, STEP ** math.floor(math.log(LARGEST_FACTOR / seen, STEP)))
    smallest, missed = None, 0
    while ratio >= SMALLEST and missed < 2:
        if judge(make(seed, effect, factor=seen * ratio)).right:
            smallest, missed = ratio, 0
        else:
            missed += 1
        ratio /= STEP

    def value(factor: float) -> float:
        return make(seed, effect, factor=factor).truth[effect][parameter]

    named = None if smallest is None else value(seen * smallest)
    return Limit(effect, seed, parameter, value(seen), named, smallest)


def limits_text(limits: Sequence[Limit], command: str) -> str:
    """Return the table, Markdown."""
    lines = [
        f"Made by `{command}`. The limit of seeing is where a likelihood-ratio test that knows the effect",
        "finds it in half of the records, at one false alarm in a hundred; medians over the conditions.",
        "",
        "| effect | by | limit of seeing | named in half | ratio | named at any size |",
        "|---|---|---|---|---|---|",
    ]
    for effect in EFFECTS:
        these = [limit for limit in limits if limit.effect == effect]
        # Where a condition named nothing, its size counts as larger than all others.
        ratios = sorted(math.inf if limit.ratio is None else limit.ratio for limit in these)
        seen = [limit.visible for limit in these if limit.visible is not None]
        named = sorted(math.inf if limit.named is None else abs(limit.named) for limit in these)
        if not these or not seen:
            continue
        cells = [f"{median(map(abs, seen)):.2g}", *(_number(median(row)) for row in (named, ratios))]
        count = sum(limit.named is not None for limit in these)
        lines.append(f"| {effect} | {these[0].parameter} | {' | '.join(cells)} | {count}/{len(these)} |")
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    return "-" if math.isinf(value) else f"{value:.2g}"

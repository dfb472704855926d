"""How small an effect is still named, beside the limit of a likelihood-ratio test that knows the law."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from spool_blind.case import make
from spool_blind.effects import EFFECTS
from spool_blind.limit import limit_case
from spool_tools.commands.bag_commands import write_json

from .gap import judge
from .gap_limit_page import write_page
from .workers import spread

#: Sizes that are tried over the limit of seeing: powers of this, from the one to the other power.
STEP, LOWEST, HIGHEST = math.sqrt(2.0), -1, 14
#: The power that is tried first: twice the limit, the target.
FIRST = 2
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


def run(
    cases: int, seed: int, out: Path, workers: int | None = None, effects: Sequence[str] = tuple(EFFECTS)
) -> list[Limit]:
    """Look for the smallest size of each effect that is named, under ``cases`` conditions from ``seed`` on.

    ``out`` gets table and picture; what ``gap_limits.jsonl`` there holds already is not looked for again.
    """
    out.mkdir(parents=True, exist_ok=True)
    wanted = [(effect, seed + case) for case in range(cases) for effect in effects]
    kept = out / "gap_limits.jsonl"
    found = {(limit.effect, limit.seed): limit for limit in _kept(kept)}
    items = [item for item in wanted if item not in found]
    with kept.open("w") as file:
        file.writelines(json.dumps(asdict(limit)) + "\n" for limit in found.values())
        file.flush()
        for limit in spread(smallest_named, items, f"{len(items)} limits", workers):
            found[limit.effect, limit.seed] = limit
            file.write(json.dumps(asdict(limit)) + "\n")
            file.flush()
    limits = [found[item] for item in wanted]
    write_json(out / "gap_limits.json", [asdict(limit) for limit in limits])
    page = write_page(limits, out, f"./spool study gap-limit --cases {cases} --seed {seed} --out DIR")
    print(page.read_text())
    return limits


def _kept(path: Path) -> list[Limit]:
    if not path.exists():
        return []
    lines = path.read_text().splitlines()
    # The last line of a run that was ended may be half a line.
    return [Limit(**json.loads(line)) for line in lines if line.endswith("}")]


def smallest_named(item: tuple[str, int]) -> Limit:
    """Return the smallest size that is named right, by steps of half an octave over the limit of seeing.

    A size above the smallest is taken to be named, too, one below the largest that is not taken not to be.
    """
    effect, seed = item
    seen = limit_case(seed, effect, moderate=True)
    if seen is None:
        parameter = next(iter(make(seed, effect, factor=1.0, moderate=True).truth[effect]))
        return Limit(effect, seed, parameter, None, None, None)
    parameter, visible = next(iter(seen.truth[effect].items()))
    top = min(HIGHEST, math.floor(math.log(LARGEST_FACTOR / seen.factor, STEP)))
    values: dict[int, float] = {}

    def named(power: int) -> bool:
        case = make(seed, effect, factor=seen.factor * STEP**power, moderate=True)
        values[power] = case.truth[effect][parameter]
        return judge(case).right

    smallest = _smallest(named, top)
    if smallest is None:
        return Limit(effect, seed, parameter, visible, None, None)
    return Limit(effect, seed, parameter, visible, values[smallest], STEP**smallest)


def _smallest(named: Callable[[int], bool], top: int) -> int | None:
    """Return the smallest power that is ``named``, by strides from ``FIRST`` and then by halving."""
    low, high, stride = LOWEST - 1, min(FIRST, top), 2
    while not named(high):
        low = high
        if high >= top:
            return None
        high, stride = min(top, high + stride), 2 * stride
    while high - low > 1:
        middle = (low + high) // 2
        if named(middle):
            high = middle
        else:
            low = middle
    return high

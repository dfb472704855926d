"""Study of detection limits: how small an effect is named, against a likelihood-ratio test that knows it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from spool_blind.case import make
from spool_blind.effects import EFFECTS
from spool_blind.limit import limit_case

from spool_evaluation.results.page import renew_json, study_command

from .gap import judge
from .gap_limit_page import write_study
from .gap_limit_summary import DetectionLimit
from .workers import spread

#: Sizes that are tried over the detection limit: powers of this, from the one to the other power.
STEP, LOWEST, HIGHEST = math.sqrt(2.0), -1, 14
#: The power that is tried first: twice the limit, the target.
FIRST = 2
#: A size beyond this many times the clear one is not made larger.
LARGEST_FACTOR = 2.0


def run(
    cases: int, seed: int, out: Path, workers: int | None = None, effects: Sequence[str] = tuple(EFFECTS)
) -> list[DetectionLimit]:
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
    renew_json(out / "gap_limits.json", [asdict(limit) for limit in limits])
    page = write_study(limits, out, study_command("gap-limit", cases, seed))
    print(page.read_text())
    return limits


def _kept(path: Path) -> list[DetectionLimit]:
    if not path.exists():
        return []
    lines = path.read_text().splitlines()
    # The last line of a run that was ended may be half a line.
    return [DetectionLimit(**json.loads(line)) for line in lines if line.endswith("}")]


def smallest_named(item: tuple[str, int]) -> DetectionLimit:
    """Return the smallest size that is named right, by steps of half an octave over the detection limit.

    A size above the smallest is taken to be named, too, one below the largest that is not taken not to be.
    """
    effect, seed = item
    seen = limit_case(seed, effect, moderate=True)
    if seen is None:
        parameter = next(iter(make(seed, effect, factor=1.0, moderate=True).truth[effect]))
        return DetectionLimit(effect, seed, parameter, None, None, None)
    parameter, visible = next(iter(seen.truth[effect].items()))
    top = min(HIGHEST, math.floor(math.log(LARGEST_FACTOR / seen.factor, STEP)))
    values: dict[int, float] = {}

    def named(power: int) -> bool:
        case = make(seed, effect, factor=seen.factor * STEP**power, moderate=True)
        values[power] = case.truth[effect][parameter]
        return judge(case, least_share=0.0).right

    smallest = _smallest(named, top)
    if smallest is None:
        return DetectionLimit(effect, seed, parameter, visible, None, None)
    return DetectionLimit(effect, seed, parameter, visible, values[smallest], STEP**smallest)


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

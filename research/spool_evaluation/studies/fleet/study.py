"""Study of fleets: wear and contamination found in time, their causes, and valves named that are healthy."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from spool_fleet.judgement import CHANGED, MACHINE, confirmed, judged_alone
from spool_fleet.manifest import Service

from spool_evaluation.results.page import markdown_table, renew_json, study_command, write_page
from spool_evaluation.results.proportion import Proportion
from spool_evaluation.studies.fleet.world import EstimationError, observe, simulated_error
from spool_evaluation.studies.workers import spread

from .world import DAY, FIRST_DAY, MONTH, WEEKS, World, draw_world

#: Months after its beginning by which a change is to be found.
IN_TIME = 2.0
#: Bags whose estimation errors are drawn from, and the seed of the first: no fleet of a study has it.
ERRORS, ERRORS_FROM = 2000, 10_000_000
#: Weeks before which nothing is judged.
FIRST_WEEK = 5
ABOUT = (
    "A fleet of 20 valves on 5 machines over a year, a bag of each valve every working day, with estimation "
    "errors of bags that were simulated and estimated by what ships: oil temperatures with seasons and "
    "weather, sensors of them with offsets and wrong gains, oils that differ from "
    "their law, scatter from bag to bag, vibration that changes. One valve wears 3 % a month, one is "
    "contaminated in month 7, the oil of one machine is changed, which is reported. It is judged every "
    "week with what was known then; a healthy valve that is named once in the year counts as false."
)


@dataclass(frozen=True, slots=True)
class FleetOutcome:
    """Outcome of one fleet: months from the beginning to the finding (NaN: never), causes, false valves."""

    seed: int
    wear_months: float
    wear_cause: str
    dirt_months: float
    dirt_cause: str
    false: tuple[str, ...]
    valve_years: float


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> None:
    """Judge ``cases`` fleets from ``seed`` on; ``out`` gets ``fleet_study.md`` and a file of each fleet."""
    out.mkdir(parents=True, exist_ok=True)
    seeds = [seed + number for number in range(cases)]
    done = {one: _kept(out, one) for one in seeds if _file(out, one).is_file()}
    errors = list(spread(simulated_error, range(ERRORS_FROM, ERRORS_FROM + ERRORS), "bags", workers))
    errors.sort(key=repr)  # they come in any order
    judged = partial(judge_fleet, errors=errors)
    for outcome in spread(judged, [one for one in seeds if one not in done], "fleets", workers):
        renew_json(_file(out, outcome.seed), asdict(outcome))
        done[outcome.seed] = outcome
        _write(out, [done[one] for one in seeds if one in done], study_command("fleet", cases, seed))
    _write(out, [done[one] for one in seeds], study_command("fleet", cases, seed))


def judge_fleet(seed: int, errors: Sequence[EstimationError | None]) -> FleetOutcome:
    """Return how the fleet of ``seed`` was judged, week by week."""
    world = draw_world(seed)
    valves = observe(world, errors)
    services = _services(world)
    worn, dirty = valves[world.worn].key, valves[world.dirty].key
    begins = {
        worn: FIRST_DAY + world.valves[world.worn].wears_from,
        dirty: FIRST_DAY + world.valves[world.dirty].dirty_from,
    }
    found: dict[tuple[str, str], tuple[float, str]] = {}
    false: set[str] = set()
    seen = judged_alone(valves, services, FIRST_DAY + 7.0 * (FIRST_WEEK - 1))
    for week in range(FIRST_WEEK, WEEKS + 1):
        day = FIRST_DAY + 7.0 * week
        before, seen = seen, judged_alone(valves, services, day)
        for trend in confirmed(seen, before):
            key = (trend.machine, trend.valve)
            if trend.state == MACHINE:
                false.add(f"{trend.machine}: {trend.parameter}")
            elif trend.state == CHANGED and day < begins.get(key, math.inf):
                false.add(f"{trend.machine} {trend.valve}: {trend.parameter}")
            elif trend.state == CHANGED and key not in found:
                found[key] = ((day - begins[key]) / MONTH, trend.cause)
    nothing = (math.nan, "")
    years = len(valves) * WEEKS * 7.0 / 365.25
    return FleetOutcome(
        seed, *found.get(worn, nothing), *found.get(dirty, nothing), tuple(sorted(false)), years
    )


def _services(world: World) -> list[Service]:
    number = world.changed_machine
    day = FIRST_DAY + world.machines[number].change_day
    return [Service(f"machine_{number + 1}", "", round(day * DAY) * 1_000_000_000, "oil_change")]


def _write(out: Path, outcomes: list[FleetOutcome], command: str) -> None:
    rows = [
        _row("wear, 3 % a month", [(one.wear_months, one.wear_cause == "wear") for one in outcomes]),
        _row(
            "contamination in month 7",
            [(one.dirt_months, one.dirt_cause == "oil_contamination") for one in outcomes],
        ),
    ]
    head = ("change", "found by the second month", "cause right", "months to the finding, median (90 %)")
    years = sum(one.valve_years for one in outcomes)
    named = sum(len({text.partition(":")[0] for text in one.false}) for one in outcomes)
    lines = (
        f"{named} healthy valves were named in {years:.0f} valve-years of {len(outcomes)} fleets: "
        f"{100.0 * named / years:.2f} in 100 valve-years."
        if outcomes
        else ""
    )
    write_page(
        out / "fleet_study.md", "Fleets over a year", command, [ABOUT, markdown_table(head, rows), lines]
    )


def _row(name: str, found: list[tuple[float, bool]]) -> list[str]:
    in_time = [months <= IN_TIME for months, _ in found]
    right = [cause for (months, cause) in found if not math.isnan(months)]
    known = sorted(months for months, _ in found if not math.isnan(months))
    spent = f"{known[len(known) // 2]:.1f} ({known[int(0.9 * len(known))]:.1f})" if known else "-"
    return [name, str(Proportion(sum(in_time), len(found))), str(Proportion(sum(right), len(right))), spent]


def _file(out: Path, seed: int) -> Path:
    return out / f"fleet_{seed}.json"


def _kept(out: Path, seed: int) -> FleetOutcome:
    kept: dict[str, Any] = json.loads(_file(out, seed).read_text(encoding="utf-8"))
    kept["false"] = tuple(kept["false"])
    for name in ("wear_months", "dirt_months"):
        kept[name] = math.nan if kept[name] is None else kept[name]
    return FleetOutcome(**kept)

"""Content of the fleet's page: what its tables say of every valve."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from spool_core.text import plural

from spool_fleet.tables.query import ask
from spool_fleet.trends.change_test import MONTH
from spool_fleet.trends.judgement import LEARNING, UNKNOWN
from spool_fleet.trends.observations import DAY, observed_valves

from .courses import Course, Told, courses_of, services_told, temperature_slopes, temperatures
from .lights import ALARM, CONSPICUOUS, LEARNS, NOT_KNOWN, SILENT, WARNING, WHOLE, Light, light_of, patience
from .records import Records, records_of
from .trend_rows import TrendRow, day_of, trend_rows


@dataclass(frozen=True, slots=True)
class ValveContent:
    """Content about one valve.

    Attributes:
        machine, valve: the identity; ``anchor``: where its section is on the page.
        light: its state.
        trends: of its parameters.
        courses: of its parameters, by name.
        temperature: days and oil temperature, deg C.
        records: its bags and events.
        services: what was done to it.
        quiet: days from its newest usable bag to the fleet's.
        overdue: days of these that are more than usual; positive where it is silent.
    """

    machine: str
    valve: str
    anchor: str
    light: Light
    trends: tuple[TrendRow, ...]
    courses: dict[str, Course]
    temperature: tuple[NDArray[np.float64], NDArray[np.float64]] | None
    records: Records
    services: tuple[Told, ...]
    quiet: float
    overdue: float

    @property
    def name(self) -> str:
        """Machine and valve."""
        return f"{self.machine} {self.valve}"

    @property
    def silent(self) -> bool:
        """Whether it should have had a bag since."""
        return self.overdue > 0.0

    @property
    def conspicuous(self) -> bool:
        """Whether a change was found in it."""
        return self.light in CONSPICUOUS

    @property
    def open_questions(self) -> list[TrendRow]:
        """Trends that cannot be judged, or not yet."""
        return [one for one in self.trends if one.state in (LEARNING, UNKNOWN)]


@dataclass(frozen=True, slots=True)
class PageContent:
    """Content of the page of the fleet in ``store``.

    Attributes:
        first, newest: of the usable bags; ``None`` where there is none.
        bags, usable: how many are in the catalogue, and can be analysed.
        valves: by machine and name.
        services: that were told.
    """

    store: Path
    first: datetime | None
    newest: datetime | None
    bags: int
    usable: int
    valves: tuple[ValveContent, ...] = field(default=())
    services: tuple[Told, ...] = field(default=())

    @property
    def summary(self) -> str:
        """One line for the terminal."""
        counts = Counter(one.light for one in self.valves)
        parts = [f"{counts[ALARM] + counts[WARNING]} changed"]
        parts += [f"{counts[WHOLE]} with their whole machine"] if counts[WHOLE] else []
        parts += [f"{counts[light]} {light.word}" for light in (SILENT, LEARNS) if counts[light]]
        return f"{plural(len(self.valves), 'valve')}: {', '.join(parts)}, {counts[NOT_KNOWN]} unknown"

    @property
    def month_ago(self) -> float:
        """Day on which the last month began, counted back from the newest bag."""
        return day_of(self.newest) - MONTH

    @property
    def machines(self) -> dict[str, list[ValveContent]]:
        """Valves by machine."""
        found: dict[str, list[ValveContent]] = {}
        for one in self.valves:
            found.setdefault(one.machine, []).append(one)
        return found


def page_content(store: Path) -> PageContent:
    """Return what the tables of ``store`` say of its valves; times count back from the newest bag.

    Raises:
        InputError: there are no tables in ``store``.
    """
    (head,) = ask(
        store,
        "SELECT min(start) FILTER (status = 'ok') AS first, max(start) FILTER (status = 'ok') AS newest, "
        "count(*) AS bags, count(*) FILTER (status = 'ok') AS usable FROM bags",
    ).to_pylist()
    records, trends, services = records_of(store), trend_rows(store), services_told(store)
    observed = {one.key: one for one in observed_valves(store)}
    slopes = temperature_slopes(list(observed.values()), services)
    celsius = temperatures(store)
    pauses = sorted(one.pause for one in records.values() if one.pause is not None)
    usual = pauses[len(pauses) // 2] if pauses else 0.0
    newest = head["newest"]
    valves = []
    for number, key in enumerate(sorted(records, key=lambda one: (_natural(one[0]), _natural(one[1])))):
        own, rows = records[key], trends.get(key, [])
        quiet = math.nan if own.newest is None else (newest - own.newest).total_seconds() / DAY
        overdue = quiet - patience(usual if own.pause is None else own.pause)
        valves.append(
            ValveContent(
                *key, f"valve-{number + 1}", light_of(rows, overdue > 0.0), tuple(rows),
                courses_of(observed[key], rows, services, slopes) if key in observed else {},
                celsius.get(key), own, tuple(one for one in services if one.concerns(*key)), quiet, overdue,
            )
        )  # fmt: skip
    return PageContent(store, head["first"], newest, head["bags"], head["usable"], tuple(valves), services)


def _natural(text: str) -> tuple[tuple[int, str], ...]:
    """Return what sorts ``valve_10`` behind ``valve_2``."""
    parts = re.findall(r"[0-9]{1,18}|[^0-9]+|[0-9]+", text)
    return tuple(
        (int(part), "") if part.isascii() and part.isdigit() and len(part) <= 18 else (-1, part)
        for part in parts
    )

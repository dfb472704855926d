"""Questions about a fleet by name: each is one SELECT with a machine, a valve and a parameter filled in."""

from __future__ import annotations

from dataclasses import dataclass

from spool_core.errors import InputError
from spool_core.text import did_you_mean


@dataclass(frozen=True, slots=True)
class Question:
    """Question: ``sql`` with ``{machine}``, ``{valve}``, ``{parameter}`` as quoted texts; empty: all."""

    line: str
    sql: str


_WHOSE = "({machine} = '' OR machine = {machine}) AND ({valve} = '' OR valve = {valve})"
QUESTIONS = {
    "trend": Question(
        "one parameter of a valve from bag to bag",
        "SELECT start, machine, valve, analysis, value, std, unit FROM parameters "
        f"WHERE name = {{parameter}} AND {_WHOSE} ORDER BY machine, valve, start",
    ),
    "worst": Question(
        "valves that changed most, in shares of the monitor's limit",
        "SELECT machine, valve, parameter, state, cause, change, change_std, since, months_to_threshold, "
        "abs(change / threshold) AS share_of_limit FROM trends WHERE state IN ('changed', 'machine_wide') "
        f"AND {_WHOSE} ORDER BY share_of_limit DESC NULLS LAST",
    ),
    "changed": Question(
        "changes since the last service of each valve",
        "SELECT t.machine, t.valve, t.parameter, t.state, t.cause, t.change, t.change_std, t.since, "
        "max(s.start) AS last_service FROM trends t LEFT JOIN services s ON s.machine IN ('', t.machine) "
        "AND s.valve IN ('', t.valve) WHERE t.state IN ('changed', 'machine_wide') "
        "AND ({machine} = '' OR t.machine = {machine}) AND ({valve} = '' OR t.valve = {valve}) "
        "GROUP BY ALL HAVING last_service IS NULL OR t.since >= last_service ORDER BY t.machine, t.valve",
    ),
    "springs": Question(
        "natural frequency and stiffness of each valve: which spring set is in it",
        "SELECT machine, valve, median(value) FILTER (name = 'natural_frequency') AS natural_frequency_Hz, "
        "median(value) FILTER (name = 'spring_stiffness') AS spring_stiffness_N_m, "
        "count(DISTINCT bag) AS bags "
        f"FROM parameters WHERE {_WHOSE} GROUP BY ALL ORDER BY natural_frequency_Hz",
    ),
    "oil-change": Question(
        "one parameter before and after each oil change, medians of 60 days",
        "SELECT s.machine, p.valve, s.start AS oil_change, "
        "median(p.value) FILTER (p.start < s.start) AS before, "
        "median(p.value) FILTER (p.start >= s.start) AS after, any_value(p.unit) AS unit "
        "FROM services s JOIN parameters p ON s.machine IN ('', p.machine) AND s.valve IN ('', p.valve) "
        "WHERE s.kind = 'oil_change' AND p.name = {parameter} "
        "AND p.start BETWEEN s.start - INTERVAL 60 DAY AND s.start + INTERVAL 60 DAY "
        "AND ({machine} = '' OR p.machine = {machine}) AND ({valve} = '' OR p.valve = {valve}) "
        "GROUP BY ALL ORDER BY s.start, p.valve",
    ),
    "damaged": Question(
        "bags that are damaged or there twice, and analyses that failed",
        "SELECT bag, machine, valve, status AS what, reason FROM bags WHERE status <> 'ok' UNION ALL "
        "SELECT bag, machine, valve, analysis || ' failed', reason FROM analyses WHERE status <> 'ok' "
        "ORDER BY bag",
    ),
}


def sql_of(name: str, machine: str, valve: str, parameter: str) -> str:
    """Return the SELECT of the question ``name``.

    Raises:
        InputError: there is no such question; those there are are listed.
    """
    if name not in QUESTIONS:
        listed = "; ".join(f"{key}: {question.line}" for key, question in QUESTIONS.items())
        near = did_you_mean(name, list(QUESTIONS))
        raise InputError(f"--question {name}: known are {listed}{near}")
    values = {"machine": machine, "valve": valve, "parameter": parameter}
    quoted = {key: "'" + text.replace("'", "''") + "'" for key, text in values.items()}
    return QUESTIONS[name].sql.format(**quoted)

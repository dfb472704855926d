"""Joint fits of several set-ups as JSON and as rows of text."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table
from spool_core.uncertainty import LEGEND, PLUS_MINUS, by_name, interval, number
from spool_estimator.identification.determination import IDENTIFIABLE, ONE_SIDED, Determination, sentences

from spool_report import fit_tables
from spool_report.ranking import natural_frequency
from spool_report.setups import FittedSetUps

#: What the columns of single set-ups mean.
ALONE = (
    "alone: half width of the interval from one set-up by itself; 'no': by itself this set-up determines the "
    "parameter only together with others."
)


def to_dictionary(found: FittedSetUps) -> dict[str, Any]:
    """Return what ``fit --setups --json`` writes; NaN where something is not known."""
    joint = found.joint
    return {
        "valve": found.valve.id,
        "model": joint.model.name,
        "terms": [term.name for term in joint.model.terms],
        "converged": joint.converged,
        "stopped_early": joint.stopped_early,
        "reason": joint.reason,
        "shared": {name: [list(group) for group in groups] for name, groups in found.shared.items()},
        "parameters": by_name(joint.parameters),
        "combinations": by_name(joint.combinations),
        "not_observable": joint.not_observable,
        "determined": by_name(joint.determinations),
        "alone": {name: by_name(own) for name, own in joint.alone.items()},
        "correlation": {"parameters": joint.observable, "matrix": joint.correlation},
        "setups": {
            setup.name: {"known": setup.known.model_dump(exclude_none=True), **fit_tables.to_dictionary(one)}
            for setup, one in zip(found.setups, found.validated, strict=False)
        },
    }


def shown_name(name: str) -> str:
    """Return the name of a joint unknown for people: ``spring stiffness (soft, loaded)``."""
    return name.replace("_", " ").replace("[", " (").replace("]", ")")


def alone_text(one: Determination | None) -> str:
    """Return what one set-up determines of a parameter by itself; empty where it does not have it."""
    if one is None:
        return ""
    if one.verdict == IDENTIFIABLE and one.low is not None and one.high is not None:
        return number(0.5 * (one.high - one.low), 2)
    if one.verdict == ONE_SIDED:
        return f"≥ {number(one.low, 2)}" if one.low is not None else f"≤ {number(one.high or 0.0, 2)}"
    return "no"


def alone_of(found: FittedSetUps, name: str, setup: str) -> Determination | None:
    """Return what ``setup`` determines by itself of the joint unknown ``name``, ``None`` if it has none."""
    parameter, _, group = name.rstrip("]").partition("[")
    if group and setup not in group.split(", "):
        return None
    return next((one for one in found.joint.alone.get(setup, ()) if one.name == parameter), None)


def rows(found: FittedSetUps) -> list[dict[str, str]]:
    """Return a row of text for each unknown: its value from all set-ups, and what each determines alone."""
    made = []
    for quantity in (*found.joint.parameters, *found.joint.combinations):
        shown = interval(quantity.value, quantity.standard_deviation)
        made.append(
            {
                "parameter": shown_name(quantity.name),
                "value": shown.value,
                PLUS_MINUS: shown.half_width,
                "unit": quantity.unit,
                **{
                    f"{setup.name} alone": alone_text(alone_of(found, quantity.name, setup.name))
                    for setup in found.setups
                },
            }
        )
    return made


def quality_rows(found: FittedSetUps) -> list[dict[str, str]]:
    """Return a row of text for each set-up: what is known in it, and how well the model holds."""
    return [
        {
            "set-up": setup.name,
            "known": ", ".join(
                f"{name.replace('_', ' ')} {value if isinstance(value, str) else number(value)}"
                for name, value in setup.known.model_dump(exclude_none=True).items()
            ),
            "natural frequency, Hz": number(natural_frequency(one.fit)),
            "nrmse": number(one.training_error),
            "held out": number(one.held_out_error),
        }
        for setup, one in zip(found.setups, found.validated, strict=False)
    ]


def headline(found: FittedSetUps) -> str:
    """Return what was fitted to what."""
    names = ", ".join(setup.name for setup in found.setups)
    return f"{found.joint.model.name} fitted to {len(found.setups)} set-ups of {found.valve.id}: {names}"


def print_setups(found: FittedSetUps, console: Console) -> None:
    """Show a joint fit, or why it has no result."""
    joint = found.joint
    if joint.reason is not None:
        console.print(f"no result: {joint.reason}", markup=False, highlight=False, soft_wrap=True)
        return
    console.print(headline(found), markup=False, highlight=False, soft_wrap=True)
    for line in sentences(joint.determinations):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    values = rows(found)
    own = [f"{setup.name} alone" for setup in found.setups]
    for lines in (
        [{name: text for name, text in row.items() if name not in own} for row in values],
        [{name: row[name] for name in ("parameter", *own)} for row in values],
        quality_rows(found),
    ):
        table = Table(box=None, pad_edge=False)
        for column in lines[0]:
            left = column in ("parameter", "unit", "set-up", "known")
            table.add_column(column, justify="left" if left else "right", no_wrap=not left)
        for row in lines:
            table.add_row(*row.values())
        console.print(table)
    console.print(f"{LEGEND}. {ALONE}", markup=False, highlight=False, soft_wrap=True)
    if not joint.converged:
        console.print("NOT converged: do not use the numbers", markup=False)
    for setup, one in zip(found.setups, found.validated, strict=True):
        for warning in one.fit.warnings:
            text = f"warning: {setup.name}: {warning}"
            console.print(text, style="yellow", markup=False, highlight=False, soft_wrap=True)

"""Study of orders: names given where there are none, by kind of vibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np
from scipy import fft
from spool_core.numbers import Array
from spool_monitor.orders import MEMORY, name_of, revolutions
from spool_sim.valve import Component

from spool_evaluation.results.page import interval, markdown_table, study_command, write_page
from spool_evaluation.studies.workers import spread

PAGE, TITLE = "orders_study.md", "Orders that are named wrongly"
ABOUT = (
    "Independent pieces of 8 s of the body at 2000 Hz, each judged once, with 95 % intervals. The rules: "
    "[orders](../orders.md). A name is false where no order shakes. A structure has one mode at exactly the "
    "2nd order, shaken by white noise; it is judged at that order."
)
PERIOD = 5e-4
SAMPLES = round(MEMORY / PERIOD)
TIME: Array = np.asarray(PERIOD * np.arange(SAMPLES), dtype=np.float64)
#: rev/min of the shaft whose speed is measured: constant, or at the begin and end of a run-up.
STEADY, RUN_UP = (870.0, 870.0), (830.0, 910.0)
PUMP, ENGINE = Component(name="pump", pistons=9), Component(name="engine", strokes=4, cylinders=6)


#: Kind of vibration, a key of ``KINDS``, and the seed of its piece.
Piece: TypeAlias = tuple[str, int]


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[tuple[str, bool]]:
    """Judge ``cases`` pieces of each kind; ``out`` gets the page."""
    wanted = [(kind, seed + number) for kind in KINDS for number in range(cases)]
    found = list(spread(judge, wanted, "pieces", workers))
    write_page(out / PAGE, TITLE, study_command("orders", cases, seed), [ABOUT, table(found)])
    print(table(found))
    return found


def judge(piece: Piece) -> tuple[str, bool]:
    """Return the kind of a piece, and whether an order was named, which is wrong."""
    kind, seed = piece
    return kind, KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind)]))


def table(found: Sequence[tuple[str, bool]]) -> str:
    """Return the counts by kind as Markdown."""
    body = []
    for kind in KINDS:
        named = [wrong for one, wrong in found if one == kind]
        low, high = interval(sum(named), len(named), "exact")
        body.append((kind, str(len(named)), str(sum(named)), f"{low:.2%} to {high:.2%}"))
    return markdown_table(("vibration", "pieces", "named wrongly", "share"), body)


def noise(rng: np.random.Generator) -> Array:
    """Return white noise of 1 m/s^2."""
    return rng.normal(0.0, 1.0, SAMPLES)


def structure(rng: np.random.Generator, damping: float) -> Array:
    """Return what a structure with a mode at the 2nd order of ``STEADY`` makes of noise."""
    longer = fft.next_fast_len(2 * SAMPLES, real=True)  # its transient has gone
    ratio = fft.rfftfreq(longer, PERIOD) / (2.0 * STEADY[0] / 60.0)
    mode = 1.0 / (1.0 - ratio**2 + 2j * damping * ratio)
    return np.asarray(fft.irfft(fft.rfft(rng.normal(0.0, 1.0, longer)) * mode, longer)[-SAMPLES:])


def false_order(
    rng: np.random.Generator,
    made: Callable[[np.random.Generator], Array],
    rpm: tuple[float, float],
    components: tuple[Component, ...],
) -> bool:
    """Judge a piece in which nothing follows the shaft, at the 2nd order."""
    turns = revolutions(TIME, np.array([0.0, MEMORY]), np.array(rpm))
    return name_of(made(rng), turns, PERIOD, 2.0, rpm[1], components) is not None


def foreign_tone(rng: np.random.Generator, rpm: float, components: tuple[Component, ...]) -> bool:
    """Judge a tone of 5 m/s^2 between 8 and 60 Hz beside a shaft of constant speed."""
    frequency = rng.uniform(8.0, 60.0)
    body = noise(rng) + 5.0 * np.sin(2.0 * np.pi * frequency * TIME)
    turns: Array = np.asarray(rpm / 60.0 * TIME, dtype=np.float64)
    return name_of(body, turns, PERIOD, 60.0 * frequency / rpm, rpm, components) is not None


KINDS: dict[str, Callable[[np.random.Generator], bool]] = {
    "order: white noise, constant speed": partial(false_order, made=noise, rpm=STEADY, components=()),
    "order: white noise, run-up": partial(false_order, made=noise, rpm=RUN_UP, components=()),
    **{
        f"order: structure of {damping:.1%} damping, {name}": partial(
            false_order, made=partial(structure, damping=damping), rpm=rpm, components=components
        )
        for damping in (0.03, 0.01, 0.005)
        for name, rpm, components in (
            ("shaft at constant speed", STEADY, ()),
            ("engine and pump at constant speed", STEADY, (ENGINE, PUMP)),
            ("shaft in a run-up", RUN_UP, ()),
        )
    },
    "order: foreign tone, shaft": partial(foreign_tone, rpm=870.0, components=()),
    "order: foreign tone, pump": partial(foreign_tone, rpm=870.0, components=(PUMP,)),
    "order: foreign tone, engine at 1480 rev/min": partial(foreign_tone, rpm=1480.0, components=(ENGINE,)),
    "order: foreign tone, engine at 580 rev/min": partial(foreign_tone, rpm=580.0, components=(ENGINE,)),
}

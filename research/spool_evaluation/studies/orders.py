"""Study of orders: names and speeds given where there are none, by kind of vibration."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy import fft
from spool_core.numbers import Array
from spool_monitor.harmonics import speed_from_harmonics, visible_orders
from spool_monitor.orders import MEMORY, name_of, revolutions
from spool_sim.valve import Component

from spool_evaluation.results.page import interval, markdown_table, study_command, write_page
from spool_evaluation.studies.workers import spread

PAGE, TITLE = "orders_study.md", "Orders and speeds that are named wrongly"
ABOUT = (
    "Independent pieces of 8 s of the body at 2000 Hz, each judged once, with 95 % intervals. The rules: "
    "[orders](../orders.md). A name is false where no order shakes. A structure has one mode at exactly the "
    "2nd order, shaken by white noise; it is judged at that order."
)
LIMIT = (
    "The last row is the limit of the method: a pump that the valve file does not list, of the same number "
    "of pistons and on another shaft, looks exactly like the listed one."
)
PERIOD = 5e-4
SAMPLES = round(MEMORY / PERIOD)
TIME: Array = np.asarray(PERIOD * np.arange(SAMPLES), dtype=np.float64)
#: rev/min of the shaft whose speed is measured: constant, or at the begin and end of a run-up.
STEADY, RUN_UP = (870.0, 870.0), (830.0, 910.0)
PUMP, ENGINE = Component(name="pump", pistons=9), Component(name="engine", strokes=4, cylinders=6)
MACHINES: tuple[tuple[Component, ...], ...] = (
    (PUMP,),
    (Component(name="pump", pistons=7),),
    (Component(name="pump", pistons=11), Component(name="fan", ratio=1.37)),
    (PUMP, Component(name="motor", ratio=0.618, pistons=7)),
    (ENGINE,),
    (Component(name="engine", strokes=4, cylinders=4), PUMP),
    (Component(name="gear_pump", pistons=12),),
)
#: m/s^2, of tones beside white noise of 1 m/s^2: from below what is seen to where nothing else is.
WEAKEST, STRONGEST = 0.05, 5.0
#: Share of listed orders and of further harmonics that are seen, which no machine prescribes.
LISTED, FURTHER = 0.6, 0.2


@dataclass(frozen=True, slots=True)
class OrdersCase:
    """Kind of vibration, a key of ``KINDS``, and the seed of its piece."""

    kind: str
    seed: int


@dataclass(frozen=True, slots=True)
class OrdersOutcome:
    """Outcome of a case: whether a name or speed was given, and whether it was right."""

    kind: str
    named: bool
    right: bool


def run(cases: int, seed: int, out: Path, workers: int | None = None) -> list[OrdersOutcome]:
    """Judge ``cases`` pieces of each kind; ``out`` gets the page."""
    wanted = [OrdersCase(kind, seed + number) for kind in KINDS for number in range(cases)]
    found = list(spread(judge, wanted, "pieces", workers))
    write_page(out / PAGE, TITLE, study_command("orders", cases, seed), [ABOUT, table(found), LIMIT])
    print(table(found))
    return found


def judge(case: OrdersCase) -> OrdersOutcome:
    """Return the outcome of one piece."""
    named, right = KINDS[case.kind](np.random.default_rng([case.seed, list(KINDS).index(case.kind)]))
    return OrdersOutcome(case.kind, named, right)


def table(found: Sequence[OrdersOutcome]) -> str:
    """Return the counts by kind as Markdown."""
    body = []
    for kind in KINDS:
        rows = [one for one in found if one.kind == kind]
        wrong = sum(one.named and not one.right for one in rows)
        low, high = interval(wrong, len(rows), "exact")
        right = sum(one.right for one in rows)
        body.append((kind, str(len(rows)), str(wrong), f"{low:.2%} to {high:.2%}", str(right)))
    return markdown_table(("vibration", "pieces", "named wrongly", "share", "named rightly"), body)


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
) -> tuple[bool, bool]:
    """Judge a piece in which nothing follows the shaft, at the 2nd order."""
    turns = revolutions(TIME, np.array([0.0, MEMORY]), np.array(rpm))
    return name_of(made(rng), turns, PERIOD, 2.0, rpm[1], components) is not None, False


def foreign_tone(
    rng: np.random.Generator, rpm: float, components: tuple[Component, ...]
) -> tuple[bool, bool]:
    """Judge a tone of 5 m/s^2 between 8 and 60 Hz beside a shaft of constant speed."""
    frequency = rng.uniform(8.0, 60.0)
    body = noise(rng) + 5.0 * np.sin(2.0 * np.pi * frequency * TIME)
    turns: Array = np.asarray(rpm / 60.0 * TIME, dtype=np.float64)
    return name_of(body, turns, PERIOD, 60.0 * frequency / rpm, rpm, components) is not None, False


def tones(rng: np.random.Generator, frequencies: Sequence[float], turning: Array | None = None) -> Array:
    """Return sines of random strength, of ``frequencies`` over time or over the angle ``turning``."""
    along = TIME if turning is None else turning
    found = np.zeros(SAMPLES)
    for frequency in frequencies:
        size = math.exp(rng.uniform(math.log(WEAKEST), math.log(STRONGEST)))
        found += size * np.sin(2.0 * np.pi * (frequency * along + rng.uniform()))
    return found


def estimated(
    rng: np.random.Generator, *, foreign: int, families: int, turns: bool = True, twin: bool = False
) -> tuple[bool, bool]:
    """Judge a machine without a speed channel, whose speed (500 to 2500 rev/min) is drawn.

    Up to ``foreign`` tones and ``families`` of up to six harmonics come of other machines. Its speed wanders
    by up to 0.01 %. ``turns``: whether it runs; ``twin``: another machine of the same kind does in its place.
    """
    components = (PUMP,) if twin else MACHINES[rng.integers(len(MACHINES))]
    speed = rng.uniform(500.0, 2500.0) / 60.0
    walk = np.cumsum(rng.normal(0.0, math.sqrt(PERIOD / MEMORY), SAMPLES))
    angle = speed * (TIME + rng.choice([0.0, 1e-5, 1e-4]) * np.cumsum(walk) * PERIOD)
    listed = {order * one.ratio for one in components for order in one.orders}
    body = noise(rng)
    for order in visible_orders(components) if turns else ():
        is_listed = any(math.isclose(order, one) for one in listed)
        if rng.random() < (LISTED if is_listed else FURTHER):
            body += tones(rng, [order], angle)
    body += tones(
        rng, np.exp(rng.uniform(math.log(4.0), math.log(900.0), rng.integers(foreign + 1))).tolist()
    )
    for _ in range(families):
        body += tones(rng, (rng.uniform(5.0, 100.0) * np.flatnonzero(rng.random(7) < LISTED)[1:]).tolist())
    found = speed_from_harmonics(body, PERIOD, components)
    right = found is not None and turns and not twin and abs(found.rpm / (60.0 * speed) - 1.0) < 1e-3
    return found is not None, right


KINDS: dict[str, Callable[[np.random.Generator], tuple[bool, bool]]] = {
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
    "speed: the machine alone": partial(estimated, foreign=0, families=0),
    "speed: and up to 4 foreign tones": partial(estimated, foreign=4, families=0),
    "speed: and two foreign families of harmonics": partial(estimated, foreign=4, families=2),
    "speed: the machine stands, foreign tones and families": partial(
        estimated, foreign=4, families=2, turns=False
    ),
    "speed: the machine stands, a pump of the same kind runs": partial(
        estimated, foreign=0, families=0, twin=True
    ),
}

"""Spoiled records: what goes wrong at a rig, done to a good record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Samples = tuple[Array, Array, Array]

STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True, slots=True)
class Spoiling:
    """Way to spoil a record.

    Attributes:
        spoil: takes and returns (time s, body m/s^2, spool m/s^2), shape (n,) each.
        words: a message that names the matter has one of them.
        usable: the record still holds enough to be judged, with a warning.
    """

    spoil: Callable[[Array, Array, Array], Samples]
    words: tuple[str, ...]
    usable: bool = False


def _too_short(time: Array, body: Array, spool: Array) -> Samples:
    n = int(np.searchsorted(time, 1.0))
    return time[:n], body[:n], spool[:n]


def _no_excitation(time: Array, body: Array, spool: Array) -> Samples:
    generator = np.random.default_rng(0)
    return time, 0.03 * generator.standard_normal(body.size), 0.03 * generator.standard_normal(spool.size)


def _dead_body(time: Array, body: Array, spool: Array) -> Samples:
    return time, np.full_like(body, 0.02), spool


def _dead_spool(time: Array, body: Array, spool: Array) -> Samples:
    return time, body, np.full_like(spool, 0.02)


def _dead_halfway(time: Array, body: Array, spool: Array) -> Samples:
    half = time.size // 2
    return time, body, np.concatenate([spool[:half], np.full(time.size - half, spool[half])])


def _spool_in_g(time: Array, body: Array, spool: Array) -> Samples:
    return time, body, spool / STANDARD_GRAVITY


def _body_in_g(time: Array, body: Array, spool: Array) -> Samples:
    return time, body / STANDARD_GRAVITY, spool


def _swapped(time: Array, body: Array, spool: Array) -> Samples:
    return time, spool, body


def _with_gaps(time: Array, body: Array, spool: Array) -> Samples:
    kept = np.ones(time.size, dtype=bool)
    for start in (0.23, 0.51, 0.74):
        first = int(start * time.size)
        kept[first : first + time.size // 50] = False
    return time[kept], body[kept], spool[kept]


def _slow_sampling(time: Array, body: Array, spool: Array) -> Samples:
    stride = round(1.0 / 200.0 / float(time[1] - time[0]))
    return time[::stride], body[::stride], spool[::stride]


def _turned_sensor(time: Array, body: Array, spool: Array) -> Samples:
    return time, body, -spool


SPOILINGS: dict[str, Spoiling] = {
    "too_short": Spoiling(_too_short, ("short", "seconds", "longer")),
    "no_excitation": Spoiling(_no_excitation, ("excit", "vibrat", "noise", "rest")),
    "dead_body": Spoiling(_dead_body, ("body",)),
    "dead_spool": Spoiling(_dead_spool, ("spool",)),
    "dead_halfway": Spoiling(_dead_halfway, ("spool",), usable=True),
    "spool_in_g": Spoiling(_spool_in_g, ("9.8", "unit", "gain", " g")),
    "body_in_g": Spoiling(_body_in_g, ("9.8", "unit", "gain", " g")),
    "swapped_channels": Spoiling(_swapped, ("swap", "exchang", "interchang")),
    "gaps": Spoiling(_with_gaps, ("gap", "missing", "lost", "stretches"), usable=True),
    "slow_sampling": Spoiling(_slow_sampling, ("sampl", "rate", "Hz")),
    "turned_sensor": Spoiling(_turned_sensor, ("sign", "turned", "polarity", "direction", "opposite")),
}

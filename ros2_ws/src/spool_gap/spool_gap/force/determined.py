"""Judgement of what force records determine of the base, beside the effects of a model."""

from __future__ import annotations

import math

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_estimator.identification.determination import Determination, by_information, hidden_by_name
from spool_estimator.identification.least_squares import Unknown, sizes_of, unseen_directions
from spool_sim.model import Model

from spool_gap.catalogue import EFFECTS
from spool_gap.force.balance import (
    BASE_NAMES,
    ForceBalance,
    ForceFit,
    ForceRecord,
    independent_samples,
    white_power,
)

#: Standard deviations of the power of noise in the columns up to which it may be all that they show.
BY_CHANCE = 4.0


def determined(balance: ForceBalance, base: Model, fit: ForceFit) -> tuple[Determination, ...]:
    """Return what the training records of ``balance`` determine of the parameters of ``base`` in ``fit``.

    The balance keeps no sign: limits of parameters hold as sizes on both sides. Derivatives of a measured
    displacement hold its noise, which is no information: what it adds to the columns of a driven mass is
    taken off. The load cell's zero and the effects of ``fit`` are free.
    """
    names = [name for name in balance.base if name != "zero"]
    unknowns: list[Unknown] = []
    if not names:
        return ()
    for name in names:
        limit = base.parameter(BASE_NAMES[name][0])
        unknowns.append(Unknown(limit.name, limit.unit, -limit.high, limit.high, limit.start))
    found = dict(zip(balance.base, fit.coefficients.tolist(), strict=False))
    point = np.array([found[name] for name in names])
    independent = max(8.0, sum(independent_samples(row) for row in fit.train))
    variance = max(fit.squares, np.finfo(float).tiny) / independent
    slopes = _seen(balance, names, fit) / math.sqrt(variance)
    hidden = hidden_by_name(
        unseen_directions(slopes, sizes_of(unknowns, point)), [one.name for one in unknowns]
    )
    return tuple(by_information(unknowns, point, slopes, hidden))


def check_one_mass(balance: ForceBalance, base: Model, name: str) -> bool:
    """Return whether the records of ``balance`` can be compared with a mass that is given.

    Raises:
        InputError: no mass is given, and the records know it only together with others.
    """
    free = balance
    if balance.mass is not None:
        free = ForceBalance(balance.train, balance.held, [*balance.base, "mass"], driven=True)
    mass = next(one for one in determined(free, base, free.fit([])) if one.name == "mass")
    if balance.mass is None and mass.together_with:
        raise InputError(
            f"{name}: {mass.sentence}; state the mass with --mass or --valve, or drive at frequencies "
            "that differ"
        )
    return not mass.together_with


def _seen(balance: ForceBalance, names: list[str], fit: ForceFit) -> Array:
    """Return a square root of the information of the columns ``names``, without noise, shape (u, u)."""
    chosen = [(EFFECTS[name], shape) for name, shape in zip(fit.effects, fit.shapes, strict=True)]
    noise = np.zeros((len(names), len(names)))
    matrix = np.concatenate([balance.columns(record, chosen) for record in balance.train])
    own = [balance.base.index(name) for name in names]
    rows, free = matrix[:, own], np.delete(matrix, own, axis=1)
    free = free / np.maximum(np.linalg.norm(free, axis=0), 1e-30)
    rows = rows - free @ np.linalg.lstsq(free, rows, rcond=None)[0]
    information = rows.T @ rows
    for record in balance.train if balance.driven else ():
        noise += _noise(balance, record, names)
    scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    strength, directions = np.linalg.eigh((information - noise) / np.outer(scale, scale))
    return np.asarray(np.sqrt(np.maximum(strength, 0.0))[:, np.newaxis] * directions.T * scale)


def _noise(balance: ForceBalance, record: ForceRecord, names: list[str]) -> Array:
    """Return the most that the displacement's noise adds to the information of a record, shape (u, u)."""
    pulse = np.zeros(8 * record.smoothing() + 1)
    pulse[pulse.size // 2] = 1.0
    orders = {"stiffness": 0, "damping": 1, "mass": 2}
    answers = np.array([record.low_passed(pulse, orders[name]) for name in names])
    count = float(balance.known[id(record)].sum())
    independent = max(1.0, count / record.smoothing())
    most = 1.0 + BY_CHANCE * math.sqrt(2.0 / independent)
    return np.asarray(most * count * white_power(record.displacement) * (answers @ answers.T))

"""Whether force records can be analysed at all: what is wrong with them, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.uncertainty import percent

from .force_balance import ForceBalance, ForceFit, white_power
from .force_record import ForceRecord

Array = NDArray[np.float64]

#: A signal must exceed its noise by this factor, rms.
EXCITED = 1.5
#: m that parts of a valve or a rig hardly move, and m that none moves; m/s and m/s^2, rms, that none reaches.
LONG, TOO_LONG, TOO_FAST, TOO_HARD = 0.5, 2.0, 20.0, 5e3
#: Mass that fits over the one that the valve's description gives, or the other way round.
OTHER_MASS = 1.5


def conditions_of(records: Sequence[ForceRecord]) -> list[str]:
    """Return warnings about ``records``.

    Raises:
        InputError: nothing moves, the force does not change, or a unit must be wrong.
    """
    first = records[0]
    for name, rows, unit in (
        ("displacement_m", [record.displacement for record in records], "m"),
        ("force_N", [record.force for record in records], "N"),
    ):
        if not max(float(np.ptp(row)) for row in rows) > 0.0:
            raise InputError(f"{first.name}: {name} does not change: check sensor and cable")
        noise = float(np.sqrt(np.mean([white_power(row) for row in rows])))
        size = float(np.std(np.concatenate(rows)))
        if size < EXCITED * noise:
            raise InputError(
                f"{first.name}: {name} shows hardly more than noise ({size:.3g} {unit} rms, "
                f"noise {noise:.3g}): does anything move, and is it sampled fast enough?"
            )
    span = float(np.ptp(np.concatenate([record.displacement for record in records])))
    speed, acceleration = (
        float(np.sqrt(np.mean(np.concatenate([record.derivative(order) for record in records]) ** 2)))
        for order in (1, 2)
    )
    if span > TOO_LONG or speed > TOO_FAST or acceleration > TOO_HARD:
        raise InputError(
            f"{first.name}: displacement_m spans {span:.3g} m at {speed:.3g} m/s and "
            f"{acceleration:.3g} m/s^2 rms: is it in mm instead of m, or exchanged with force_N?"
        )
    return [f"the displacement spans {span:.3g} m: is it in mm instead of m?"] if span > LONG else []


def check_motion(balance: ForceBalance, name: str) -> None:
    """Refuse records in which a driven mass moves too little for a balance of forces.

    While it sticks, friction takes any force, so these samples say nothing. Samples within the width of the
    low-pass count as one; more of them must be left than the base has numbers, to fit and to judge on.

    Raises:
        InputError: the mass sticks nearly throughout.
    """
    for what, records in (("fitted", balance.train), ("held-out", balance.held)):
        moving = [float(balance.known[id(record)].sum()) for record in records]
        independent = sum(count / r.smoothing() for count, r in zip(moving, records, strict=True))
        if independent <= len(balance.base):
            share = sum(moving) / sum(record.force.size for record in records)
            raise InputError(
                f"{name}: the mass moves in {percent(share)} of the {what} samples and sticks in the others: "
                "too few to balance its forces; sample faster, or drive it so that it keeps moving"
            )


def check_mass(balance: ForceBalance, fit: ForceFit, name: str, given: float | None) -> None:
    """Compare the mass that the motion shows with what is possible.

    Args:
        balance: of a driven mass.
        fit: of its base.
        name: of the record.
        given: kg, by the valve's description; ``None`` without one.

    Raises:
        InputError: no mass fits, or quite another one than ``given``.
    """
    if given is None:
        place = balance.base.index("mass")
        shown = float(fit.coefficients[place])
        if shown < 3.0 * float(fit.deviations[place]):
            raise InputError(
                f"{name}: no mass fits force and motion ({shown:.3g} kg): is the motion imposed "
                "(--kind imposed), or is a column's sign turned round?"
            )
        return
    free = ForceBalance(balance.train, balance.held, [*balance.base, "mass"], driven=True)
    shown = float(free.fit([]).coefficients[-1])
    if not given / OTHER_MASS < shown < given * OTHER_MASS:
        raise InputError(
            f"{name}: force and motion are those of {shown:.3g} kg, the valve's description says "
            f"{given:.3g} kg: check the units of force_N and displacement_m, or leave --valve out"
        )

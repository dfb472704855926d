"""Records with dry friction behind a logger's filter: does a fit that is given the law find its numbers?"""

from __future__ import annotations

import numpy as np

from spool_blind.condition import MASS, DrawnExcitation, ExperimentCondition, grid, random_lines, risen
from spool_blind.field.case import LOOK_AHEAD, FieldCase, ImportanceJudge, MeasuringChain
from spool_blind.field.logger import POINTS, draw_filters
from spool_blind.field.nuisances import BODY, SPOOL, Generator
from spool_blind.hidden import Hidden
from spool_blind.simulator import AFTER, Plant

#: First number of a record's stream of random numbers: no other family has it.
FAMILY = 19
#: Seeds that the field study takes from this family.
LOGGED = range(420_000, 430_000)
SECONDS, RATES = 25.0, (1000.0, 2000.0, 4000.0)
#: N/m, either spring; Hz, band of the excitation; sines of a multisine.
SPRINGS, BAND, TONES = ((1450.0, 1750.0), (5400.0, 6300.0)), (6.0, 110.0), 14
COULOMB, STRIBECK = "coulomb_friction", "stribeck_friction"


def make_logged(seed: int, points: int = POINTS) -> FieldCase:
    """Make the record of ``seed``, with ``points`` steps or more in a sample.

    Its truth has the base's numbers, too, by the names of the product. Importance is judged of ``LOGGED``.
    """
    generator = np.random.default_rng([FAMILY, seed])
    between = generator.uniform
    numbers = {
        "mass": between(*MASS),
        "stiffness": between(*SPRINGS[int(generator.integers(2))]),
        "damping": between(3.0, 8.0),
    }
    condition = ExperimentCondition(
        base=Plant(numbers),
        nominal_stiffness=numbers["stiffness"] / between(0.93, 1.07),
        excitation=_excitation(generator),
        amplitude=between(4.0, 14.0),
        sample_rate=float(generator.choice(RATES)),
        duration=SECONDS,
        before=0.0,
        noise_share=0.0,  # the chain holds the noise
        gain=float(generator.choice([0.99, 1.0, 1.0, 1.01])),
        delay=0.0,
    )
    law, friction = _friction(generator, condition.scale().force)
    plant = condition.base.with_(stribeck_exponent=2.0, **friction)
    noise = between(0.01, 0.05)
    chain = MeasuringChain(
        gain=condition.gain,
        delay=0.0,
        full_scale=0.0,
        filters=draw_filters(generator, condition.sample_rate, plain=True),
        noise={BODY: noise * between(0.2, 1.0), SPOOL: noise},
        nuisances=(),
        seed=int(generator.integers(2**31)),
    )
    truth = {"spring_stiffness": numbers["stiffness"], "viscous_coefficient": numbers["damping"], **friction}
    time = np.arange(round((SECONDS - LOOK_AHEAD) * condition.sample_rate)) / condition.sample_rate
    motion = condition.move(plant, points=points)
    hidden = Hidden({"stribeck_exponent": 2.0, **friction}, truth=friction)
    judge = ImportanceJudge(condition, chain, {law: hidden}, time, motion) if seed in LOGGED else None
    time, body, spool = chain.record(motion, time)
    accepted = (law, *(f"{law}+{name}" for name in chain.may_be_named))
    return FieldCase(
        seed=seed, hidden=law, accepted=accepted, factor=1.0, condition=condition, plant=plant.numbers,
        truth={law: truth}, time=time, body=body, spool=spool, chain=chain,
        importance={} if judge is None else {law: judge.importance(law)},
    )  # fmt: skip


def _excitation(generator: Generator) -> DrawnExcitation:
    """Draw a sweep or a multisine that rises from rest, for an amplitude of 1 m/s^2."""
    t = grid(0.0, SECONDS + AFTER)
    if generator.random() < 0.5:
        low, high = float(generator.uniform(BAND[0], 10.0)), float(generator.uniform(90.0, BAND[1]))
        turns = low * t + 0.5 * (high - low) / SECONDS * t**2
        kind, row = "sweep", np.sin(2.0 * np.pi * (turns + generator.random()))
    else:
        kind, (low, high) = "multisine", BAND
        row = np.sqrt(0.5) * random_lines(generator, t, low, high, TONES)
    return risen(kind, low, high, t, row)


def _friction(generator: Generator, inertia: float) -> tuple[str, dict[str, float]]:
    """Draw Coulomb friction (two of three) or Stribeck's law, 0.1 to 0.5 of ``inertia`` (rms, N)."""
    force, rises = inertia * generator.uniform(0.1, 0.5), generator.uniform(1.4, 2.0)
    speed = generator.uniform(0.02, 0.06)
    if generator.random() < 2.0 / 3.0:
        return COULOMB, {"coulomb_force": force}
    return STRIBECK, {"coulomb_force": force / rises, "static_force": force, "stribeck_velocity": speed}

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from spool_core.block import Block
from spool_core.uncertainty import Validity
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import Estimator, EstimatorSettings, settings_for
from spool_sim.excitation import PRESETS, Excitation, MachineOrders
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

NOISE = 0.03
SETTINGS = EstimatorSettings(0.18)


def simulator(
    valve: str = "4weh10_soft",
    excitation: str | Excitation = "multisine",
    coulomb_force: float = 0.3,
    rate: float = 2000.0,
    bias: float = 9.81,
) -> Simulator:
    return Simulator(
        find_valve(valve),
        PRESETS[excitation] if isinstance(excitation, str) else excitation,
        coulomb_force=coulomb_force,
        sample_rate=rate,
        block_size=round(rate / 50),
        seed=1,
        body_sensor=Sensor(noise=NOISE),
        spool_sensor=Sensor(noise=NOISE, bias=bias),
    )


@lru_cache(maxsize=1)
def record() -> tuple[Block, ...]:
    """Return 12 s of a valve with dry friction."""
    return tuple(simulator().records(12.0))


def estimates_of(blocks: Iterable[Block], estimator: Estimator | None = None) -> list[Estimate]:
    estimator = estimator or Estimator(SETTINGS)
    return [estimate for block in blocks for estimate in estimator.update(block)]


def exactly(estimates: Iterable[Estimate], **same: int) -> list[str]:
    """Return text in which every bit of every number shows (NaN included), ``same`` made equal."""
    return [repr(replace(estimate, **same)) for estimate in estimates]


@pytest.mark.parametrize("coulomb_force", [0.0, 0.3])
@pytest.mark.parametrize("excitation", ["stepped", "sweep", "multisine", "orders"])
@pytest.mark.parametrize("valve", ["4weh10_soft", "4weh10_stiff"])
def test_recovers_what_was_simulated(valve: str, excitation: str, coulomb_force: float) -> None:
    source = simulator(valve, excitation, coulomb_force)
    last = estimates_of(source.records(20.0), Estimator(settings_for(source.valve)))[-1]
    truth = source.truth
    assert last.state is State.TRACKING
    assert all(quantity.validity is Validity.VALID for quantity in last.parameters)
    assert last.parameter("spring_stiffness").value == pytest.approx(truth.spring_stiffness, rel=0.01)
    assert last.parameter("viscous_coefficient").value == pytest.approx(truth.viscous_coefficient, rel=0.05)
    if coulomb_force > 0.0:
        assert last.parameter("coulomb_force").value == pytest.approx(coulomb_force, rel=0.06)
    else:
        assert abs(last.parameter("coulomb_force").value) < 0.02
    assert last.natural_frequency.value == pytest.approx(truth.natural_frequency, rel=0.005)
    assert last.damping_ratio.value == pytest.approx(truth.damping_ratio, rel=0.055)
    assert last.residual.value < 0.12
    assert len(last.parameters) == 3


def test_one_estimate_a_second_stamped_with_the_newest_sample() -> None:
    blocks = record()
    estimates = estimates_of(blocks)
    assert len(estimates) == 12
    for number, estimate in enumerate(estimates, start=1):
        assert estimate.stamp == blocks[0].stamp + number * 1_000_000_000 - 500_000
        assert estimate.last_sequence == 50 * number - 1
    # The body's acceleration between two samples takes three samples on each side.
    assert estimates[-1].delay == pytest.approx(5 / 2000)
    assert estimates[-1].samples < 12 * 2000


def test_nothing_is_claimed_before_it_is_known() -> None:
    first = estimates_of(record()[:50])[0]
    assert first.state in (State.LEARNING, State.NOT_EXCITED)
    for quantity in (*first.parameters, first.natural_frequency, first.damping_ratio, first.residual):
        assert quantity.validity is Validity.UNKNOWN
        assert math.isnan(quantity.value)
        assert math.isnan(quantity.standard_deviation)


def test_dry_friction_of_point_values_is_certain_a_chunk_after_the_start() -> None:
    source = simulator(coulomb_force=0.5, rate=500.0)
    found = estimates_of(source.records(2.2), Estimator(settings_for(source.valve, memory=1.0, period=0.1)))
    assert found[-2].parameter("coulomb_force").value == pytest.approx(0.5, rel=0.01)


def malformed(block: Block, kind: str) -> Block:
    samples = {"body": block.body.copy(), "spool": block.spool.copy()}
    samples["body" if block.sequence % 2 else "spool"][3] = {"NaN": np.nan, "1e30": 1e30}.get(kind, -np.inf)
    return {
        "lengths": replace(block, body=block.body[:-1]),
        "empty": replace(block, body=block.body[:0], spool=block.spool[:0]),
        "period 0": replace(block, sample_period=0.0),
        "period NaN": replace(block, sample_period=math.nan),
        "period 1e-300": replace(block, sample_period=1e-300),
        "period 1e300": replace(block, sample_period=1e300),
        "no stamp": replace(block, stamp=0),
        "stamp back": replace(block, stamp=block.stamp - 100_000_000),
    }.get(kind, replace(block, **samples))


KINDS = ("lengths", "empty", "period 0", "period NaN", "period 1e-300", "period 1e300", "no stamp")
KINDS = (*KINDS, "stamp back", "NaN", "infinite", "1e30")


@pytest.mark.parametrize("kind", KINDS)
def test_malformed_blocks_never_reach_the_estimate(kind: str) -> None:
    blocks = record()[:300]
    disturbed = []
    for number, block in enumerate(blocks):
        if number in (59, 118, 179, 238, 299):
            disturbed.append(malformed(block, kind))
        disturbed.append(block)
    estimator = Estimator(SETTINGS)
    estimates = estimates_of(disturbed, estimator)
    assert estimates[-1].refused_blocks == 5
    assert estimator.gate.refused == 5
    assert exactly(estimates, refused_blocks=0) == exactly(estimates_of(blocks))


def test_two_valves_never_mix() -> None:
    soft, stiff = simulator(), simulator("4weh10_stiff")
    alone = [estimates_of(simulator(name).records(6.0)) for name in ("4weh10_soft", "4weh10_stiff")]
    estimators = (Estimator(SETTINGS), Estimator(SETTINGS))
    together: tuple[list[Estimate], list[Estimate]] = ([], [])
    for pair in zip(soft.records(6.0), stiff.records(6.0), strict=True):
        for which, block in enumerate(pair):
            together[which].extend(estimators[which].update(block))
    assert [exactly(each) for each in together] == [exactly(each) for each in alone]


def test_a_stale_estimate_is_held_and_claims_no_signal() -> None:
    estimator = Estimator(SETTINGS)
    assert estimator.stale() is None
    last = estimates_of(record(), estimator)[-1]
    stale = estimator.stale()
    assert stale is not None
    assert stale.state is State.STALE
    for old, new in zip(last.parameters, stale.parameters, strict=True):
        assert (new.value, new.standard_deviation) == (old.value, old.standard_deviation)
        assert new.validity is Validity.HELD
    for quantity in (stale.residual, stale.excitation, stale.relative_displacement):
        assert math.isnan(quantity.value)
        assert quantity.validity is Validity.UNKNOWN


def test_signals_are_reported_as_they_are() -> None:
    excitation = MachineOrders(speed_profile=((0.0, 1200.0),), orders=((1.0, 10.0),))
    last = estimates_of(simulator(excitation=excitation, coulomb_force=0.0).records(8.0))[-1]
    # Two equal stages of first order, 3 dB down together at low_cut.
    turn = cmath.exp(2j * math.pi * 20.0 / 2000.0)
    kept = math.exp(-2.0 * math.pi * SETTINGS.low_cut / 1.554 / 2000.0)
    passed = abs((turn - 1.0) / (turn - kept)) ** 2
    assert last.excitation.value == pytest.approx(passed * 10.0 / math.sqrt(2.0), rel=0.003)
    # Undamped but for the oil: z = -w'' / (w0^2 - w^2 + 2 i zeta w0 w).
    natural, omega = math.sqrt(1632.0 / 0.18), 2.0 * math.pi * 20.0
    moved = 10.0 / abs(natural**2 - omega**2 + 1j * omega * simulator().truth.viscous_coefficient / 0.18)
    assert last.relative_displacement.value == pytest.approx(passed * moved / math.sqrt(2.0), rel=0.01)


def test_an_unknown_parameter_is_a_key_error() -> None:
    with pytest.raises(KeyError, match="mass"):
        estimates_of(record()[:50])[0].parameter("mass")

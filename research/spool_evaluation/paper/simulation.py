"""Experiment of the paper, simulated: a body shaken at stepped frequencies, two accelerometers, a truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from spool_core.block import Block
from spool_core.numbers import Array
from spool_sim.excitation import Excitation, SteadySine, SteppedSine
from spool_sim.model import Model, model_from_mapping
from spool_sim.sensors import PAPER_CHAIN, Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import Valve

from .data import PaperSeries

#: What the data are made with: fluid friction (12) and dry friction that falls with speed, N and m/s.
#: It is none of the four models, so that none of them can win by being the truth.
TRUTH: dict[str, float] = {"coulomb_force": 0.15, "static_force": 0.30, "stribeck_velocity": 0.02}
TRUTH_TERMS: tuple[str, ...] = ("inertia", "spring", "viscous_friction", "stribeck_friction")
NOISE = 0.05


@dataclass(frozen=True, slots=True)
class Plan:
    """How the body is shaken and what is looked at.

    Attributes:
        frequencies: of the steps, Hz; whole multiples of 1 / window, so that a window holds whole periods.
        amplitude: of the body's acceleration, peak, m/s^2.
        amplitudes: one for each step in place of ``amplitude``; each step then begins at rest.
        dwell: s on each frequency.
        window: s at the end of each step that counts.
        sample_rate: Hz.
    """

    frequencies: tuple[float, ...] = tuple(float(f) for f in range(10, 101, 5))
    amplitude: float = 5.0
    dwell: float = 1.0
    window: float = 0.4
    sample_rate: float = 2000.0
    amplitudes: tuple[float, ...] = ()

    @property
    def samples(self) -> int:
        """Samples in a window."""
        return round(self.window * self.sample_rate)


@dataclass(frozen=True)
class SteppedResponse:
    """Accelerations (m/s^2) of body and spool in the windows of a plan, shape (steps, samples)."""

    plan: Plan
    body: Array
    spool: Array

    @property
    def body_amplitudes(self) -> Array:
        """Amplitude of the body at each step's frequency, m/s^2, shape (steps,)."""
        return _amplitudes(self.plan, self.body)

    @property
    def spool_amplitudes(self) -> Array:
        """Amplitude of the spool at each step's frequency, m/s^2, shape (steps,)."""
        return _amplitudes(self.plan, self.spool)


def respond(
    valve: Valve,
    model: Model | str,
    parameters: Mapping[str, float],
    plan: Plan,
    *,
    body_sensor: Sensor | None = None,
    spool_sensor: Sensor | None = None,
    seed: int = 0,
) -> SteppedResponse:
    """Return what the accelerometers read while the body goes through the steps of ``plan``.

    Raises:
        InputError: the model does not know a parameter, or a value is out of range.
    """
    excitations: list[Excitation]
    if plan.amplitudes:
        pairs = zip(plan.frequencies, plan.amplitudes, strict=True)
        excitations = [SteadySine(frequency=one, amplitude=size) for one, size in pairs]
    else:
        excitations = [SteppedSine(frequencies=plan.frequencies, dwell=plan.dwell, amplitude=plan.amplitude)]
    blocks: list[Block] = []
    for number, excitation in enumerate(excitations):
        simulator = Simulator(
            valve,
            excitation,
            model=model,
            parameters=parameters,
            sample_rate=plan.sample_rate,
            block_size=round(plan.dwell * plan.sample_rate),
            # Each step's noise is its own; the seeds of the series are 1 apart.
            seed=seed + 1000 * number,
            body_sensor=body_sensor,
            spool_sensor=spool_sensor,
        )
        blocks += simulator.records(plan.dwell * len(plan.frequencies) / len(excitations))
    kept = slice(-plan.samples, None)
    return SteppedResponse(
        plan,
        np.array([block.body[kept] for block in blocks], dtype=np.float64),
        np.array([block.spool[kept] for block in blocks], dtype=np.float64),
    )


def truth_model() -> Model:
    """Return the model that the data are made with."""
    return model_from_mapping({"name": "truth", "terms": TRUTH_TERMS, "parameters": TRUTH})


def sensors(seed: int) -> tuple[Sensor, Sensor]:
    """Return the accelerometers of body and spool, with gain errors drawn within the paper's 5 %."""
    generator = np.random.default_rng(seed)
    return PAPER_CHAIN.sensor(generator, noise=NOISE), PAPER_CHAIN.sensor(generator, noise=NOISE)


def measure(series: PaperSeries, plan: Plan, seed: int) -> SteppedResponse:
    """Return the data of ``series``; the same two accelerometers measure every series of a ``seed``."""
    body, spool = sensors(seed)
    return respond(
        series.valve, truth_model(), {}, plan,
        body_sensor=body, spool_sensor=spool, seed=seed + series.number,
    )  # fmt: skip


def as_measured(plan: Plan, measured: SteppedResponse) -> Plan:
    """Return ``plan`` with the body's amplitude as the accelerometer has it: a fit knows no other."""
    if not plan.amplitudes:
        return replace(plan, amplitude=float(measured.body_amplitudes.mean()))
    gain = float(np.mean(measured.body_amplitudes / np.array(plan.amplitudes)))
    return replace(plan, amplitudes=tuple(gain * size for size in plan.amplitudes))


def _amplitudes(plan: Plan, samples: Array) -> Array:
    turns = np.outer(plan.frequencies, np.arange(samples.shape[1]) / plan.sample_rate)
    return np.asarray(np.abs(np.mean(2.0 * samples * np.exp(-2j * np.pi * turns), axis=1)))

"""Printed data of the paper (series, fitted values, model equations), and its experiment simulated.

Stosiak, Karpenko, Deptula, Urbanowicz, Skackauskas, Cieslicki, Deptula: Modelling and Experimental
Verification of the Interaction in a Hydraulic Directional Control Valve Spool Pair (2022), CC BY. It prints
no measurements.
"""

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


@dataclass(frozen=True, slots=True)
class PaperSeries:
    """A pair of springs and an oil (tables 1 and 2).

    Attributes:
        number: as in table 1.
        spring_stiffness: equivalent of the pair, N/m.
        oil: name.
        dynamic_viscosity: Pa s, as printed.
        figure, ratio_figure: numbers of the paper's figures of amplitudes and of amplitude ratios.
    """

    number: int
    spring_stiffness: float
    oil: str
    dynamic_viscosity: float
    figure: int
    ratio_figure: int

    @property
    def label(self) -> str:
        """Short name, for legends and tables."""
        return f"{self.spring_stiffness:g} N/m, {self.oil}"

    @property
    def valve(self) -> Valve:
        """The valve of table 2 with this series' springs and oil."""
        return Valve(
            id=f"paper_series_{self.number}",
            moving_mass=0.18,
            spool_mass=0.172,
            spring_stiffness=self.spring_stiffness,
            land_diameter=0.020,
            land_length=0.032,
            radial_clearance=15e-6,
            dynamic_viscosity=self.dynamic_viscosity,
            oil=self.oil,
            oil_temperature=20.0,
        )

    def drag(self, gap: float) -> float:
        """Return the viscous coefficient (N s/m) of equation (12) with a gap of that height (m)."""
        return self.valve.model_copy(update={"radial_clearance": gap}).viscous_coefficient


SERIES: tuple[PaperSeries, ...] = (
    PaperSeries(1, 1632.0, "Azolla ZS22", 0.0198, 6, 17),
    PaperSeries(2, 5846.0, "HL68", 0.0612, 7, 15),
    PaperSeries(3, 5846.0, "Azolla ZS22", 0.0198, 8, 16),
    PaperSeries(4, 1632.0, "HL68", 0.0612, 9, 14),
)


@dataclass(frozen=True, slots=True)
class PrintedModel:
    """One of the paper's four models and what the paper found for it.

    Attributes:
        number: as in the paper.
        name: of the model in this suite.
        equation, table: numbers in the paper.
        columns: what the table lists, with units.
        parameters: the suite's names of the columns.
        values: a row for each series, by its number, in SI units.
        objective: printed value of the objective by series number.
        mean_objective, mean_ratio: printed in table 7.
    """

    number: int
    name: str
    equation: str
    table: int
    columns: tuple[str, ...]
    parameters: tuple[str, ...]
    values: dict[int, tuple[float, ...]]
    objective: dict[int, float]
    mean_objective: float
    mean_ratio: float


MODELS: tuple[PrintedModel, ...] = (
    PrintedModel(
        1, "microwedge", "(13)", 3, ("a_k0 (m)", "d_k0 (m)", "k_t (N/m)"),
        ("microwedge_overlap", "microwedge_length", "contact_proportionality"),
        {
            1: (7.1717e-5, 0.0032, 99.985), 2: (1.9854e-6, 0.00732, 100.0),
            3: (2e-6, 8e-6, 100.0), 4: (0.00356, 0.00565, 46.86),
        },
        {1: 3.1135e7, 2: 7.618e7, 3: 1.0015e8, 4: 4.1084e7}, 6.27e7, 0.65,
    ),
    PrintedModel(
        2, "mixed", "(23)", 4, ("C1 (√(s/m))", "C2 (m/s)"),
        ("mixed_root_coefficient", "mixed_inverse_coefficient"),
        {1: (9.9684, 15.9903), 2: (9.9998, 9.9906), 3: (9.9998, 10.0046), 4: (10.0536, 9.6365)},
        {1: 8.98e6, 2: 1.81e7, 3: 1.72e7, 4: 1.67e7}, 1.52e7, 0.89,
    ),
    PrintedModel(
        3, "coulomb_hydrodynamic", "(28a)", 5, ("μ0 (-)", "K_V (-)"), ("dry_coefficient", "film_coefficient"),
        {1: (0.03823, 0.025445), 2: (0.10885, -0.047217), 3: (0.10039, -0.0008), 4: (0.16025, 0.77652)},
        {1: 3.1519e7, 2: 7.4157e7, 3: 9.8865e7, 4: 2.4495e7}, 5.73e7, 0.70,
    ),
    PrintedModel(
        4, "fluid", "(29)", 6, ("h (m)",), ("viscous_coefficient",),
        {1: (8.7237e-5,), 2: (8.4188e-6,), 3: (1.9375e-5,), 4: (3.1171e-5,)},
        {1: 2.9153e7, 2: 2.9586e7, 3: 2.2014e7, 4: 2.5752e7}, 2.66e7, 0.40,
    ),
)  # fmt: skip


def printed_parameters(model: PrintedModel, series: PaperSeries) -> dict[str, float]:
    """Return the parameters, by this suite's names, that the paper's table gives for ``series``."""
    values = model.values[series.number]
    if model.name == "fluid":
        values = (series.drag(values[0]),)
    return dict(zip(model.parameters, values, strict=True))


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

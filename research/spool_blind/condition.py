"""Experiment condition of a record: valve, oil, excitation, sampling, noise, nuisances."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spool_blind.simulator.linear import respond
from spool_blind.simulator.plant import AFTER, Plant, SpoolMotion, move, steps

from .excitations import KINDS, DrawnExcitation, draw_excitation

Array = NDArray[np.float64]

#: N/m, the paper's springs; N s/m, kg and m/s^2, drawn around its oils, spool and shaker.
SOFT, STIFF = 1632.0, 5846.0
VISCOUS = (1.2, 8.5)
MASS = (0.15, 0.22)
AMPLITUDE = (3.0, 20.0)
RATES = (1000.0, 1250.0, 2000.0, 2500.0, 4000.0, 5000.0)
DURATION = (20.0, 60.0)
NOISE = (0.003, 0.03)
#: Declared tolerances of the sensors; a share of the records uses most of them.
GAIN_TOLERANCE, DELAY_TOLERANCE = 0.05, 0.5e-3
NUISANCE_SHARE = 0.4
NUISANCE_USE = 0.9
#: s, Hz and share of a moderate condition.
MODERATE_DURATION, MODERATE_RATE, MODERATE_NOISE = (15.0, 20.0), 2000.0, 0.01
#: Hz at which the motion without effects is looked at.
SCALE_RATE = 2000.0
#: m, travel beyond which an excitation is turned down: the valve's stroke.
LARGEST_TRAVEL = 5e-3


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale of the motion while nothing is hidden; sizes of effects are drawn in these terms.

    Attributes:
        force: rms of mass times the body's acceleration, N.
        travel, travel_peak: rms and peak of the displacement, m.
        velocity: rms, m/s.
        acceleration, acceleration_peak: rms and peak of the spool's acceleration, m/s^2.
    """

    force: float
    travel: float
    travel_peak: float
    velocity: float
    acceleration: float
    acceleration_peak: float


@dataclass(frozen=True, slots=True)
class ExperimentCondition:
    """Experiment condition, drawn.

    Attributes:
        base: the spool with nothing hidden.
        nominal_stiffness: what the valve's description says, N/m.
        excitation: of the body, to be multiplied with ``amplitude``.
        amplitude: m/s^2.
        sample_rate: Hz.
        duration: s.
        before: s of motion ahead of the record; 0: it starts at rest.
        noise_share: rms of the noise over that of the spool's acceleration.
        gain, delay: nuisances of the spool's channel, within the declared tolerances.
    """

    base: Plant
    nominal_stiffness: float
    excitation: DrawnExcitation
    amplitude: float
    sample_rate: float
    duration: float
    before: float
    noise_share: float
    gain: float
    delay: float

    def move(self, plant: Plant, like: Plant | None = None) -> SpoolMotion:
        """Move ``plant`` under this condition's excitation, in steps as short as ``like`` would need."""
        longest = plant.longest_step if like is None else like.longest_step
        time, h = steps(self.duration, self.sample_rate, self.before, longest)
        return move(plant, time, h, self.amplitude * self.excitation.at(time))

    def scale(self) -> Scale:
        """Return how the base moves."""
        t: Array = np.arange(-self.before, self.duration, 1.0 / SCALE_RATE, dtype=np.float64)
        body = self.amplitude * self.excitation.at(t)
        numbers = self.base.numbers
        spool = respond(numbers, body, SCALE_RATE)
        z = respond(numbers, body, SCALE_RATE, travel=True)
        part = t > 0.0
        return Scale(
            force=float(numbers["mass"] * body[part].std()),
            travel=float(z[part].std()),
            travel_peak=float(np.abs(z[part]).max()),
            velocity=float((np.diff(z) * SCALE_RATE).std()),
            acceleration=float(spool[part].std()),
            acceleration_peak=float(np.abs(spool[part]).max()),
        )


def draw_condition(
    generator: np.random.Generator, *, from_rest: bool = False, moderate: bool = False
) -> ExperimentCondition:
    """Draw a condition whose travel stays within the stroke wherever the least amplitude allows it.

    Args:
        generator: of the numbers.
        from_rest: the record begins before the motion does.
        moderate: a short record at a common rate, with middling noise and nothing of the tolerances used.
    """
    nominal = float(generator.choice([SOFT, STIFF]))
    base = Plant(
        {
            "mass": float(generator.uniform(*MASS)),
            "stiffness": nominal * float(generator.uniform(0.96, 1.04)),
            "damping": float(np.exp(generator.uniform(*np.log(VISCOUS)))),
        }
    )
    resonance = float(np.sqrt(base.numbers["stiffness"] / base.numbers["mass"]) / (2.0 * np.pi))
    duration = round(float(generator.uniform(*(MODERATE_DURATION if moderate else DURATION))))
    before = 0.0 if from_rest else float(generator.choice([0.0, 1.0]))
    kind = str(generator.choice(list(KINDS)))
    excitation = draw_excitation(generator, kind, resonance, -before, duration + AFTER)
    nuisance = generator.random() < NUISANCE_SHARE and not moderate
    use = NUISANCE_USE if nuisance else 0.0
    condition = ExperimentCondition(
        base=base,
        nominal_stiffness=nominal,
        excitation=excitation,
        amplitude=float(np.exp(generator.uniform(*np.log(AMPLITUDE)))),
        sample_rate=MODERATE_RATE if moderate else float(generator.choice(list(RATES))),
        duration=float(duration),
        before=before,
        noise_share=MODERATE_NOISE if moderate else float(np.exp(generator.uniform(*np.log(NOISE)))),
        gain=1.0 + use * GAIN_TOLERANCE * float(generator.uniform(-1.0, 1.0)),
        delay=use * DELAY_TOLERANCE * float(generator.uniform(-1.0, 1.0)),
    )
    too_far = condition.scale().travel_peak / LARGEST_TRAVEL
    if too_far > 1.0:
        condition = replace(condition, amplitude=max(condition.amplitude / too_far, AMPLITUDE[0]))
    return condition

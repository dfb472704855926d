"""Experiment condition of a field case: what machine, logger and valve are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spool_blind.condition import (
    AMPLITUDE,
    DELAY_TOLERANCE,
    GAIN_TOLERANCE,
    LARGEST_TRAVEL,
    MASS,
    NUISANCE_SHARE,
    NUISANCE_USE,
    SOFT,
    STIFF,
    VISCOUS,
    ExperimentCondition,
)
from spool_blind.simulator.plant import AFTER, Plant

from .excitations import FIELD_KINDS, draw_field_excitation

#: Hz, s, and rms of white noise over that of the channel's acceleration.
RATES = (1000.0, 1250.0, 2000.0, 2500.0, 4000.0, 5000.0, 8000.0, 10_000.0)
DURATION = (20.0, 60.0)
NOISE = (0.002, 0.02)


def draw_field_condition(generator: np.random.Generator, *, from_rest: bool = False) -> ExperimentCondition:
    """Draw a condition whose travel stays within the stroke wherever the least amplitude allows it.

    Args:
        generator: of the numbers.
        from_rest: the record begins before the motion does.
    """
    nominal = float(generator.choice([SOFT, STIFF]))
    numbers = {
        "mass": float(generator.uniform(*MASS)),
        "stiffness": nominal * float(generator.uniform(0.96, 1.04)),
        "damping": float(np.exp(generator.uniform(*np.log(VISCOUS)))),
    }
    resonance = float(np.sqrt(numbers["stiffness"] / numbers["mass"]) / (2.0 * np.pi))
    duration = float(round(generator.uniform(*DURATION)))
    before = float(generator.choice([0.0, 1.0]))
    before = 0.0 if from_rest else before
    kind = str(generator.choice(list(FIELD_KINDS)))
    use = NUISANCE_USE if generator.random() < NUISANCE_SHARE else 0.0
    condition = ExperimentCondition(
        base=Plant(numbers),
        nominal_stiffness=nominal,
        excitation=draw_field_excitation(generator, kind, resonance, -before, duration + AFTER),
        amplitude=float(np.exp(generator.uniform(*np.log(AMPLITUDE)))),
        sample_rate=float(generator.choice(list(RATES))),
        duration=duration,
        before=before,
        noise_share=float(np.exp(generator.uniform(*np.log(NOISE)))),
        gain=1.0 + use * GAIN_TOLERANCE * float(generator.uniform(-1.0, 1.0)),
        delay=use * DELAY_TOLERANCE * float(generator.uniform(-1.0, 1.0)),
    )
    too_far = condition.scale().travel_peak / LARGEST_TRAVEL
    return replace(condition, amplitude=condition.amplitude / max(too_far, 1.0))

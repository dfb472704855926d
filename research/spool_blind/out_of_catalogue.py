"""Out-of-catalogue effects: no catalogue lists them, so a name for one would be wrong."""

from __future__ import annotations

import numpy as np

from .condition import ExperimentCondition, Scale
from .hidden import Generator, Hidden, Kind, between, either_sign


def lugre(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """LuGre's friction: bristles whose limit falls with speed, and a damping of their own."""
    static = between(generator, 0.25, 0.45) * scale.force
    stiffness = static / (between(generator, 0.03, 0.1) * scale.travel)
    return Hidden(
        {
            "static_force": static,
            "coulomb_force": between(generator, 0.4, 0.6) * static,
            "stribeck_velocity": between(generator, 0.2, 0.5) * scale.velocity,
            "stribeck_exponent": 2.0,
            "bristle_stiffness": stiffness,
            "bristle_damping": between(generator, 0.1, 0.4) * float(np.sqrt(stiffness * 0.18)),
        },
        size=("static_force", "coulomb_force", "bristle_stiffness", "bristle_damping"),
    )


def sensor_low_pass(generator: Generator, condition: ExperimentCondition, _: Scale) -> Hidden:
    """A low-pass in the spool's sensor alone; far above the excitation it would be a mere delay."""
    return Hidden({}, {"low_pass": between(generator, 0.5, 1.4) * condition.excitation.high})


def damping_by_position(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """Drag that grows away from the centre: the overlap of the lands changes."""
    value = between(generator, 1.0, 3.0) / (2.0 * scale.travel) ** 2 * 2.0
    return Hidden({"damping_by_position": value}, size=("damping_by_position",))


def stiffness_drift(generator: Generator, condition: ExperimentCondition, _: Scale) -> Hidden:
    """A spring that changes with its temperature over the record."""
    rate = either_sign(generator, between(generator, 0.06, 0.15)) / condition.duration
    return Hidden({"stiffness_rate": rate}, size=("stiffness_rate",))


def bouc_wen(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """Hysteresis after Bouc and Wen."""
    force = between(generator, 0.2, 0.45) * scale.force
    travel = between(generator, 0.15, 0.5) * scale.travel
    return Hidden({"hysteresis_force": force, "hysteresis_travel": travel}, size=("hysteresis_force",))


def flow_force_step(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """A force that sets in where a land opens."""
    force = between(generator, 0.2, 0.5) * scale.force
    place = either_sign(generator, between(generator, 0.3, 1.2) * scale.travel)
    return Hidden(
        {"step_force": -force, "step_place": place, "step_width": 0.1 * scale.travel}, size=("step_force",)
    )


def fractional_drag(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """Drag with the root of the speed, or a power near it."""
    exponent = between(generator, 0.35, 0.6)
    force = between(generator, 0.3, 0.6) * scale.force
    return Hidden(
        {"power_drag": force / scale.velocity**exponent, "power_exponent": exponent}, size=("power_drag",)
    )


def sampling_jitter(generator: Generator, condition: ExperimentCondition, _: Scale) -> Hidden:
    """A spool channel whose sampling instants scatter."""
    return Hidden({}, {"jitter": between(generator, 0.3, 0.6) / condition.sample_rate}, size=("jitter",))


def slipping_mass(generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
    """A part that rides on the spool by friction and slips when pulled hard."""
    share = between(generator, 0.15, 0.35)
    mass = share * condition.base.numbers["mass"]
    friction = between(generator, 0.3, 0.7) * mass * scale.acceleration
    return Hidden({"loose_mass": mass, "loose_friction": friction}, size=("loose_mass", "loose_friction"))


def sensor_mounting(generator: Generator, _: ExperimentCondition, __: Scale) -> Hidden:
    """A spool sensor on an elastic mounting."""
    return Hidden({}, {"mount_frequency": between(generator, 130.0, 220.0), "mount_damping": 0.05})


def skew_spring(generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
    """A spring that is stiffer on one side."""
    value = either_sign(generator, between(generator, 0.12, 0.3))
    return Hidden(
        {"skew_stiffness": value * condition.base.numbers["stiffness"] / scale.travel_peak},
        size=("skew_stiffness",),
    )


OUT_OF_CATALOGUE: dict[str, Kind] = {
    name: Kind(draw, "out_of_catalogue", ("unexplained",))
    for name, draw in {
        "lugre_friction": lugre,
        "sensor_low_pass": sensor_low_pass,
        "damping_by_position": damping_by_position,
        "stiffness_drift": stiffness_drift,
        "bouc_wen_hysteresis": bouc_wen,
        "flow_force_step": flow_force_step,
        "fractional_drag": fractional_drag,
        "sampling_jitter": sampling_jitter,
        "slipping_mass": slipping_mass,
        "sensor_mounting": sensor_mounting,
        "skew_spring": skew_spring,
    }.items()
}

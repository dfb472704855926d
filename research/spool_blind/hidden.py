"""Hidden effects of the catalogue, and what they do to plant and channel."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from spool_blind.condition import ExperimentCondition, Scale

Generator = np.random.Generator
#: A limit is not drawn further in than this share of the peak.
LEAST_EDGE = 0.3


@dataclass(frozen=True, slots=True)
class Hidden:
    """Hidden effect at the size it was drawn with.

    Attributes:
        plant: numbers of the plant that it sets, see ``simulator.NAMES``.
        channel: attributes of ``MeasuringChain`` that it sets.
        truth: values that a fit should find, by the names of the catalogue's parameters, SI.
        size: names in ``plant``, ``channel`` and ``truth`` that grow with its size.
        edges: names of limits, with the peak that they cut; larger is further below the peak.
    """

    plant: Mapping[str, float] = field(default_factory=dict)
    channel: Mapping[str, float] = field(default_factory=dict)
    truth: Mapping[str, float] = field(default_factory=dict)
    size: tuple[str, ...] = ()
    edges: Mapping[str, float] = field(default_factory=dict)

    def sized(self, factor: float) -> Hidden:
        """Return the same, ``factor`` times as large."""

        def scaled(values: Mapping[str, float]) -> dict[str, float]:
            return {name: self._scaled(name, value, factor) for name, value in values.items()}

        channel = scaled(self.channel)
        if "gain" in channel:  # its size is what it differs from 1 by
            channel["gain"] = 1.0 + factor * (self.channel["gain"] - 1.0)
        return replace(self, plant=scaled(self.plant), channel=channel, truth=scaled(self.truth))

    def _scaled(self, name: str, value: float, factor: float) -> float:
        if name in self.edges:
            peak = self.edges[name]
            return max(peak - factor * (peak - value), LEAST_EDGE * peak)
        return value * factor if name in self.size else value


Draw = Callable[[Generator, ExperimentCondition, Scale], Hidden]

#: m/s^2: normal load of mixed friction is the spool's weight.
GRAVITY = 9.80665
#: Part of the moving mass that is the spool's own.
SPOOL_SHARE = 0.172 / 0.18


class Kind(NamedTuple):
    """Kind of hidden effect: ``draw`` makes it at clear size; two of a pair are of different groups."""

    draw: Draw
    group: str


def coulomb(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """A constant force against the motion."""
    force = between(generator, 0.12, 0.4) * scale.force
    return Hidden({"coulomb_force": force}, {}, {"coulomb_force": force}, ("coulomb_force",))


def stribeck(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """Friction that falls with speed from a static value."""
    static = between(generator, 0.25, 0.5) * scale.force
    force = between(generator, 0.35, 0.65) * static
    speed = between(generator, 0.2, 0.5) * scale.velocity
    numbers = {"coulomb_force": force, "static_force": static, "stribeck_velocity": speed}
    exponent = between(generator, 1.0, 2.0)
    return Hidden({**numbers, "stribeck_exponent": exponent}, {}, numbers, ("coulomb_force", "static_force"))


def mixed(generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
    """Contacts that fall with speed and a root of the speed that rises."""
    rest = between(generator, 0.25, 0.5) * scale.force
    speed = between(generator, 0.005, 0.02)
    root = between(generator, 0.2, 0.5) * scale.force / float(np.sqrt(scale.velocity))
    load = GRAVITY * SPOOL_SHARE * condition.base.numbers["mass"]
    return Hidden(
        {"root_drag": root, "contact_power": rest * speed, "contact_velocity": speed},
        {},
        {
            "mixed_root_coefficient": root / load,
            "mixed_inverse_coefficient": rest * speed / load,
            "mixed_velocity": speed,
        },
        ("root_drag", "contact_power", "mixed_root_coefficient", "mixed_inverse_coefficient"),
    )


def asymmetric(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """Another constant force in either direction."""
    force = between(generator, 0.15, 0.4) * scale.force
    excess = either_sign(generator, between(generator, 0.25, 0.6) * force)
    return Hidden(
        {"coulomb_force": force, "asymmetry": excess},
        {},
        {"forward_force": force + excess, "backward_force": force - excess},
        ("coulomb_force", "asymmetry", "forward_force", "backward_force"),
    )


def presliding(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """Friction that builds up over a travel after each reversal (Dahl)."""
    force = between(generator, 0.15, 0.4) * scale.force
    stiffness = force / (between(generator, 0.03, 0.1) * scale.travel)
    return Hidden(
        {"coulomb_force": force, "bristle_stiffness": stiffness},
        {},
        {"dahl_force": force, "dahl_stiffness": stiffness},
        ("coulomb_force", "bristle_stiffness", "dahl_force", "dahl_stiffness"),
    )


def quadratic(generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
    """Drag with the square of the speed."""
    value = between(generator, 0.4, 1.2) * condition.base.numbers["damping"] / scale.velocity
    return Hidden(
        {"quadratic": value}, {}, {"quadratic_coefficient": value}, ("quadratic", "quadratic_coefficient")
    )


def cubic(generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
    """A spring that hardens, less often softens."""
    share = between(generator, 0.1, 0.35) if generator.random() < 0.8 else -between(generator, 0.08, 0.15)
    value = share * condition.base.numbers["stiffness"] / scale.travel_peak**2
    return Hidden({"cubic": value}, {}, {"cubic_coefficient": value}, ("cubic", "cubic_coefficient"))


def end_stop(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """Elastic stops with loss; larger is nearer to the centre."""
    gap = between(generator, 0.55, 0.85) * scale.travel_peak
    stiffness = float(np.exp(between(generator, *np.log([2e5, 1e6]))))
    loss = between(generator, 0.05, 0.3) * 2.0 * float(np.sqrt(stiffness * 0.18))
    numbers = {"stop_gap": gap, "stop_stiffness": stiffness, "stop_damping": loss}
    return Hidden(numbers, {}, {"stop_gap": gap}, edges={"stop_gap": scale.travel_peak})


def backlash(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """Play of the springs."""
    value = between(generator, 0.04, 0.12) * scale.travel_peak
    return Hidden({"backlash": value}, {}, {"backlash": value}, ("backlash",))


def preload(generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
    """Springs that hold the spool in the centre up to a force."""
    force = between(generator, 0.12, 0.35) * condition.base.numbers["stiffness"] * scale.travel
    travel = between(generator, 1e-5, 3e-5)
    return Hidden(
        {"preload_force": force, "preload_travel": travel}, {}, {"preload_force": force}, ("preload_force",)
    )


def ripple(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """An independent sine."""
    force = between(generator, 0.1, 0.3) * scale.force
    frequency = between(generator, 20.0, 110.0)
    return Hidden(
        {"ripple_force": force, "ripple_frequency": frequency, "ripple_phase": between(generator, 0.0, 6.28)},
        {},
        {"force_amplitude": force, "force_frequency": frequency},
        ("ripple_force", "force_amplitude"),
    )


def drift(generator: Generator, condition: ExperimentCondition, _: Scale) -> Hidden:
    """Viscous drag that changes in proportion to time."""
    change = -between(generator, 0.25, 0.5) if generator.random() < 0.7 else between(generator, 0.3, 0.6)
    rate = change / condition.duration
    return Hidden(
        {"damping_rate": rate}, {}, {"damping_drift_rate": rate}, ("damping_rate", "damping_drift_rate")
    )


def gain(generator: Generator, _: ExperimentCondition, __: Scale) -> Hidden:
    """A gain beyond the declared tolerance."""
    error = either_sign(generator, between(generator, 0.06, 0.12))
    return Hidden({}, {"gain": 1.0 + error}, {"gain_error": error}, ("gain_error",))


def delay(generator: Generator, _: ExperimentCondition, __: Scale) -> Hidden:
    """A delay beyond the declared tolerance."""
    value = either_sign(generator, between(generator, 0.6e-3, 1.5e-3), 0.7)
    return Hidden({}, {"delay": value}, {"delay": value}, ("delay",))


def saturation(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """A sensor that ends below the largest acceleration."""
    value = between(generator, 0.5, 0.8) * scale.acceleration_peak
    return Hidden(
        {}, {"full_scale": value}, {"full_scale": value}, edges={"full_scale": scale.acceleration_peak}
    )


def between(generator: Generator, low: float, high: float) -> float:
    """Draw evenly from ``low`` to ``high``."""
    return float(generator.uniform(low, high))


def either_sign(generator: Generator, value: float, positive: float = 0.5) -> float:
    """Return ``value`` with a drawn sign, plus with the chance ``positive``."""
    return value if generator.random() < positive else -value


#: Those of the catalogue, by id.
EFFECTS: dict[str, Kind] = {
    "coulomb_friction": Kind(coulomb, "friction"),
    "stribeck_friction": Kind(stribeck, "friction"),
    "mixed_friction": Kind(mixed, "friction"),
    "asymmetric_friction": Kind(asymmetric, "friction"),
    "presliding_friction": Kind(presliding, "friction"),
    "quadratic_damping": Kind(quadratic, "damping"),
    "cubic_stiffness": Kind(cubic, "spring"),
    "end_stop": Kind(end_stop, "spring"),
    "spring_backlash": Kind(backlash, "spring"),
    "spring_preload": Kind(preload, "spring"),
    "periodic_force": Kind(ripple, "outside"),
    "damping_drift": Kind(drift, "time"),
    "spool_gain_error": Kind(gain, "gain"),
    "spool_delay": Kind(delay, "delay"),
    "sensor_saturation": Kind(saturation, "range"),
}

NONE = "none"
#: Two accelerometers see these only in how the motion sets in.
FROM_REST = ("asymmetric_friction",)
#: Two effects that one record may hide.
PAIRS: tuple[str, ...] = tuple(
    f"{one}+{other}"
    for one, other in combinations(sorted(EFFECTS), 2)
    if EFFECTS[one].group != EFFECTS[other].group
    and {"gain", "delay"} != {EFFECTS[one].group, EFFECTS[other].group}
)


def kind_of(hidden: str) -> str:
    """Return none, effect, pair or out_of_catalogue."""
    if hidden == NONE:
        return NONE
    if "+" in hidden:
        return "pair"
    return "effect" if hidden in EFFECTS else "out_of_catalogue"

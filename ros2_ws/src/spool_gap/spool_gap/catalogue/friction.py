"""Laws of dry friction: a machine has one of them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array
from spool_sim.terms.friction import play
from spool_sim.terms.paper_friction import NORMAL_LOAD

from spool_gap.effect import SHARES, Effect, scan

#: Share of the force at speed by which the force at rest exceeds it at least: less is Coulomb friction.
LEAST_EXCESS = 0.1
#: m/s, speed that a spool hardly exceeds.
FASTEST = 0.3
#: m/s, choices of gamma_m.
VELOCITIES = (0.003, 0.006, 0.012, 0.025, 0.05)
#: Stribeck velocities over the motion's speed, m/s at which contacts fall, and travels before sliding over
#: the motion's that are tried.
SLOW, CONTACTS, TRAVELS = (0.05, 0.2, 0.6), (0.01, 0.05, 0.2), (0.01, 0.06, 0.25)
#: Film's part of mixed friction at speed over that of the contacts at rest: none, or either may lead.
FILMS = (0.0, 0.5, 2.0)
#: m of travel before sliding below which no record of an accelerometer shows any.
SHORTEST = 1e-7


def jump(sign: Array) -> Array:
    return sign


COULOMB_FRICTION = Effect(
    id="coulomb_friction",
    group="dry friction",
    positive=True,
    confusable_with=(
        "stribeck_friction",
        "mixed_friction",
        "presliding_friction",
        "asymmetric_friction",
        "quadratic_damping",
    ),
    distinguished_by="low speeds and sticking in the record; several amplitudes",
    acts=jump,
)


def jumps_of_both(sign: Array) -> list[Array]:
    return [sign, np.abs(sign)]


def both_sides(coefficients: list[float]) -> dict[str, float] | None:
    mean, half = coefficients
    if abs(half) > mean:
        return None
    return {"forward_force": mean + half, "backward_force": mean - half}


def alike(forward_force: float, backward_force: float, deviations: Mapping[str, float]) -> str:
    largest = max(deviations.get(name, 0.0) for name in ("forward_force", "backward_force"))
    if abs(forward_force - backward_force) < 4.0 * largest:
        return "the two forces do not differ significantly"
    return ""


#: To a moving spool the difference of the two jumps is a constant push.
ASYMMETRIC_FRICTION = Effect(
    id="asymmetric_friction",
    group="dry friction",
    replaces=("coulomb_friction",),
    searched=False,
    load_cell_zero=True,
    confusable_with=("coulomb_friction",),
    distinguished_by="the start of the motion from rest: two accelerometers see the difference only there",
    acts=jumps_of_both,
    solved=both_sides,
    refused=alike,
)


def stribeck(sign: Array, velocity: Array, stribeck_velocity: float, stribeck_exponent: float) -> list[Array]:
    ratio = np.abs(velocity) / stribeck_velocity
    return [sign, sign * np.exp(-(ratio**stribeck_exponent))]


def at_rest_and_at_speed(coefficients: list[float]) -> dict[str, float] | None:
    coulomb, excess = coefficients
    if excess <= 0.0 or coulomb < 0.0:
        return None
    return {"coulomb_force": coulomb, "static_force": coulomb + excess}


def no_excess(coulomb_force: float, static_force: float, deviations: Mapping[str, float]) -> str:
    least = max(3.0 * deviations.get("static_force", 0.0), LEAST_EXCESS * coulomb_force)
    if static_force - coulomb_force < least:
        return "the force at rest does not significantly exceed the force at speed"
    return ""


STRIBECK_FRICTION = Effect(
    id="stribeck_friction",
    group="dry friction",
    replaces=("coulomb_friction",),
    confusable_with=("coulomb_friction", "mixed_friction"),
    distinguished_by="low speeds and sticking: small amplitudes, low frequencies",
    acts=stribeck,
    solved=at_rest_and_at_speed,
    tried=lambda largest_velocity: [
        {"stribeck_velocity": velocity, "stribeck_exponent": exponent}
        for velocity in scan(0.02 * largest_velocity, 0.6 * largest_velocity, 10)
        for exponent in (1.0, 2.0)
    ],
    begun=lambda force, speed: [
        {
            "coulomb_force": 0.7 * share * force,
            "static_force": 1.3 * share * force,
            "stribeck_velocity": slow * speed,
            "stribeck_exponent": 2.0,
        }
        for share in SHARES
        for slow in SLOW
    ],
    refused=no_excess,
)


def mixed(
    sign: Array, velocity: Array, mixed_velocity: float, mixed_root_coefficient: float = 1.0
) -> list[Array]:
    speed = np.abs(velocity)
    film = [sign * np.sqrt(speed)] if mixed_root_coefficient > 0.0 else []
    return [*film, sign / (speed + mixed_velocity)]


def contacts(coefficients: list[float]) -> dict[str, float] | None:
    *root, inverse = coefficients
    if inverse <= 0.0 or min(root, default=0.0) < 0.0:
        return None
    load = NORMAL_LOAD.start
    return {"mixed_root_coefficient": sum(root) / load, "mixed_inverse_coefficient": inverse / load}


#: The paper's model 2: contacts that fall at some speed, with and without a film's part.
MIXED_FRICTION = Effect(
    id="mixed_friction",
    group="dry friction",
    replaces=("coulomb_friction",),
    sized=("mixed_inverse_coefficient",),
    confusable_with=("stribeck_friction", "coulomb_friction"),
    distinguished_by="a wide range of speeds: several amplitudes, from sticking to fast slip",
    acts=mixed,
    solved=contacts,
    tried=lambda: [
        {"mixed_velocity": velocity, **film}
        for velocity in VELOCITIES
        for film in ({}, {"mixed_root_coefficient": 0.0})
    ],
    scanned=("mixed_root_coefficient",),
    begun=lambda force, speed: [
        {
            "mixed_root_coefficient": film * share * force / NORMAL_LOAD.start / math.sqrt(speed),
            "mixed_inverse_coefficient": share * force * slow / NORMAL_LOAD.start,
            "mixed_velocity": slow,
        }
        for share in SHARES
        for slow in CONTACTS
        for film in FILMS
    ],
    refused=lambda mixed_velocity: (
        "the contact part hardly falls with speed: that is Coulomb friction"
        if mixed_velocity > FASTEST
        else ""
    ),
)


@compiled
def dahl_state(displacement: Array, travel: float) -> Array:
    """Return Dahl's state, -1 to 1, along ``displacement`` (m) for the ``travel`` (m) it builds up over."""
    state = np.zeros(displacement.size)
    for index in range(1, displacement.size):
        moved = displacement[index] - displacement[index - 1]
        side = math.copysign(1.0, moved)
        state[index] = side + (state[index - 1] - side) * math.exp(-side * moved / travel)
    return state


def dahl(displacement: Array, travel: float) -> Array:
    return dahl_state(displacement, travel)


def bristles(coefficients: list[float], travel: float) -> dict[str, float] | None:
    (force,) = coefficients
    return {"dahl_force": force, "dahl_stiffness": force / travel} if force > 0.0 else None


#: The jump at a reversal is spread over some travel.
PRESLIDING_FRICTION = Effect(
    id="presliding_friction",
    group="dry friction",
    replaces=("coulomb_friction",),
    sized=("dahl_force",),
    picture="displacement",
    confusable_with=("coulomb_friction", "spring_backlash"),
    distinguished_by="motion with amplitudes of the order of the pre-sliding travel",
    acts=dahl,
    solved=bristles,
    tried=lambda largest_displacement: [
        {"travel": travel} for travel in scan(2e-3 * largest_displacement, 2.0 * largest_displacement, 12)
    ],
    begun=lambda force, travel: [
        {"dahl_force": share * force, "dahl_stiffness": share * force / (part * travel)}
        for share in SHARES
        for part in TRAVELS
    ],
    refused=lambda dahl_force, dahl_stiffness: (
        "it slides after no travel: that is Coulomb friction"
        if dahl_force < SHORTEST * dahl_stiffness
        else ""
    ),
)


@compiled
def slider_state(displacement: Array, slider_play: float, give: float) -> Array:
    """Return the force along ``displacement`` (m) over that of the slider.

    Args:
        displacement: m.
        slider_play: half the play before it, m.
        give: between contact and sliding, m.
    """
    state = np.zeros(displacement.size)
    for index in range(1, displacement.size):
        moved = displacement[index] - displacement[index - 1]
        state[index] = play(state[index - 1], moved, 1.0, slider_play, 1.0 / give)
    return state


def after_play(displacement: Array, slider_play: float, give: float) -> Array:
    return slider_state(displacement, slider_play, give)


def slider(coefficients: list[float], give: float) -> dict[str, float] | None:
    (force,) = coefficients
    return {"slider_force": force, "slider_stiffness": force / give} if force > 0.0 else None


#: After a reversal nothing acts until the play is crossed.
PLAY_FRICTION = Effect(
    id="play_friction",
    group="dry friction",
    kinds=("driven", "imposed"),
    replaces=("coulomb_friction",),
    sized=("slider_force",),
    picture="displacement",
    confusable_with=("presliding_friction", "coulomb_friction", "spring_backlash"),
    distinguished_by="motion with amplitudes from below the play to several times the play",
    acts=after_play,
    solved=slider,
    tried=lambda largest_displacement: [
        {"slider_play": half, "give": give}
        for half in scan(0.02 * largest_displacement, largest_displacement, 8)
        for give in scan(0.01 * largest_displacement, largest_displacement, 5)
    ],
    begun=lambda force, travel: [
        {
            "slider_force": share * force,
            "slider_play": part * travel,
            "slider_stiffness": 10.0 * force / travel,
        }
        for share in SHARES
        for part in TRAVELS
    ],
)

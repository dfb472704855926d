"""Dry friction: Coulomb's law, Stribeck's curve, Dahl's bristles."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term, without

#: Share of the force that acts within play: the force alone tells then where in it the part is.
FAINT = 1e-6


@compiled
def coulomb(coulomb_force: float) -> float:
    return coulomb_force


COULOMB_FRICTION = Term(
    name="coulomb_friction",
    parameters=(
        Parameter(
            "coulomb_force", "N", 0.0, 1e6, 0.5, "friction force while slipping, largest force at rest"
        ),
    ),
    law="F = F_c Sgn(z'), Sgn(0) = [-1, 1]",
    source="set-valued form of Coulomb's law; the constant part of equations (24) to (28)",
    meaning="solid contact of spool and bore: wear, dirt, side load",
    check="cleanliness of the oil, scoring of spool and bore, straightness and side load",
    dissipates=True,
    becomes=without("coulomb_force"),
    sliding_law=coulomb,
)


@compiled
def asymmetric(direction: float, forward_force: float, backward_force: float) -> float:
    return forward_force if direction > 0.0 else backward_force


ASYMMETRIC_FRICTION = Term(
    name="asymmetric_friction",
    parameters=(
        Parameter("forward_force", "N", 0.0, 1e6, 0.6, "friction force while z' > 0"),
        Parameter("backward_force", "N", 0.0, 1e6, 0.4, "friction force while z' < 0"),
    ),
    law="F = F_forward for z' > 0, -F_backward for z' < 0, between them at rest",
    source="Coulomb's law with a force per direction",
    meaning="tilted spool, burr or one-sided seal",
    check="burrs on the edges, tilt, seal lips",
    dissipates=True,
    odd=False,
    becomes=without("forward_force", "backward_force")
    | {
        "coulomb_friction": lambda of: dict.fromkeys(("forward_force", "backward_force"), of["coulomb_force"])
    },
    sliding_law=asymmetric,
)


@compiled
def stribeck(
    speed: float,
    coulomb_force: float,
    static_force: float,
    stribeck_velocity: float,
    stribeck_exponent: float,
) -> float:
    ratio = speed / stribeck_velocity
    # The default exponent costs a tenth of a power.
    power = ratio * ratio if stribeck_exponent == 2.0 else ratio**stribeck_exponent
    return coulomb_force + (static_force - coulomb_force) * math.exp(-power)


STRIBECK_FRICTION = Term(
    name="stribeck_friction",
    parameters=(
        Parameter("coulomb_force", "N", 0.0, 1e6, 0.4, "friction force at high speed"),
        Parameter("static_force", "N", 0.0, 1e6, 0.6, "largest friction force at rest"),
        Parameter("stribeck_velocity", "m/s", 1e-5, 10.0, 0.02, "speed at which 1/e of the excess is left"),
        Parameter("stribeck_exponent", "1", 0.5, 4.0, 2.0, "p: steepness of the fall", held=True),
    ),
    law="F = [F_c + (F_s - F_c) exp(-(abs(z')/v_s)^p)] Sgn(z')",
    source="equation (2) without its viscous part: p = 2 is Gauss's form, p = 1 Tustin's; records seldom "
    "tell p, so a fit holds it unless it is set free",
    meaning="mixed lubrication: the film carries more of the load the faster the spool moves",
    check="surface finish, oil viscosity at running temperature, time at rest under pressure",
    dissipates=True,
    becomes=without("coulomb_force", "static_force")
    | {"coulomb_friction": lambda of: {"static_force": of["coulomb_force"]}},
    sliding_law=stribeck,
)


@compiled
def dahl(force: float, slip: float, direction: float, dahl_force: float, dahl_stiffness: float) -> float:
    limit = direction * dahl_force
    return limit + (force - limit) * math.exp(-dahl_stiffness / dahl_force * direction * slip)


# Within one pre-sliding loop part of the force is elastic, so it gives work back before the loop closes.
PRESLIDING_FRICTION = Term(
    name="presliding_friction",
    parameters=(
        Parameter("dahl_force", "N", 1e-6, 1e6, 0.5, "F_c: friction force after some travel"),
        Parameter("dahl_stiffness", "N/m", 1.0, 1e10, 5e4, "sigma_0: stiffness at the start of a slip"),
    ),
    law="dF/dz = sigma_0 (1 - F/F_c sgn(z'))",
    source="Dahl's law with exponent 1, solved in closed form between reversals",
    meaning="contacts and deposits that give a little before they slide",
    check="varnish on the lands, seals, time at rest",
    memory_law=dahl,
)


@compiled
def play(
    force: float, slip: float, slider_force: float, slider_play: float, slider_stiffness: float
) -> float:
    faint = FAINT * slider_force
    size = abs(force)
    beyond = max(0.0, size - faint) / slider_stiffness
    place = min(size / faint, 1.0) * slider_play + beyond
    place = math.copysign(place, force) + slip
    within = min(abs(place), slider_play)
    beyond = slider_stiffness * (abs(place) - within)
    return math.copysign(min(slider_force, faint * within / slider_play + beyond), place)


PLAY_FRICTION = Term(
    name="play_friction",
    parameters=(
        Parameter("slider_force", "N", 1e-6, 1e6, 0.5, "F_c: friction force of the part behind the play"),
        Parameter("slider_play", "m", 1e-9, 1.0, 1e-4, "b: half the play between the drive and that part"),
        Parameter("slider_stiffness", "N/m", 1.0, 1e10, 5e4, "k: stiffness between contact and sliding"),
    ),
    law="dF/dz = 0 while abs(e) < b, k beyond, 0 where abs(F) = F_c; e = z - the place of the slider",
    source="backlash, spring and Coulomb slider in series; within the play F is up to 1e-6 F_c: it tells e",
    meaning="play between drive and the part that rubs: after a reversal the drive moves, that part not yet",
    check="pins, keys, bands and couplings between the drive and the part that rubs",
    memory_law=play,
)

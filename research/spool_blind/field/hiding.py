"""Hidden physics of a field case: nothing, effects of the catalogue, or a law outside of it.

Sizes are drawn in terms of the motion with nothing hidden, as those of the catalogue's effects are. A law
that happens to be drawn where it is another one says so: see :func:`law_reads_as`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from spool_blind.condition import ExperimentCondition, Scale
from spool_blind.hidden import EFFECTS, NONE, PAIRS, Draw, Generator, Hidden, between

#: Of 12 seeds in a row: so many with nothing hidden, one effect, two effects; the rest a law of no catalogue.
BLOCK, SHARES = 12, (4, 4, 2)
#: Size over that of the clear cases, evenly in its logarithm: nobody looks whether it can be seen.
SIZE = (0.2, 1.5)
#: Share of the drifting viscosities that follow an exponential; its time constant over the record's length.
EXPONENTIAL, WARMING_TIME = 0.5, (0.15, 0.8)

#: LuGre's falling part over its Coulomb force, and its bristles' damping over the critical one, up to which
#: it is Dahl's law: a fit that finds the force to 10 % sees no more.
DAHL_LIKE = 0.1
#: Travel after which all slip elements slide, over the rms of the travel, up to which any law of presliding
#: is the same passage between two constant forces.
SHORT_PASSAGE = 0.05
PRESLIDING = "presliding_friction"


def lugre(generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
    """LuGre's friction: bristles with damping, whose limit falls with speed."""
    coulomb = between(generator, 0.1, 0.35) * scale.force
    static = coulomb * between(generator, 1.0, 2.5)
    stiffness = static / (between(generator, 0.03, 0.15) * scale.travel)
    critical = 2.0 * float(np.sqrt(stiffness * condition.base.numbers["mass"]))
    return Hidden(
        {
            "static_force": static,
            "coulomb_force": coulomb,
            "stribeck_velocity": between(generator, 0.1, 0.5) * scale.velocity,
            "stribeck_exponent": 2.0,
            "bristle_stiffness": stiffness,
            "bristle_damping": between(generator, 0.02, 0.3) * critical,
        },
        size=("static_force", "coulomb_force", "bristle_stiffness", "bristle_damping"),
    )


def maxwell_slip(generator: Generator, _: ExperimentCondition, scale: Scale) -> Hidden:
    """Maxwell's slip: springs in parallel that slide one after the other, so that reversals follow Masing."""
    force = between(generator, 0.12, 0.4) * scale.force
    travel = between(generator, 0.04, 0.6) * scale.travel
    return Hidden({"slip_force": force, "slip_travel": travel}, size=("slip_force",))


def smoothed_preload(generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
    """Preload whose force turns over a part of the travel: seats that are not square, a plate that tilts."""
    force = between(generator, 0.12, 0.35) * condition.base.numbers["stiffness"] * scale.travel
    travel = between(generator, 0.2, 0.8) * scale.travel
    return Hidden({"soft_preload": force, "soft_travel": travel}, size=("soft_preload",))


def one_sided_contact(generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
    """Contact on one side that pushes and never pulls: a seat or rod that the spool leaves (Hunt, Crossley).

    It is about as stiff as the spring: a stop would be ten times that, and on both sides.
    """
    return Hidden(
        {
            "seat_stiffness": between(generator, 0.3, 3.0) * condition.base.numbers["stiffness"],
            "seat_place": between(generator, -0.3, 1.5) * scale.travel,
            "seat_dissipation": between(generator, 0.2, 1.0) / scale.velocity,
        },
        size=("seat_stiffness",),
    )


def flow_force_ripple(generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
    """Flow force beyond the overlap, driven by a pressure that ripples: a spring that comes and goes."""
    return Hidden(
        {
            "flow_stiffness": between(generator, 0.1, 0.5) * condition.base.numbers["stiffness"],
            "flow_overlap": between(generator, 0.2, 1.2) * scale.travel,
            "flow_ripple": between(generator, 0.05, 0.4),
            "flow_frequency": between(generator, 40.0, 230.0),
            "flow_phase": between(generator, 0.0, 6.28),
        },
        size=("flow_stiffness",),
    )


def oil_chamber(generator: Generator, condition: ExperimentCondition, _: Scale) -> Hidden:
    """Oil chamber that leaks: a spring and a dashpot in series, whose force relaxes (Maxwell).

    Its time constant is about the period of the spool's own motion.
    """
    numbers = condition.base.numbers
    turn = float(np.sqrt(numbers["stiffness"] / numbers["mass"]))
    return Hidden(
        {
            "chamber_stiffness": between(generator, 0.1, 0.6) * numbers["stiffness"],
            "chamber_time": between(generator, 0.3, 3.0) / turn,
        },
        size=("chamber_stiffness",),
    )


def spring_surge(generator: Generator, condition: ExperimentCondition, _: Scale) -> Hidden:
    """Surge of the spring: its coils have their own mass and mode, above the spool's."""
    numbers = condition.base.numbers
    mass = between(generator, 0.05, 0.3) * numbers["mass"]
    critical = 2.0 * float(np.sqrt(4.0 * numbers["stiffness"] * mass))
    return Hidden(
        {"surge_mass": mass, "surge_damping": between(generator, 0.005, 0.05) * critical},
        size=("surge_mass", "surge_damping"),
    )


#: Laws that no catalogue lists, by id: each is drawn for a condition and the motion it has without it.
FIELD_LAWS: dict[str, Draw] = {
    "lugre_friction": lugre,
    "maxwell_slip": maxwell_slip,
    "smoothed_preload": smoothed_preload,
    "one_sided_contact": one_sided_contact,
    "flow_force_ripple": flow_force_ripple,
    "oil_chamber": oil_chamber,
    "spring_surge": spring_surge,
}


def law_reads_as(plant: Mapping[str, float], mass: float, travel: float) -> tuple[str, ...]:
    """Return the names that are right alone for a law with the numbers ``plant``.

    That is Dahl's law, where LuGre's limit hardly falls and its bristles are hardly damped, or where all slip
    elements slide after a short passage. ``mass`` (kg) is the spool's, ``travel`` (m) its rms.
    """
    if "slip_travel" in plant:
        return (PRESLIDING,) if plant["slip_travel"] <= SHORT_PASSAGE * travel else ()
    if "bristle_damping" not in plant:
        return ()
    falls = plant["static_force"] / plant["coulomb_force"] - 1.0
    damped = plant["bristle_damping"] / (2.0 * np.sqrt(plant["bristle_stiffness"] * mass))
    return (PRESLIDING,) if max(falls, damped) <= DAHL_LIKE else ()


@dataclass(frozen=True, slots=True)
class HiddenPhysics:
    """Hidden physics as it was drawn.

    Attributes:
        name: "none", an effect's id, two joined by "+", or a law's id.
        parts: each effect or law by its name.
        factor: size over that of the clear cases.
        reads_as: names that are right alone for a law outside of the catalogue.
    """

    name: str
    parts: dict[str, Hidden]
    factor: float
    reads_as: tuple[str, ...] = ()


def field_hidden_by(seed: int) -> str:
    """Return what the field case of ``seed`` hides: any 12 seeds in a row hold the same mixture."""
    none, single, pairs = SHARES
    block, place = divmod(seed, BLOCK)
    if place < none:
        return NONE
    if place < none + single:
        return sorted(EFFECTS)[(block * single + place - none) % len(EFFECTS)]
    if place < none + single + pairs:
        return str(np.random.default_rng([seed, 11]).choice(PAIRS))
    each = BLOCK - none - single - pairs
    return sorted(FIELD_LAWS)[(block * each + place - none - single - pairs) % len(FIELD_LAWS)]


def draw_hidden(
    generator: Generator, name: str, condition: ExperimentCondition, scale: Scale
) -> HiddenPhysics:
    """Draw what ``name`` hides under ``condition``, whose motion with nothing hidden is ``scale``.

    Raises:
        KeyError: ``name`` is none of those that can be hidden.
    """
    factor = float(np.exp(between(generator, *np.log(SIZE))))
    if name in FIELD_LAWS:
        hidden = FIELD_LAWS[name](generator, condition, scale).sized(factor)
        reads_as = law_reads_as(hidden.plant, condition.base.numbers["mass"], scale.travel)
        return HiddenPhysics(name, {name: hidden}, factor, reads_as)
    parts = {}
    for one in [] if name == NONE else name.split("+"):
        hidden = EFFECTS[one].draw(generator, condition, scale).sized(factor)
        parts[one] = warming(generator, hidden, condition) if one == "damping_drift" else hidden
    return HiddenPhysics(name, parts, factor)


def warming(generator: Generator, linear: Hidden, condition: ExperimentCondition) -> Hidden:
    """Return the drift ``linear`` in time, or with the same change over the record along an exponential."""
    exponential = generator.random() < EXPONENTIAL
    constant = between(generator, *WARMING_TIME) * condition.duration
    if not exponential:
        return linear
    change = linear.plant["damping_rate"] * condition.duration
    share = change / (1.0 - float(np.exp(-condition.duration / constant)))
    return replace(
        linear,
        plant={"warming_share": share, "warming_time": constant},
        truth={"damping_drift_rate": share / constant, "damping_drift_time": constant},
        size=("warming_share",),
    )

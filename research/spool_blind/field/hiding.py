"""Hidden physics of a field case: nothing, effects of the catalogue, or a law outside of it.

Sizes are drawn in terms of the motion with nothing hidden, as those of the catalogue's effects are. A law
that happens to be drawn where it is another one says so: see :meth:`FieldLaw.reads_as`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from spool_blind.case import NONE, PAIRS
from spool_blind.condition import ExperimentCondition, Scale
from spool_blind.hidden import EFFECTS, Generator, Hidden, between

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


class FieldLaw(ABC):
    """Law that no catalogue lists.

    Attributes:
        id: its name.
    """

    id: ClassVar[str]

    @abstractmethod
    def draw(self, generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
        """Draw it for a condition and the motion it has without it."""

    def reads_as(self, hidden: Hidden, condition: ExperimentCondition, scale: Scale) -> tuple[str, ...]:  # noqa: ARG002
        """Return the names that are right alone at the numbers that were drawn."""
        return ()


class LuGre(FieldLaw):
    """LuGre's friction: bristles whose limit falls with speed, and a damping of their own."""

    id = "lugre_friction"

    def draw(self, generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
        """Draw static and Coulomb force, bristles and their damping."""
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

    def reads_as(self, hidden: Hidden, condition: ExperimentCondition, scale: Scale) -> tuple[str, ...]:  # noqa: ARG002
        """Return Dahl's law where the limit hardly falls and the bristles are hardly damped."""
        falls = hidden.plant["static_force"] / hidden.plant["coulomb_force"] - 1.0
        critical = 2.0 * np.sqrt(hidden.plant["bristle_stiffness"] * condition.base.numbers["mass"])
        damped = hidden.plant["bristle_damping"] / critical
        return (PRESLIDING,) if max(falls, damped) <= DAHL_LIKE else ()


class MaxwellSlip(FieldLaw):
    """Maxwell's slip: springs in parallel that slide one after the other, so that reversals follow Masing."""

    id = "maxwell_slip"

    def draw(self, generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:  # noqa: ARG002
        """Draw the force at which all slide and the travel to it."""
        force = between(generator, 0.12, 0.4) * scale.force
        travel = between(generator, 0.04, 0.6) * scale.travel
        return Hidden({"slip_force": force, "slip_travel": travel}, size=("slip_force",))

    def reads_as(self, hidden: Hidden, condition: ExperimentCondition, scale: Scale) -> tuple[str, ...]:  # noqa: ARG002
        """Return Dahl's law where all elements slide after a short passage."""
        return (PRESLIDING,) if hidden.plant["slip_travel"] <= SHORT_PASSAGE * scale.travel else ()


class SmoothedPreload(FieldLaw):
    """Preload whose force turns over a part of the travel: seats that are not square, a plate that tilts."""

    id = "smoothed_preload"

    def draw(self, generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
        """Draw the force and the travel over which it turns."""
        force = between(generator, 0.12, 0.35) * condition.base.numbers["stiffness"] * scale.travel
        travel = between(generator, 0.2, 0.8) * scale.travel
        return Hidden({"soft_preload": force, "soft_travel": travel}, size=("soft_preload",))


class OneSidedContact(FieldLaw):
    """Contact on one side that pushes and never pulls: a seat or rod that the spool leaves (Hunt, Crossley).

    It is about as stiff as the spring: a stop would be ten times that, and on both sides.
    """

    id = "one_sided_contact"

    def draw(self, generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
        """Draw where it begins, its stiffness and loss."""
        return Hidden(
            {
                "seat_stiffness": between(generator, 0.3, 3.0) * condition.base.numbers["stiffness"],
                "seat_place": between(generator, -0.3, 1.5) * scale.travel,
                "seat_dissipation": between(generator, 0.2, 1.0) / scale.velocity,
            },
            size=("seat_stiffness",),
        )


class FlowForceRipple(FieldLaw):
    """Flow force beyond the overlap, driven by a pressure that ripples: a spring that comes and goes."""

    id = "flow_force_ripple"

    def draw(self, generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:
        """Draw stiffness, overlap, and size and frequency of the ripple."""
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


class OilChamber(FieldLaw):
    """Oil chamber that leaks: a spring and a dashpot in series, whose force relaxes (Maxwell)."""

    id = "oil_chamber"

    def draw(self, generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:  # noqa: ARG002
        """Draw stiffness and time constant: about the period of the spool's own motion."""
        numbers = condition.base.numbers
        turn = float(np.sqrt(numbers["stiffness"] / numbers["mass"]))
        return Hidden(
            {
                "chamber_stiffness": between(generator, 0.1, 0.6) * numbers["stiffness"],
                "chamber_time": between(generator, 0.3, 3.0) / turn,
            },
            size=("chamber_stiffness",),
        )


class SpringSurge(FieldLaw):
    """Surge of the spring: its coils have a mass and a mode of their own, above the spool's."""

    id = "spring_surge"

    def draw(self, generator: Generator, condition: ExperimentCondition, scale: Scale) -> Hidden:  # noqa: ARG002
        """Draw the mass of the coils and their drag."""
        numbers = condition.base.numbers
        mass = between(generator, 0.05, 0.3) * numbers["mass"]
        critical = 2.0 * float(np.sqrt(4.0 * numbers["stiffness"] * mass))
        return Hidden(
            {"surge_mass": mass, "surge_damping": between(generator, 0.005, 0.05) * critical},
            size=("surge_mass", "surge_damping"),
        )


FIELD_LAWS: dict[str, FieldLaw] = {
    law.id: law
    for law in (
        LuGre(), MaxwellSlip(), SmoothedPreload(), OneSidedContact(), FlowForceRipple(), OilChamber(),
        SpringSurge(),
    )
}  # fmt: skip


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
        law = FIELD_LAWS[name]
        hidden = law.draw(generator, condition, scale).sized(factor)
        return HiddenPhysics(name, {name: hidden}, factor, law.reads_as(hidden, condition, scale))
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

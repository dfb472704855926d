"""Friction laws of the paper; where its print contradicts itself, as corrected."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled
from spool_core.numbers import GRAVITY

from spool_sim.terms.base import Parameter, Term, without

NORMAL_LOAD = Parameter(
    "normal_load",
    "N",
    0.0,
    1e6,
    1.687,
    "N: the spool's weight unless known better",
    "likely_spool_mass",
    GRAVITY,
)


@compiled
def adhesion_viscous(v: float, adhesion_drag: float) -> float:
    return adhesion_drag * v


@compiled
def adhesion(speed: float, adhesion_dry_force: float, adhesion_force: float, adhesion_decay: float) -> float:
    return adhesion_dry_force + adhesion_force * math.exp(-adhesion_decay * speed)


ADHESION_FRICTION = Term(
    name="adhesion_friction",
    parameters=(
        Parameter("adhesion_drag", "N s/m", 0.0, 1e6, 2.0, "b: fluid friction F_Tp over velocity"),
        Parameter("adhesion_dry_force", "N", 0.0, 1e6, 0.4, "F_Ts: dry friction"),
        Parameter("adhesion_force", "N", 0.0, 1e6, 0.2, "F_pmax: largest adhesion force"),
        Parameter("adhesion_decay", "s/m", 0.0, 1e5, 50.0, "sigma: decay of the adhesion"),
    ),
    law="F = b z' + [F_Ts + F_pmax exp(-sigma abs(z'))] Sgn(z')",
    source="equation (8)",
    meaning="spool that sticks to the bore through varnish or after a rest",
    check="varnish and ageing products on the lands, oil age",
    dissipates=True,
    force_law=adhesion_viscous,
    sliding_law=adhesion,
)


@compiled
def film(v: float, film_coefficient: float, film_drag: float) -> float:
    return -film_coefficient * film_drag * v


@compiled
def dry_contact(dry_coefficient: float, normal_load: float) -> float:
    return dry_coefficient * normal_load


COULOMB_HYDRODYNAMIC_FRICTION = Term(
    name="coulomb_hydrodynamic_friction",
    parameters=(
        Parameter("dry_coefficient", "1", 0.0, 10.0, 0.1, "mu_0: dry friction coefficient"),
        Parameter(
            "film_coefficient", "1", -100.0, 1.0, 0.0,
            "K_V: geometry of the contact; > 0 lowers friction with speed",
        ),
        Parameter(
            "film_drag", "N s/m", 0.0, 1e6, 8.2, "mu A_t / h: drag of the film", "likely_viscous_coefficient"
        ),
        NORMAL_LOAD,
    ),
    law="F = mu_0 N Sgn(z') - K_V (mu A_t / h) z'",
    source="equations (24) to (28a), model 3, with p = N / A_t. (28b) lost the division by p. K_V > 0 is "
    "negative damping, so it dissipates only with the drag of (12) and K_V <= 1; both signs occur in Table 5",
    meaning="load shared between solid contact and oil film",
    check="side load, oil viscosity, scoring",
    dissipates=True,
    dissipates_with="viscous_friction",
    becomes=without("dry_coefficient", "film_coefficient")
    | {
        "coulomb_friction": lambda of: {
            "dry_coefficient": of["coulomb_force"] / max(of["normal_load"], 1e-9), "film_coefficient": 0.0,
        }
    },
    force_law=film,
    sliding_law=dry_contact,
)  # fmt: skip


@compiled
def detachment_viscous(v: float, detachment_drag: float) -> float:
    return detachment_drag * v


@compiled
def detachment(
    speed: float, detachment_force: float, detachment_velocity: float, detachment_dry_force: float
) -> float:
    left = max(0.0, 1.0 - speed / detachment_velocity)
    return detachment_force * left**4 + detachment_dry_force


DETACHMENT_FRICTION = Term(
    name="detachment_friction",
    parameters=(
        Parameter("detachment_force", "N", 0.0, 1e6, 0.2, "F_od: force to detach, at speed 0"),
        Parameter("detachment_velocity", "m/s", 1e-5, 10.0, 0.05, "v_p: start of semi-fluid friction"),
        Parameter("detachment_drag", "N s/m", 0.0, 1e6, 2.0, "b: viscous part"),
        Parameter("detachment_dry_force", "N", 0.0, 1e6, 0.4, "F_Ts: dry friction"),
    ),
    law="F = b z' + [F_od max(0, 1 - abs(z')/v_p)^4 + F_Ts] Sgn(z')",
    source="equation (9); printed with b abs(v) and F_od without sign, which would push for v < 0, and "
    "without the limit at v_p",
    meaning="a seat or a deposit that has to be torn off before the spool moves",
    check="deposits, time at rest under pressure",
    dissipates=True,
    force_law=detachment_viscous,
    sliding_law=detachment,
)


@compiled
def hess_soom_viscous(v: float, hess_soom_drag: float) -> float:
    return hess_soom_drag * v


@compiled
def hess_soom(
    speed: float, hess_soom_minimum: float, hess_soom_static: float, hess_soom_velocity: float
) -> float:
    ratio = speed / hess_soom_velocity
    return hess_soom_minimum + (hess_soom_static - hess_soom_minimum) / (1.0 + ratio * ratio)


HESS_SOOM_FRICTION = Term(
    name="hess_soom_friction",
    parameters=(
        Parameter("hess_soom_drag", "N s/m", 0.0, 1e6, 2.0, "viscous part b"),
        Parameter(
            "hess_soom_minimum", "N", 0.0, 1e6, 0.4, "F_min,k: friction at the minimum of the Stribeck curve"
        ),
        Parameter("hess_soom_static", "N", 0.0, 1e6, 0.6, "F_s: static friction"),
        Parameter(
            "hess_soom_velocity", "m/s", 1e-5, 10.0, 0.02, "v_s: speed at which half of the excess is left"
        ),
    ),
    law="F = b z' + [F_min,k + (F_s - F_min,k) / (1 + (z'/v_s)^2)] Sgn(z')",
    source="equation (1); the print leaves sgn(v) off the third term, which then pushes",
    meaning="mixed lubrication of a hydraulic drive",
    check="surface finish, viscosity, time at rest",
    dissipates=True,
    force_law=hess_soom_viscous,
    sliding_law=hess_soom,
)


@compiled
def microwedge() -> float:
    return 0.0


@compiled
def microwedge_at_rest(
    contact_proportionality: float, microwedge_length: float, microwedge_overlap: float
) -> tuple[float, float]:
    bound = contact_proportionality * max(0.0, microwedge_length - microwedge_overlap)
    return -bound, bound


MICROWEDGE_FRICTION = Term(
    name="microwedge_friction",
    parameters=(
        Parameter(
            "contact_proportionality", "N/m", 0.0, 1e8, 100.0,
            "k_t = C_k mu_s: static friction over contact strain",
        ),
        Parameter("microwedge_length", "m", 0.0, 1.0, 0.0057, "d_k0, a dimension of the microwedge"),
        Parameter("microwedge_overlap", "m", 0.0, 1.0, 0.0036, "a_k0, a dimension of the microwedge"),
    ),
    law="abs(F) <= k_t (d_k0 - a_k0) at rest, 0 while slipping",
    source="equations (13) to (16), model 1. Printed without a sign: a constant push at rest; here what a "
    "static friction does",
    meaning="roughness peaks of spool and bore that interlock at rest",
    check="surface finish and scoring",
    dissipates=True,
    becomes=without("contact_proportionality"),
    sliding_law=microwedge,
    rest_law=microwedge_at_rest,
)  # fmt: skip


@compiled
def mixed(
    speed: float,
    mixed_root_coefficient: float,
    mixed_inverse_coefficient: float,
    mixed_velocity: float,
    normal_load: float,
) -> float:
    contact = mixed_inverse_coefficient / (speed + mixed_velocity)
    return (mixed_root_coefficient * math.sqrt(speed) + contact) * normal_load


MIXED_FRICTION = Term(
    name="mixed_friction",
    parameters=(
        Parameter("mixed_root_coefficient", "sqrt(s/m)", 0.0, 100.0, 0.1, "C1: drag part"),
        Parameter("mixed_inverse_coefficient", "m/s", 0.0, 100.0, 0.003, "C2: contact part"),
        Parameter("mixed_velocity", "m/s", 1e-4, 1.0, 0.01, "gamma_m: keeps the force at rest finite"),
        NORMAL_LOAD,
    ),
    law="F = [C1 sqrt(abs(z')) + C2 / (abs(z') + gamma_m)] N Sgn(z')",
    source="equations (19) to (23), model 2. (23) is the one used; (20) and (22) are infinite at rest and "
    "cannot run. C2 is in m/s, not s/m: C2/v has no dimension. The values of Table 4 take up to 1687 "
    "N at rest: they lock the spool",
    meaning="boundary contacts of spool and bore with oil between them",
    check="oil cleanliness and viscosity, scoring, side load",
    dissipates=True,
    becomes=without("mixed_root_coefficient", "mixed_inverse_coefficient"),
    sliding_law=mixed,
)


@compiled
def pavelescu_viscous(v: float, pavelescu_drag: float) -> float:
    return pavelescu_drag * v


@compiled
def pavelescu(
    speed: float,
    pavelescu_minimum: float,
    pavelescu_static: float,
    pavelescu_velocity: float,
    pavelescu_exponent: float,
) -> float:
    excess = pavelescu_static - pavelescu_minimum
    return pavelescu_minimum + excess * math.exp(-((speed / pavelescu_velocity) ** pavelescu_exponent))


PAVELESCU_FRICTION = Term(
    name="pavelescu_friction",
    parameters=(
        Parameter("pavelescu_drag", "N s/m", 0.0, 1e6, 2.0, "viscous part b"),
        Parameter(
            "pavelescu_minimum", "N", 0.0, 1e6, 0.4, "F_min,k: friction at the minimum of the Stribeck curve"
        ),
        Parameter("pavelescu_static", "N", 0.0, 1e6, 0.6, "F_sp: static friction"),
        Parameter(
            "pavelescu_velocity", "m/s", 1e-5, 10.0, 0.02, "v_s: speed at which 1/e of the excess is left"
        ),
        Parameter("pavelescu_exponent", "1", 1.0, 10.0, 2.0, "p (beta in the text), from experiment"),
    ),
    law="F = b z' + [F_min,k + (F_sp - F_min,k) exp(-(abs(z')/v_s)^p)] Sgn(z')",
    source="equation (2); the print leaves sgn(v) off the third term, which then pushes. The text calls the "
    "exponent beta",
    meaning="mixed lubrication, with its own steepness of the fall",
    check="surface finish, viscosity, time at rest",
    dissipates=True,
    force_law=pavelescu_viscous,
    sliding_law=pavelescu,
)


@compiled
def rubber_ring(
    v: float,
    seal_diameter: float,
    seal_width: float,
    seal_correction: float,
    seal_viscosity: float,
    seal_film: float,
) -> float:
    area = math.pi * seal_diameter * seal_width
    return area * seal_correction * seal_viscosity / seal_film * v


@compiled
def retaining_ring(
    seal_diameter: float, retainer_width: float, retainer_friction: float, seal_pressure: float
) -> float:
    return math.pi * seal_diameter * retainer_width * retainer_friction * seal_pressure


SEAL_FRICTION = Term(
    name="seal_friction",
    parameters=(
        Parameter("seal_diameter", "m", 1e-4, 1.0, 0.02, "D_p: inner diameter of the ring", "land_diameter"),
        Parameter("seal_width", "m", 0.0, 0.1, 0.002, "l_u: sealing width of the rubber ring"),
        Parameter("seal_correction", "1", 0.0, 100.0, 1.0, "c_p: correction factor"),
        Parameter("seal_viscosity", "Pa s", 0.0, 100.0, 0.0612, "mu of the oil", "dynamic_viscosity"),
        Parameter("seal_film", "m", 1e-8, 1e-3, 1e-6, "h_0: film under the seal"),
        Parameter("retainer_width", "m", 0.0, 0.1, 0.001, "l_u1: width of the retaining ring, 0 for none"),
        Parameter(
            "retainer_friction", "1", 0.0, 2.0, 0.05, "f_t1: friction coefficient of the retaining ring"
        ),
        Parameter("seal_pressure", "Pa", 0.0, 1e8, 1e5, "p: pressure at the seal"),
    ),
    law="F = pi D l_u c_p mu z' / h_0 + pi D l_u1 f_t1 p Sgn(z')",
    source="equation (17) with (18) put in, where the contact pressure N_k drops out; sgn(v) on the second "
    "part, which the print leaves to the reader",
    meaning="O-rings and their retaining rings, where the spool has any",
    check="seal swelling, wear and fit",
    dissipates=True,
    force_law=rubber_ring,
    sliding_law=retaining_ring,
)


@compiled
def tustin_viscous(v: float, tustin_drag: float) -> float:
    return tustin_drag * v


@compiled
def tustin(speed: float, tustin_kinetic: float, tustin_excess: float, tustin_velocity: float) -> float:
    return tustin_kinetic + tustin_excess * math.exp(-speed / tustin_velocity)


TUSTIN_FRICTION = Term(
    name="tustin_friction",
    parameters=(
        Parameter("tustin_drag", "N s/m", 0.0, 1e6, 2.0, "viscous part b"),
        Parameter("tustin_kinetic", "N", 0.0, 1e6, 0.4, "F_min,k: kinetic friction"),
        Parameter("tustin_excess", "N", 0.0, 1e6, 0.2, "F_sk: static minus kinetic friction"),
        Parameter("tustin_velocity", "m/s", 1e-5, 10.0, 0.02, "v_k: transition to kinetic friction"),
    ),
    law="F = b z' + [F_min,k + F_sk exp(-abs(z')/v_k)] Sgn(z')",
    source="equation (3); printed without sgn(v) on the third term and with v for abs(v): that pushes, and "
    "grows without limit for v < 0, so it is not offered",
    meaning="mixed lubrication",
    check="surface finish, viscosity, time at rest",
    dissipates=True,
    force_law=tustin_viscous,
    sliding_law=tustin,
)

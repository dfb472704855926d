"""Laws of the paper to the letter where its print errs, to compare with those of :mod:`spool_sim.terms`."""

from __future__ import annotations

import math
from dataclasses import replace

from spool_core.kernels.compiled import compiled
from spool_sim.terms import Parameter, term


@compiled
def _film(v: float, film_coefficient: float, film_drag_per_area: float, normal_load: float) -> float:
    return -film_coefficient * film_drag_per_area * normal_load * v


@compiled
def _detachment(
    v: float, detachment_force: float, detachment_velocity: float, detachment_drag: float
) -> float:
    left = max(0.0, 1.0 - abs(v) / detachment_velocity)
    return detachment_force * left**4 + detachment_drag * abs(v)


@compiled
def _detachment_dry(detachment_dry_force: float) -> float:
    return detachment_dry_force


@compiled
def _hess_soom(
    v: float,
    hess_soom_drag: float,
    hess_soom_minimum: float,
    hess_soom_static: float,
    hess_soom_velocity: float,
) -> float:
    ratio = v / hess_soom_velocity
    return hess_soom_drag * v + (hess_soom_static - hess_soom_minimum) / (1.0 + ratio * ratio)


@compiled
def _hess_soom_dry(hess_soom_minimum: float) -> float:
    return hess_soom_minimum


@compiled
def _microwedge(
    v: float, contact_proportionality: float, microwedge_length: float, microwedge_overlap: float,
    delta_exponent: float, delta_power: float,
) -> float:  # fmt: skip
    delta = 1.0 / (1.0 + math.pow(10.0, delta_exponent) * math.pow(abs(v), delta_power))
    return contact_proportionality * (microwedge_length - microwedge_overlap) * delta


@compiled
def _pavelescu(
    v: float, pavelescu_drag: float, pavelescu_minimum: float, pavelescu_static: float,
    pavelescu_velocity: float, pavelescu_exponent: float,
) -> float:  # fmt: skip
    excess = pavelescu_static - pavelescu_minimum
    return pavelescu_drag * v + excess * math.exp(-((abs(v) / pavelescu_velocity) ** pavelescu_exponent))


@compiled
def _pavelescu_dry(pavelescu_minimum: float) -> float:
    return pavelescu_minimum


_HYDRODYNAMIC, _MICROWEDGE = term("coulomb_hydrodynamic_friction"), term("microwedge_friction")
#: By the name of the corrected law.
PRINTED = {
    entry.name: replace(entry, name=f"{entry.name}_printed", dissipates=False)
    for entry in (
        replace(
            _HYDRODYNAMIC, force_law=_film, law="F = mu_0 N Sgn(z') - K_V (mu / h) N z'",
            source="equation (28b): K_V would have to be an area over a force",
            parameters=(
                *_HYDRODYNAMIC.parameters[:2],
                Parameter("film_drag_per_area", "N s/m^3", 0.0, 1e9, 4080.0, "mu / h: drag over its area"),
                _HYDRODYNAMIC.parameters[3],
            ),
        ),
        replace(
            term("detachment_friction"), odd=False, force_law=_detachment, sliding_law=_detachment_dry,
            law="F = F_od max(0, 1 - abs(z')/v_p)^4 + b abs(z') + F_Ts Sgn(z')",
            source="equation (9) below v_p; above it the bracket counts as 0",
        ),
        replace(
            term("hess_soom_friction"), odd=False, force_law=_hess_soom, sliding_law=_hess_soom_dry,
            law="F = b z' + F_min,k Sgn(z') + (F_s - F_min,k) / (1 + (z'/v_s)^2)",
            source="equation (1): the third term pushes one way whatever the motion",
        ),
        replace(
            _MICROWEDGE, odd=False, force_law=_microwedge, sliding_law=None, rest_law=None,
            law="F = k_t (d_k0 - a_k0) / (1 + 10^theta abs(z')^t)",
            source="equations (13) and (16): a constant push while at rest",
            parameters=(
                *_MICROWEDGE.parameters,
                Parameter("delta_exponent", "1", 0.0, 12.0, 6.0, "theta: 10^theta in (16)"),
                Parameter("delta_power", "1", 2.0, 20.0, 2.0, "t: even power of the velocity in (16)"),
            ),
        ),
        replace(
            term("pavelescu_friction"), odd=False, force_law=_pavelescu, sliding_law=_pavelescu_dry,
            law="F = b z' + F_min,k Sgn(z') + (F_sp - F_min,k) exp(-(abs(z')/v_s)^p)",
            source="equation (2), but for abs(v) in the power, undefined otherwise",
        ),
    )
}  # fmt: skip

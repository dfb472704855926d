"""Mean error of an estimate at one operating point, which no averaging removes.

Two sources remain where the estimator's model holds (`./spool study operation-fit`): a bias of about the
reported standard deviation, and the gain error between both accelerometers. A gain error moves the parameters
by an amount that depends on damping and on how far the spool moves; it cancels as long as these stay.
"""

from __future__ import annotations

import math

from spool_estimator.estimate import Estimate

#: Gain error between two accelerometers of one make, standard deviation, relative: calibrated to 1 to 2 %.
GAIN_ERROR = 0.012

#: Bias over the reported standard deviation: 95 % of 300 operating points are within 1.2, the largest is 2.5.
BIAS = 0.8

#: Sensitivities to the gain error, regression over 300 operating points. Terms of the stiffness: 1, ratio**2,
#: motion, ratio motion, ratio**2 motion; of the drag: 1, 1/ratio, motion/ratio, motion; ratio: of damping.
_STIFFNESS = (1.15, 5.81, -0.99, 2.56, -9.78)
_VISCOUS = (0.87, -0.108, 0.033, -1.74)

#: Standard deviation of sensitivities over all operating points, where that is all that is known; of the dry
#: friction, over the rms inertia force of the body.
ALL = {"spring_stiffness": 0.95, "viscous_coefficient": 1.60}
DRY = 0.4

#: Damping ratios and motions that the regression was made over.
_RATIOS, _MOTIONS = (0.02, 1.1), (0.18, 2.5)


def gain_sensitivity(parameter: str, estimate: Estimate) -> float:
    """Return the relative change of ``parameter`` over the gain error; NaN where it is not known."""
    known = estimate.damping_ratio.known and estimate.natural_frequency.known
    if parameter not in ALL or not known or not estimate.excitation.value > 0.0:
        return math.nan
    ratio = min(_RATIOS[1], max(_RATIOS[0], estimate.damping_ratio.value))
    omega = 2.0 * math.pi * estimate.natural_frequency.value
    motion = estimate.relative_displacement.value * omega**2 / estimate.excitation.value
    motion = min(_MOTIONS[1], max(_MOTIONS[0], motion))
    if parameter == "spring_stiffness":
        a, b, c, d, e = _STIFFNESS
        return a + b * ratio**2 + c * motion + d * ratio * motion + e * ratio**2 * motion
    a, b, c, d = _VISCOUS
    return a + b / ratio + c * motion / ratio + d * motion


def _around(parameter: str, estimate: Estimate) -> float:
    """Return the standard deviation of a sensitivity around the regression; damping shows the drag."""
    ratio = min(_RATIOS[1], max(_RATIOS[0], estimate.damping_ratio.value))
    if parameter == "spring_stiffness":
        return 0.5 + 1.6 * ratio + 3.5 * ratio**2
    return 0.25 + 0.08 / ratio


def systematic_error(parameter: str, estimate: Estimate, healthy: float, value: float) -> float:
    """Return the standard deviation of the mean error of a change since the start value was learned.

    Args:
        parameter: its name.
        estimate: the one that is compared.
        healthy: sensitivity to the gain error when the start value was learned; NaN where not known.
        value: of the parameter as it is compared; the result has its unit.
    """
    raw = estimate.parameter(parameter)
    bias = BIAS * raw.standard_deviation * (abs(value / raw.value) if raw.value else 1.0)
    if parameter in ALL:
        moved = gain_sensitivity(parameter, estimate) - healthy
        known = not math.isnan(moved)
        sensitivity = math.hypot(moved, _around(parameter, estimate)) if known else ALL[parameter]
        return math.hypot(bias, GAIN_ERROR * sensitivity * value)
    stiffness, natural = estimate.parameter("spring_stiffness"), estimate.natural_frequency.value
    mass = stiffness.value / (2.0 * math.pi * natural) ** 2 if natural > 0.0 else math.nan
    force = mass * estimate.excitation.value
    return math.hypot(bias, GAIN_ERROR * DRY * force) if math.isfinite(force) else bias

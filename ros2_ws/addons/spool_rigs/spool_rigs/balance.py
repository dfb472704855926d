"""Balance of forces of a force record: which force is missing at the measured motion.

imposed:  force = c z' + k z + effects + zero of the load cell
driven:   force = m z'' + c z' + k z + effects + zero of the load cell

The acceleration of a driven mass is the displacement's second derivative, which needs a low-pass. It goes
over force and columns alike: a jump of dry friction smeared on one side only would look like a gap.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import binary_dilation, binary_opening
from scipy.optimize import minimize, minimize_scalar
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import percent
from spool_gap.effect import Effect, Motion

from spool_rigs.records import ForceRecord, white_power

#: Deviations of its noise below which a velocity counts as none.
STILL = 4.0
#: Powers of 2 that a number which shapes a law is moved by, and to what: around what was scanned, then finer
#: than its interval.
COARSE, FINE = (1.2, 0.02), (0.06, 2e-4)
#: A signal must exceed its noise by this factor, rms.
EXCITED = 1.5
#: m that parts of a valve or a rig hardly move, and m that none moves; m/s and m/s^2, rms, that none reaches.
LONG, TOO_LONG, TOO_FAST, TOO_HARD = 0.5, 2.0, 20.0, 5e3
#: Mass that fits over the one that the valve's description gives, or the other way round.
OTHER_MASS = 1.5
#: Numbers of the base's columns, with their units.
BASE_NAMES = {
    "damping": ("viscous_coefficient", "N s/m"),
    "stiffness": ("spring_stiffness", "N/m"),
    "mass": ("mass", "kg"),
    "zero": ("force_zero", "N"),
}


def correlation_of(covariance: Array) -> Array:
    """Return the correlation that belongs to ``covariance``, same shape; 0 where a variance is."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = np.where(spread > 0.0, spread, 1.0)
    return np.asarray(covariance / np.outer(scale, scale))


@dataclass(frozen=True, slots=True)
class ForceFit:
    """A fitted set of effects.

    Attributes:
        effects: ids.
        shapes: the numbers in which the force is not linear, of each effect.
        names: of the linear columns, base first.
        coefficients: in N over the column's unit.
        deviations: their standard deviations.
        train, held: measured - model of each record, N.
        squares: of the training part, N^2.
        correlation: of the coefficients, shape (p, p); empty where it is not known.
    """

    effects: tuple[str, ...]
    shapes: tuple[dict[str, float], ...]
    names: tuple[str, ...]
    coefficients: Array
    deviations: Array
    train: tuple[Array, ...]
    held: tuple[Array, ...]
    squares: float
    correlation: Array = field(default_factory=lambda: np.empty((0, 0)))


class ForceBalance:
    """The regression over training records, judged on held-out ones."""

    def __init__(
        self,
        train: Sequence[ForceRecord],
        held: Sequence[ForceRecord],
        base: Sequence[str],
        *,
        driven: bool = False,
        mass: float | None = None,
    ) -> None:
        """Take velocities; ``base`` names the columns out of mass, stiffness, damping, zero.

        ``driven``: the force moves a mass, of ``mass`` kg where that is known.
        """
        self.train, self.held = tuple(train), tuple(held)
        self.base = tuple(base)
        self.driven, self.mass = driven, mass
        # The middle of the motion, m; 0 where the rig's own zero lies near it.
        low = min(float(record.displacement.min()) for record in train)
        high = max(float(record.displacement.max()) for record in train)
        middle = 0.5 * (low + high)
        self.centre = 0.0 if abs(middle) < 0.2 * (high - low) else middle
        self.motions = {id(r): _motion(r, self.centre, driven=driven) for r in (*train, *held)}
        self.known = {id(r): _known(r, self.motions[id(r)]) for r in (*train, *held)} if driven else {}
        # The reaction to friction has the velocity's sign; a rig may count it the other way round.
        power = sum(
            float(np.sum((r.force - r.force.mean()) * self.motions[id(r)].velocity)) for r in self.train
        )
        self.sign = -1.0 if power < 0.0 else 1.0

    def columns(self, record: ForceRecord, chosen: Sequence[tuple[Effect, dict[str, float]]]) -> Array:
        """Return the columns of base and effects, shape (n, q)."""
        motion = self.motions[id(record)]
        rows = {
            "mass": motion.acceleration,
            "damping": motion.velocity,
            "stiffness": motion.displacement,
            "zero": np.ones(motion.time.size),
        }
        found = [rows[name] for name in self.base]
        for effect, shape in chosen:
            signature = list(effect.signature(motion, shape))
            signature = [record.low_passed(row) for row in signature] if self.driven else signature
            if effect.changes in self.base:
                place = self.base.index(effect.changes)
                found[place] = found[place] + signature.pop()
            found += signature
        return np.array(found).T * self.known[id(record)][:, np.newaxis] if self.driven else np.array(found).T

    def target(self, record: ForceRecord) -> Array:
        """Return the force that base and effects explain, in the velocity's sign, N, shape (n,)."""
        if not self.driven:
            return self.sign * record.force
        inertia = (self.mass or 0.0) * self.motions[id(record)].acceleration
        return (self.sign * record.low_passed(record.force) - inertia) * self.known[id(record)]

    def fit(self, chosen: Sequence[tuple[Effect, dict[str, float]]]) -> ForceFit:
        """Return the least-squares fit of ``chosen`` jointly with the base."""
        matrices = [self.columns(record, chosen) for record in self.train]
        matrix = np.concatenate(matrices)
        target = np.concatenate([self.target(record) for record in self.train])
        scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-30)
        solution, _, _, _ = np.linalg.lstsq(matrix / scale, target, rcond=1e-9)
        coefficients = solution / scale
        train = tuple(
            self.target(record) - part @ coefficients
            for record, part in zip(self.train, matrices, strict=True)
        )
        held = tuple(
            self.target(record) - self.columns(record, chosen) @ coefficients for record in self.held
        )
        squares = float(sum(np.sum(row**2) for row in train))
        independent = max(8.0, sum(independent_samples(row) for row in train))
        covariance = np.linalg.pinv((matrix / scale).T @ (matrix / scale)) * squares / independent
        names = (*self.base, *(f"{e.id}.{n}" for e, shape in chosen for n in range(self._own(e, shape))))
        return ForceFit(
            tuple(e.id for e, _ in chosen), tuple(s for _, s in chosen), names, coefficients,
            np.sqrt(np.maximum(np.diag(covariance), 0.0)) / scale, train, held, squares,
            correlation_of(covariance),
        )  # fmt: skip

    def shape_deviation(
        self, chosen: Sequence[tuple[Effect, dict[str, float]]], fit: ForceFit, place: int, name: str
    ) -> float:
        """Return the standard deviation of the number ``name`` that shapes the effect at ``place``."""
        entry, shape = chosen[place]
        step = 1e-3 * shape[name]
        moved = [*chosen[:place], (entry, {**shape, name: shape[name] + step}), *chosen[place + 1 :]]
        near, beside = (
            np.concatenate([self.columns(record, own) for record in self.train]) for own in (chosen, moved)
        )
        matrix = np.column_stack([near, (beside - near) @ fit.coefficients / step])
        scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-30)
        independent = max(8.0, sum(independent_samples(row) for row in fit.train))
        covariance = np.linalg.pinv((matrix / scale).T @ (matrix / scale)) * fit.squares / independent
        return float(np.sqrt(max(covariance[-1, -1], 0.0)) / scale[-1])

    def measured(self, fit: ForceFit, chosen: Sequence[tuple[Effect, dict[str, float]]]) -> ForceFit:
        """Return ``fit`` with what its coefficients leave of the force."""
        train, held = (
            tuple(self.target(r) - self.columns(r, chosen) @ fit.coefficients for r in records)
            for records in (self.train, self.held)
        )
        return replace(fit, train=train, held=held, squares=float(sum(np.sum(row**2) for row in train)))

    def best_shape(
        self, effect: Effect, chosen: Sequence[tuple[Effect, dict[str, float]]]
    ) -> dict[str, float] | None:
        """Return the shape of ``effect`` that leaves least jointly with ``chosen``, scanned, then refined."""
        motion = self.motions[id(max(self.train, key=lambda r: r.force.size))]
        shapes = [dict(shape) for shape in effect.shapes(motion)]
        shapes = [shape for shape in shapes if self.plausible(effect, chosen, shape)]
        if not shapes:
            return None
        sums = [self.fit([*chosen, (effect, shape)]).squares for shape in shapes]
        best = shapes[int(np.argmin(sums))]
        free = [name for name in best if name not in effect.scanned]

        def moved(powers: Sequence[float]) -> dict[str, float]:
            return {
                **best,
                **{name: best[name] * 2.0**power for name, power in zip(free, powers, strict=True)},
            }

        def left(powers: Sequence[float]) -> float:
            return self.fit([*chosen, (effect, moved(powers))]).squares

        for reach, tolerance in (COARSE, FINE):
            for place in range(len(free)):
                others = [0.0] * place, [0.0] * (len(free) - place - 1)
                found = minimize_scalar(
                    lambda power, others=others: left([*others[0], power, *others[1]]),
                    bounds=(-reach, reach), method="bounded", options={"xatol": tolerance},
                )  # fmt: skip
                if found.fun < left([0.0] * len(free)):
                    best = moved([*others[0], float(found.x), *others[1]])
        if len(free) > 1:
            # Numbers that compensate for each other, as play and give, are found together.
            found = minimize(
                left, np.zeros(len(free)), method="Nelder-Mead",
                bounds=[(-COARSE[0], COARSE[0])] * len(free), options={"xatol": FINE[1], "fatol": 0.0},
            )  # fmt: skip
            best = moved(found.x.tolist())
        return best if self.plausible(effect, chosen, best) else None

    def plausible(
        self, effect: Effect, chosen: Sequence[tuple[Effect, dict[str, float]]], shape: dict[str, float]
    ) -> bool:
        """Whether the fitted coefficients of ``effect`` make sense on a machine."""
        fit = self.fit([*chosen, (effect, shape)])
        return self.values(effect, shape, fit) is not None

    def _own(self, effect: Effect, shape: dict[str, float]) -> int:
        """Return how many columns ``effect`` has besides those of the base."""
        rows = effect.signature(self.motions[id(self.train[0])], shape).shape[0]
        return int(rows - (effect.changes in self.base))

    def values(self, effect: Effect, shape: dict[str, float], fit: ForceFit) -> dict[str, float] | None:
        """Return the effect's parameters."""
        own = [n for n, name in enumerate(fit.names) if name.startswith(f"{effect.id}.")]
        base = dict(zip(self.base, fit.coefficients[: len(self.base)].tolist(), strict=True))
        first = next(iter(self.motions.values()))
        motion = Motion(
            first.displacement, first.velocity, first.acceleration, first.time, first.period,
            first.velocity_noise, base.get("mass", self.mass or 0.0), base.get("stiffness", 0.0),
            base.get("damping", 0.0),
        )  # fmt: skip
        return effect.values(fit.coefficients[own], shape, motion)

    def nrmse(self, fit: ForceFit) -> float:
        """Return rms(model - measured) / rms(measured) held out; the load cell's zero is taken off."""
        zero = self.sign * fit.coefficients[self.base.index("zero")] if "zero" in self.base else 0.0
        error = sum(float(np.sum(row**2)) for row in fit.held)
        return float(np.sqrt(error / sum(float(np.sum((self.seen(r) - zero) ** 2)) for r in self.held)))

    def sliding_error(self, fit: ForceFit) -> float:
        """Return :meth:`nrmse` of the samples farther from a reversal than the low-pass reaches.

        A step of friction at a reversal is smeared by the derivatives, whichever law makes it.
        """
        error = power = 0.0
        zero = self.sign * fit.coefficients[self.base.index("zero")] if "zero" in self.base else 0.0
        for record, row in zip(self.held, fit.held, strict=True):
            reversal = np.diff(self.motions[id(record)].velocity > 0.0, prepend=False)
            slides = ~binary_dilation(reversal, np.ones(4 * record.smoothing() + 1))
            slides &= self.known[id(record)] > 0.0 if self.driven else True
            force = record.low_passed(record.force) if self.driven else record.force
            error += float(np.sum(row[slides] ** 2))
            power += float(np.sum((force[slides] - zero) ** 2))
        return math.sqrt(error / power) if power > 0.0 else math.nan

    def held_out_error(self, fit: ForceFit, *, sliding: bool = False) -> float:
        """Return rms(model - measured) held out, N.

        ``sliding``: only where the mass slides farther from any standstill than the low-pass reaches, if it
        does so anywhere. The low-pass, of deviation w, makes a speed of up to 2 w z'' out of a standstill.
        """
        kept = []
        for record, row in zip(self.held, fit.held, strict=True):
            motion, width = self.motions[id(record)], record.smoothing()
            slow = 2.0 * 0.25 * width * record.period * float(np.std(motion.acceleration))
            may_stand = binary_dilation(np.abs(motion.velocity) < slow, np.ones(4 * width + 1))
            kept.append(row[~may_stand] if sliding else row)
        count = sum(row.size for row in kept)
        if count == 0:
            return self.held_out_error(fit)
        return math.sqrt(sum(float(np.sum(row**2)) for row in kept) / count)

    def seen(self, record: ForceRecord) -> Array:
        """Return the force as it is compared, N: what the low-pass leaves of it where a mass is driven."""
        if not self.driven:
            return record.force
        return record.low_passed(record.force)[self.known[id(record)] > 0.0]

    def noise_power(self, record: ForceRecord) -> float:
        """Return the power of the noise in the force as it is compared, N^2."""
        power = white_power(record.force)
        if not self.driven:
            return power
        return power * float(np.sum(record.answer() ** 2))


def _known(record: ForceRecord, motion: Motion) -> Array:
    """Return 1 where the balance says something, else 0, shape (n,).

    A part that sticks takes whatever force there is, up to that of its friction.
    """
    width = record.smoothing()
    still = (np.abs(motion.velocity) < STILL * motion.velocity_noise).astype(np.float64)
    still = binary_opening(still > 0.0, np.ones(max(4, width // 2)))
    sticks = binary_dilation(still, np.ones(2 * width + 1))
    return np.asarray(record.inner * ~sticks)


def _motion(record: ForceRecord, centre: float, *, driven: bool) -> Motion:
    place, velocity, acceleration = record.displacement, record.derivative(1), record.derivative(2)
    if driven:
        place, velocity, acceleration = (record.low_passed(record.displacement, order) for order in range(3))
    noise = float(np.std(np.diff(record.displacement, 3))) / np.sqrt(20.0) / record.period
    noise /= record.smoothing() ** 1.5 / 3.5
    return Motion(
        place - centre, velocity, acceleration, record.time, record.period,
        max(noise, 1e-9), 1.0, 1.0, 1.0,
    )  # fmt: skip


def independent_samples(row: Array) -> float:
    """Return how many independent samples a coloured residual is worth."""
    centred = row - row.mean()
    power = float(centred @ centred)
    if power <= 0.0:
        return float(row.size)
    reach = min(row.size // 4, 400)
    correlation = np.array([float(centred[lag:] @ centred[: row.size - lag]) for lag in range(reach)]) / power
    below = np.flatnonzero(correlation < 0.05)
    stop = int(below[0]) if below.size else reach
    return row.size / (1.0 + 2.0 * float(np.sum(correlation[1:stop])))


# Checks -----------------------------------------------------------------------------------------------------


def conditions_of(records: Sequence[ForceRecord]) -> list[str]:
    """Return warnings about ``records``.

    Raises:
        InputError: nothing moves, the force does not change, or a unit must be wrong.
    """
    first = records[0]
    for name, rows, unit in (
        ("displacement_m", [record.displacement for record in records], "m"),
        ("force_N", [record.force for record in records], "N"),
    ):
        if not max(float(np.ptp(row)) for row in rows) > 0.0:
            raise InputError(f"{first.name}: {name} does not change: check sensor and cable")
        noise = float(np.sqrt(np.mean([white_power(row) for row in rows])))
        size = float(np.std(np.concatenate(rows)))
        if size < EXCITED * noise:
            raise InputError(
                f"{first.name}: {name} shows hardly more than noise ({size:.3g} {unit} rms, "
                f"noise {noise:.3g}): does anything move, and is it sampled fast enough?"
            )
    span = float(np.ptp(np.concatenate([record.displacement for record in records])))
    speed, acceleration = (
        float(np.sqrt(np.mean(np.concatenate([record.derivative(order) for record in records]) ** 2)))
        for order in (1, 2)
    )
    if span > TOO_LONG or speed > TOO_FAST or acceleration > TOO_HARD:
        raise InputError(
            f"{first.name}: displacement_m spans {span:.3g} m at {speed:.3g} m/s and "
            f"{acceleration:.3g} m/s^2 rms: is it in mm instead of m, or exchanged with force_N?"
        )
    return [f"the displacement spans {span:.3g} m: is it in mm instead of m?"] if span > LONG else []


def check_motion(balance: ForceBalance, name: str) -> None:
    """Refuse records in which a driven mass moves too little for a balance of forces.

    While it sticks, friction takes any force, so these samples say nothing. Samples within the width of the
    low-pass count as one; more of them must be left than the base has numbers, to fit and to judge on.

    Raises:
        InputError: the mass sticks nearly throughout.
    """
    for what, records in (("fitted", balance.train), ("held-out", balance.held)):
        moving = [float(balance.known[id(record)].sum()) for record in records]
        independent = sum(count / r.smoothing() for count, r in zip(moving, records, strict=True))
        if independent <= len(balance.base):
            share = sum(moving) / sum(record.force.size for record in records)
            raise InputError(
                f"{name}: the mass moves in {percent(share)} of the {what} samples and sticks in the others: "
                "too few to balance its forces; sample faster, or drive it so that it keeps moving"
            )


def check_mass(balance: ForceBalance, fit: ForceFit, name: str, given: float | None) -> None:
    """Compare the mass that the motion shows with what is possible.

    Args:
        balance: of a driven mass.
        fit: of its base.
        name: of the record.
        given: kg, by the valve's description; ``None`` without one.

    Raises:
        InputError: no mass fits, or quite another one than ``given``.
    """
    if given is None:
        place = balance.base.index("mass")
        shown = float(fit.coefficients[place])
        if shown < 3.0 * float(fit.deviations[place]):
            raise InputError(
                f"{name}: no mass fits force and motion ({shown:.3g} kg): is the motion imposed "
                "(--kind imposed), or is a column's sign turned round?"
            )
        return
    free = ForceBalance(balance.train, balance.held, [*balance.base, "mass"], driven=True)
    shown = float(free.fit([]).coefficients[-1])
    if not given / OTHER_MASS < shown < given * OTHER_MASS:
        raise InputError(
            f"{name}: force and motion correspond to {shown:.3g} kg, but the valve's description has "
            f"{given:.3g} kg: check the units of force_N and displacement_m, or omit --valve"
        )

"""Blind case: a record, what is hidden in it, how visible that is, its files, and the limit of detection.

Where friction is small, its other laws are Coulomb friction to any record.
"""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from spool_blind.condition import DELAY_TOLERANCE, GAIN_TOLERANCE, ExperimentCondition, Scale, draw_condition
from spool_blind.hidden import EFFECTS, OUT_OF_CATALOGUE, Hidden, Kind
from spool_blind.simulator import Channels
from spool_blind.visibility import Visibility, look, noncentrality, threshold

Array = NDArray[np.float64]

NONE = "none"
RECORD, VALVE, TRUTH = "record.csv.gz", "valve.yaml", "truth.json"
#: At clear size the remainder after the base is at least this many times the noise floor, rms over rms.
CLEAR = 1.0
#: For out-of-catalogue effects gain and delay may be so many times out of tolerance: those have names.
OUT_OF_CATALOGUE_TOLERANCE = 10.0
#: Least noncentrality of a test between an effect and a simpler one that it contains: noise covers less.
DISTINCT = 40.0
#: The spool still moves by this share of what it would with nothing hidden: a locked one tells nothing.
LEAST_TRAVEL = 0.2
#: Two accelerometers see these only in how the motion sets in.
FROM_REST = ("asymmetric_friction",)
GROWTH, GROWTHS, DRAWS = 1.5, 3, 12
#: Of 20 seeds in a row: so many with nothing hidden, one effect, two effects; the rest no catalogue lists.
SHARES = (4, 10, 3)

PAIRS: tuple[str, ...] = tuple(
    f"{one}+{other}"
    for one, other in combinations(sorted(EFFECTS), 2)
    if EFFECTS[one].group != EFFECTS[other].group
    and {"gain", "delay"} != {EFFECTS[one].group, EFFECTS[other].group}
)

#: m, of the valve's lands; the description names the nominal oil, which may not be the oil in the valve.
LAND_DIAMETER, LAND_LENGTH, RADIAL_CLEARANCE, VISCOSITY = 0.020, 0.032, 15.0e-6, 0.0612
SPOOL_SHARE = 0.172 / 0.18

#: Over the size that is drawn as clear.
SMALLEST, LARGEST = 1e-4, 2.0
#: Evidence at the limit is within this of the threshold, relative; so many cases are made at most.
CLOSE, MOST = 0.1, 14

#: Steps for slopes and room, in units of ``_SIZES``, and runs of the fit.
STEP, ROOM, RUNS = 0.05, 200.0, 8
#: Sizes of stiffness and damping (relative), gain, delay (of their tolerances), force (of inertia).
_SIZES = np.array([0.002, 0.02, 0.05, 0.05, 0.02])


@dataclass(frozen=True, slots=True, kw_only=True)
class HiddenCase:
    """A record with its truth, of any family.

    Attributes:
        seed: makes it again.
        hidden: "none", an effect's id, two joined by "+", or the id of a law outside of the catalogue.
        accepted: verdicts that are right; of a field case with "unexplained" among them, so is that next to
            names.
        factor: size over the size that was drawn, of a field case over that of the clear cases.
        condition: drawn.
        plant: numbers of the plant, with what is hidden.
        truth: values a fit should find, by effect, then by parameter; SI.
        time, body, spool: the record as it is stored, s and m/s^2, shape (n,); NaN where a sample is empty.
    """

    seed: int
    hidden: str
    accepted: tuple[str, ...]
    factor: float
    condition: ExperimentCondition
    plant: Mapping[str, float]
    truth: Mapping[str, Mapping[str, float]]
    time: Array
    body: Array
    spool: Array

    @property
    def kind(self) -> str:
        """Kind of what is hidden, see ``kind_of``."""
        return kind_of(self.hidden)

    def told(self) -> dict[str, Any]:
        """Return what is true of it, for JSON, SI units."""
        condition = self.condition
        return {
            "seed": self.seed,
            "kind": self.kind,
            "hidden": self.hidden,
            "accepted": list(self.accepted),
            "factor": self.factor,
            "effects": {name: dict(values) for name, values in self.truth.items()},
            "plant": dict(self.plant),
            "drive": condition.excitation.kind,
            "amplitude_m_s2": condition.amplitude,
            "band_Hz": [condition.excitation.low, condition.excitation.high],
            "sample_rate_Hz": condition.sample_rate,
            "duration_s": condition.duration,
            "nominal_stiffness_N_m": condition.nominal_stiffness,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class BlindCase(HiddenCase):
    """A clear case, or one of a given size.

    Attributes:
        channels: drawn, with what is hidden.
        visibility: of what is hidden, together; ``None`` where nothing is.
    """

    channels: Channels
    visibility: Visibility | None

    @property
    def threshold(self) -> float:
        """Detection threshold: evidence at which a test that knows the effect sees half of the records."""
        return threshold(max(1, sum(len(values) for values in self.truth.values())))

    def told(self) -> dict[str, Any]:
        """Return what is true of it, for JSON, SI units."""
        seen = self.visibility
        return {
            **HiddenCase.told(self),
            "channels": {name: getattr(self.channels, name) for name in type(self.channels).__slots__},
            "levels": list(self.condition.excitation.levels),
            "noise_share": self.condition.noise_share,
            "visible": None
            if seen is None
            else {
                "nrmse": seen.nrmse,
                "noise_nrmse": seen.noise_nrmse,
                "evidence": seen.evidence,
                "threshold": self.threshold,
            },
        }


def kind_of(hidden: str) -> str:
    """Return none, effect, pair or out_of_catalogue."""
    if hidden == NONE:
        return NONE
    if "+" in hidden:
        return "pair"
    return "effect" if hidden in EFFECTS else "out_of_catalogue"


def hidden_by(seed: int) -> str:
    """Return what the case of ``seed`` hides: any 20 seeds in a row hold the same mixture."""
    none, single, pairs = SHARES
    block, place = divmod(seed, 20)
    if place < none:
        return NONE
    if place < none + single:
        return sorted(EFFECTS)[(block * single + place - none) % len(EFFECTS)]
    generator = np.random.default_rng([seed, 7])
    if place < none + single + pairs:
        return str(generator.choice(PAIRS))
    each = 20 - none - single - pairs
    return sorted(OUT_OF_CATALOGUE)[(block * each + place - none - single - pairs) % len(OUT_OF_CATALOGUE)]


def make(
    seed: int, hidden: str | None = None, *, factor: float | None = None, moderate: bool = False
) -> BlindCase:
    """Make the case of ``seed``.

    Args:
        seed: the same gives the same record, bit for bit on one machine.
        hidden: what to hide; left out, the seed decides.
        factor: size over what is drawn; left out, the size is clear (see ``CLEAR``).
        moderate: under a moderate condition, see ``draw_condition``.

    Raises:
        KeyError: ``hidden`` names nothing that can be hidden.
        RuntimeError: nothing clear was found in ``DRAWS`` draws.
    """
    hidden = hidden_by(seed) if hidden is None else hidden
    kinds = [] if hidden == NONE else [_kind(name) for name in hidden.split("+")]
    tolerance = OUT_OF_CATALOGUE_TOLERANCE if kind_of(hidden) == "out_of_catalogue" else 1.0
    generator = np.random.default_rng(seed)
    for _ in range(DRAWS):
        from_rest = any(name in FROM_REST for name in hidden.split("+"))
        condition = draw_condition(generator, from_rest=from_rest, moderate=moderate)
        scale = condition.scale()
        things = [kind.draw(generator, condition, scale) for kind in kinds]
        noise_seed = int(generator.integers(2**31))
        if not things or factor is not None:
            size = 1.0 if factor is None else factor
            return _record(
                seed, hidden, BlindTrial(condition, [thing.sized(size) for thing in things]), noise_seed, size
            )
        for growth in range(GROWTHS + 1):
            size = GROWTH**growth
            grown = [thing.sized(size) for thing in things]
            alone = [BlindTrial(condition, [thing], tolerance) for thing in grown]
            if all(trial.clear(scale) for trial in alone):
                trial = alone[0] if len(alone) == 1 else BlindTrial(condition, grown)
                # Friction may keep the spool from the stop, or its sensor from the rail, but for one hit.
                if len(alone) == 1 or all(trial.differs(other) for other in alone):
                    return _record(seed, hidden, trial, noise_seed, size)
            if not all(thing.size or thing.edges for thing in things):
                break
    raise RuntimeError(f"seed {seed}: {hidden} was not clear under any of {DRAWS} conditions")


class BlindTrial:
    """Trial of a size: the motion with something hidden, and how visible that is."""

    def __init__(self, condition: ExperimentCondition, things: list[Hidden], tolerance: float = 1.0) -> None:
        plant = condition.base
        for thing in things:
            plant = plant.with_(**thing.plant)
        self.condition, self.things, self.plant = condition, things, plant
        self.motion = condition.move(plant)
        moving = self.motion.time > 0.0
        self.travel = float(self.motion.displacement[moving].std())
        noise = condition.noise_share * float(self.motion.spool[moving].std())
        values: dict[str, float] = {"gain": condition.gain, "delay": condition.delay, "noise": noise}
        for thing in things:
            values.update(thing.channel)
        self.channels = Channels(**values)
        self.quiet = replace(self.channels, noise=0.0)
        _, self.spool = self.quiet.read(self.motion, sample_times(condition), np.random.default_rng(0))
        self.visibility: Visibility | None = self._look(tolerance) if things else None

    def _look(self, tolerance: float) -> Visibility:
        condition = self.condition
        t = sample_times(condition)
        before = round(condition.before * condition.sample_rate)
        whole = np.arange(-before, t.size) / condition.sample_rate
        return look(
            condition.base.numbers,
            condition.amplitude * condition.excitation.at(whole),
            self.spool,
            condition.sample_rate,
            first=before,
            noise=self.channels.noise,
            tolerance=tolerance,
        )

    def clear(self, scale: Scale) -> bool:
        """Return whether what is hidden is seen, distinguished from less, and lets the spool move."""
        seen = self.visibility is None or self.visibility.over_noise >= CLEAR
        return seen and self.travel >= LEAST_TRAVEL * scale.travel and all(map(self._distinct, self.things))

    def _distinct(self, thing: Hidden) -> bool:
        if not thing.simpler:
            return True
        simpler = replace(thing, plant={**thing.plant, **thing.simpler}, simpler={})
        others = [simpler if entry is thing else entry for entry in self.things]
        difference = self.spool - BlindTrial(self.condition, others).spool
        numbers, rate = self.condition.base.numbers, self.condition.sample_rate
        return noncentrality(difference, numbers, rate, self.channels.noise) >= DISTINCT

    def differs(self, other: BlindTrial) -> bool:
        """Return whether the record without noise differs from ``other``, and not in one second only.

        Both in steps of one length: friction is sensitive to those.
        """
        motion = self.condition.move(other.plant, like=self.plant)
        _, spool = other.quiet.read(motion, sample_times(self.condition), np.random.default_rng(0))
        squares = (self.spool - spool) ** 2
        seconds = np.arange(0, squares.size, round(self.condition.sample_rate))
        loudest = int(np.argmax(np.add.reduceat(squares, seconds)))
        squares[seconds[loudest] :][: round(self.condition.sample_rate)] = 0.0
        return float(np.sqrt(squares.mean())) >= CLEAR * self.channels.noise


def sample_times(condition: ExperimentCondition) -> Array:
    """Return the instants of the record's samples, s, shape (n,)."""
    return np.arange(round(condition.duration * condition.sample_rate)) / condition.sample_rate


def valve_text(case: HiddenCase) -> str:
    """Return the valve's description, YAML: its mass is true, its spring is the maker's number."""
    mass = case.plant["mass"]
    return (
        "id: blind_valve\n"
        f"moving_mass: {mass!r}\nspool_mass: {SPOOL_SHARE * mass!r}\n"
        f"spring_stiffness: {case.condition.nominal_stiffness!r}\n"
        f"land_diameter: {LAND_DIAMETER}\nland_length: {LAND_LENGTH}\n"
        f"radial_clearance: {RADIAL_CLEARANCE:.7f}\ndynamic_viscosity: {VISCOSITY}\n"
        "oil: HL68\noil_temperature: 20.0\n"
    )


def write(case: HiddenCase, folder: Path) -> tuple[Path, Path]:
    """Write ``record.csv.gz``, ``valve.yaml`` and ``truth.json`` into ``folder``; return the first two."""
    folder.mkdir(parents=True, exist_ok=True)
    write_record(folder / RECORD, case.time, case.body, case.spool)
    (folder / VALVE).write_text(valve_text(case), "utf-8")
    (folder / TRUTH).write_text(json.dumps(case.told(), indent=1), "utf-8")
    return folder / RECORD, folder / VALVE


def write_record(path: Path, time: Array, body: Array, spool: Array) -> None:
    """Write a record of two accelerometers as CSV, gzipped where the name says so; NaN is an empty cell."""
    lines = ["time_s,body_m_s2,spool_m_s2\n"]
    for row in zip(time.tolist(), body.tolist(), spool.tolist(), strict=True):
        cells = [f"{row[0]:.9g}"] + ["" if math.isnan(value) else f"{value:.7g}" for value in row[1:]]
        lines.append(",".join(cells) + "\n")
    text = "".join(lines)
    if path.suffix == ".gz":
        with gzip.open(path, "wt", compresslevel=1) as file:
            file.write(text)
    else:
        path.write_text(text, "utf-8")


def limit_case(seed: int, hidden: str, *, moderate: bool = False) -> BlindCase | None:
    """Return the case of ``seed`` at the size at which the evidence is at the threshold.

    The test knows what is hidden and the noise, and base, gain and delay are refitted with it: the most
    powerful one at its rate of false alarms (Neyman and Pearson 1933), as a mean over the noise. A single
    record may be named below it.
    A law of friction that contains Coulomb friction must be distinguished from that, too.

    Args:
        seed: of the condition and of the size that ``BlindCase.factor`` is relative to.
        hidden: an effect.
        moderate: under a moderate condition, see ``condition.draw_condition``.

    Returns:
        ``None`` where even the largest size is not seen.
    """
    low, high = math.log(SMALLEST), math.log(LARGEST)
    best = make(seed, hidden, factor=LARGEST, moderate=moderate)
    above = _over_threshold(best)
    if above < 0.0:
        return None
    guess = high - 0.5 * above
    for _ in range(MOST):
        if abs(above) < CLOSE or high - low < 0.02:
            break
        # Evidence grows with the square of a small size; where it does not, the bracket is halved.
        middle = guess if low < guess < high else 0.5 * (low + high)
        case = make(seed, hidden, factor=math.exp(middle), moderate=moderate)
        above = _over_threshold(case)
        if above >= 0.0 or abs(above) < CLOSE:
            best = case
        if above >= 0.0:
            high = middle
        else:
            low = middle
        guess = middle - 0.5 * above
    return best


def contains_coulomb_friction(case: BlindCase) -> bool:
    """Return whether what is hidden is one law of friction that contains Coulomb friction."""
    return case.hidden in EFFECTS and EFFECTS[case.hidden].richer


def over_coulomb_friction(case: BlindCase) -> float:
    """Return the noncentrality of a test between ``case`` and Coulomb friction; base, gain, delay refitted.

    Raises:
        ValueError: what is hidden does not contain Coulomb friction.
    """
    if not contains_coulomb_friction(case):
        richer = ", ".join(name for name, kind in EFFECTS.items() if kind.richer)
        raise ValueError(f"{case.hidden} does not contain Coulomb friction; these do: {richer}")
    condition = case.condition
    force = condition.scale().force
    target = _reading(case, case.plant, case.channels.gain, case.channels.delay)
    known = condition.base.numbers

    def remainder(x: Array) -> Array:
        stiffness, damping, gain, delay, friction = (x - 1.0) * _SIZES
        numbers = {
            **known,
            "stiffness": known["stiffness"] * (1.0 + stiffness),
            "damping": known["damping"] * (1.0 + damping),
            "coulomb_force": friction * force,
        }
        gain = case.channels.gain + gain * GAIN_TOLERANCE
        return _reading(case, numbers, gain, case.channels.delay + delay * DELAY_TOLERANCE) - target

    within = 1.0 / _SIZES[2:4]
    found = least_squares(
        remainder,
        np.ones(5),
        bounds=(
            [1.0 - ROOM, 1.0 - 1.0 / _SIZES[1], *(1.0 - within), 1.0],
            [1.0 + ROOM, 1.0 + ROOM, *(1.0 + within), 1.0 + ROOM],
        ),
        diff_step=STEP,
        max_nfev=RUNS,
    )
    return noncentrality(remainder(found.x), known, condition.sample_rate, case.channels.noise)


def _kind(name: str) -> Kind:
    return EFFECTS[name] if name in EFFECTS else OUT_OF_CATALOGUE[name]


def _record(seed: int, hidden: str, trial: BlindTrial, noise_seed: int, factor: float) -> BlindCase:
    t = sample_times(trial.condition)
    body, spool = trial.channels.read(trial.motion, t, np.random.default_rng(noise_seed))
    names = [] if hidden == NONE else hidden.split("+")
    return BlindCase(
        seed=seed,
        hidden=hidden,
        accepted=OUT_OF_CATALOGUE[hidden].accepted if hidden in OUT_OF_CATALOGUE else (hidden,),
        factor=factor,
        condition=trial.condition,
        plant=trial.plant.numbers,
        channels=trial.channels,
        truth={name: thing.truth for name, thing in zip(names, trial.things, strict=True) if thing.truth},
        visibility=trial.visibility,
        time=t,
        body=body,
        spool=spool,
    )


def _over_threshold(case: BlindCase) -> float:
    """Return the logarithm of the evidence over the threshold."""
    evidence = 0.0 if case.visibility is None else case.visibility.evidence
    if evidence > case.threshold and contains_coulomb_friction(case):
        evidence = min(evidence, over_coulomb_friction(case))
    return math.log(max(evidence, 1e-12) / case.threshold)


def _reading(case: BlindCase, numbers: Mapping[str, float], gain: float, delay: float) -> Array:
    """Return the spool's channel without noise, m/s^2, shape (n,)."""
    condition = case.condition
    plant = replace(condition.base, numbers=numbers)
    channels = replace(case.channels, noise=0.0, gain=gain, delay=delay)
    return channels.read(condition.move(plant), sample_times(condition), np.random.default_rng(0))[1]

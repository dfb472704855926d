"""FinalResidual of the final model: how much is left, and whether a complete model may leave that."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spool_gap.screening.level_dependence import LevelDependence, level_dependence
from spool_gap.screening.remainder import PredictableShares, remainder
from spool_gap.selection.state import SelectionState
from spool_gap.selection.windows import median_excess, median_share
from spool_gap.simulation.noise_floor import Floor, excess, noise_floor
from spool_gap.simulation.simulate import Simulation
from spool_gap.thresholds import THRESHOLDS

Array = NDArray[np.float64]

#: Effect with which the motion is sensitive: free runs part from it at each hit.
SENSITIVE = "end_stop"


@dataclass(frozen=True, slots=True)
class FinalResidual:
    """What the final model leaves.

    Attributes:
        floor: what noise leaves of its free runs.
        power: residual power over the noise floor's.
        remainder: its predictable shares.
        share: of the gap's power, noise taken off.
        unexplained: whether it is more than a complete model leaves.
        level: whether it comes and goes with the motion.
        predictable: whether it follows from the motion.
    """

    floor: Floor
    power: float
    remainder: PredictableShares
    share: float
    unexplained: bool
    level: LevelDependence
    predictable: bool


@dataclass(frozen=True, slots=True)
class _Runs:
    """Runs that judge: free ones, or synchronised ones where the motion can go several ways.

    Attributes:
        simulation: of the windows.
        before, held: errors of the base and of the hypothesis on those held out, m/s^2, shape (1, n) each.
        train: of the hypothesis on the others.
        floor: what noise leaves.
    """

    simulation: Simulation
    before: Sequence[Array]
    train: Sequence[Array]
    held: Sequence[Array]
    floor: Floor

    def nrmse(self, errors: Sequence[Array]) -> float:
        """Held out."""
        return float(self.simulation.nrmse(errors, self.simulation.held_out)[0])


def residue_of(state: SelectionState) -> FinalResidual:
    """Return what the accepted hypothesis of ``state`` leaves."""
    final = state.hypothesis
    floor = noise_floor(state.fitting.simulation, final.point, final.held)
    runs = _judging(state, floor)
    rest = remainder(runs.simulation.weighed_by(runs.train), final.point, runs.train, runs.held)
    power = excess(runs.simulation, runs.held, runs.floor)
    everything = [*runs.simulation.training, *runs.simulation.held_out]
    level = level_dependence(runs.simulation, [*runs.train, *runs.held], everything)
    unexplained = _is_open(state, runs, power, rest, level) and not _runs_free(state, floor)
    unexplained = unexplained or (level.share > 0.0 and _hardly_closed(state, floor.nrmse))
    # By free runs, whatever synchronised ones follow: what those leave is what the names explain.
    fitting = state.fitting
    share = _share(fitting.nrmse(state.steps[0]), fitting.nrmse(final), floor.nrmse) ** 2
    after = runs.nrmse(runs.held)
    predictable = rest.counts(after, runs.nrmse(runs.before), kinks=final.has_kinks)
    return FinalResidual(floor, power, rest, share, unexplained, level, predictable)


def _judging(state: SelectionState, floor: Floor) -> _Runs:
    base, final = state.steps[0], state.hypothesis
    if not state.synchronised:
        return _Runs(state.fitting.simulation, base.held, final.train, final.held, floor)
    judging = state.judging
    held = judging.held_out
    errors = judging.errors([final.point], held)
    return _Runs(
        judging,
        judging.errors([base.point], held),
        judging.errors([final.point], judging.training),
        errors,
        noise_floor(judging, final.point, errors),
    )


def _is_open(
    state: SelectionState, runs: _Runs, power: float, rest: PredictableShares, level: LevelDependence
) -> bool:
    """Whether the runs that judge leave more than a complete model may."""
    final = state.hypothesis
    before, after = runs.nrmse(runs.before), runs.nrmse(runs.held)
    # What does not come and go with the motion is noise, whatever its colour.
    noise = max(runs.floor.nrmse, after * math.sqrt(1.0 - level.share))
    # Synchronised runs follow through hits, too.
    chaotic = SENSITIVE in final.effects and not state.synchronised
    # Where nothing was added there is no gap to measure the remainder by, only the noise floor.
    least = THRESHOLDS.above_noise_floor if final.effects else THRESHOLDS.closed
    follows = rest.counts(after, before, kinks=final.has_kinks) and not chaotic
    if follows and after > least * runs.floor.nrmse:
        return True
    most = THRESHOLDS.may_stay_with_stop if chaotic else THRESHOLDS.may_stay
    most = most if final.has_kinks else THRESHOLDS.may_stay_smooth
    stays = min(_share(before, after, noise), median_share(runs.before, runs.held, runs.floor.errors))
    large = power > THRESHOLDS.residual_power and after > THRESHOLDS.closed * noise
    return large and (stays > most or not final.effects)


def _runs_free(state: SelectionState, floor: Floor) -> bool:
    """Whether synchronised runs judge, but free ones come down to the noise floor, in all or in the median.

    The measured velocity that runs are synchronised to has errors, too, not distinguished from the model's.
    """
    final = state.hypothesis
    free = min(state.fitting.nrmse(final) / floor.nrmse, median_excess(final.held, floor.errors))
    return state.synchronised and free < THRESHOLDS.closed


def _hardly_closed(state: SelectionState, noise: float) -> bool:
    """Whether free runs of what is named leave most of the gap, whatever synchronised ones do."""
    if not state.hypothesis.effects:
        return False
    before, after = state.fitting.nrmse(state.steps[0]), state.fitting.nrmse(state.hypothesis)
    above = after > THRESHOLDS.above_noise_floor * noise
    return above and _share(before, after, noise) > THRESHOLDS.hardly_closed


def _share(before: float, after: float, noise: float) -> float:
    """Return the share of the gap's amplitude that ``after`` holds: 1 where there is no gap."""
    gap = math.sqrt(max(before**2 - noise**2, 0.0))
    return math.sqrt(max(after**2 - noise**2, 0.0)) / gap if gap > 0.0 else 1.0

"""State of a selection, which stages turn into the next one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace

from spool_gap.effect import Effect
from spool_gap.fitting.descent import Fitted
from spool_gap.fitting.hypothesis import Fitting, Hypothesis
from spool_gap.result import Change, RankedHypothesis
from spool_gap.screening.regression import Screened
from spool_gap.simulation.simulate import Simulation

from .context import Context

Key = tuple[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Remaining:
    """Residual of a fit over whole windows.

    Attributes:
        fitted: the fit.
        noise_floor: what noise leaves, over the measured acceleration.
        excess: error over that, in all windows or in the median one.
        counts: whether it is some of the gap.
        predictable: whether it can be predicted, as noise cannot.
    """

    fitted: Fitted
    noise_floor: float
    excess: float
    counts: bool
    predictable: bool

    def is_noise(self, most: float) -> bool:
        """Whether it is noise where that may be up to ``most`` times the noise floor."""
        return not (self.predictable or (self.excess > most and self.counts))


@dataclass(frozen=True, slots=True)
class Candidate:
    """Candidate for the next effect: fitted, with its evidence, and why it is refused or an empty string."""

    hypothesis: Hypothesis
    evidence: float
    reason: str


@dataclass(frozen=True, slots=True)
class SelectionState:
    """What is known in the middle of a selection.

    Attributes:
        fitting: windows that hypotheses are fitted to and compared on, with the present weight.
        judging: runs over whole windows that say whether a hypothesis is complete.
        catalogue: effects that are tried.
        accepted: hypothesis so far.
        steps: base first, then each accepted one.
        ranking: every hypothesis that was simulated.
        tried: its fit, by effect and effects that it was tried jointly with.
        overruled: effects that were ahead at first and lost, with the evidence against them.
        synchronised: runs are synchronised to the measured motion, which can go several ways.
        remaining: what the hypothesis that was last looked at leaves over whole windows.
        screened: effects worth simulating in this round; ``fits``: their fits.
        candidates: those ranked, best first.
        chosen: best of them so far, ``None`` where none is better than ``accepted``.
        trace: which stage changed the choice.
    """

    fitting: Fitting
    judging: Simulation
    catalogue: tuple[Effect, ...]
    accepted: Hypothesis | None = None
    steps: tuple[Hypothesis, ...] = ()
    ranking: tuple[RankedHypothesis, ...] = ()
    tried: Mapping[Key, Hypothesis] = field(default_factory=dict)
    overruled: Mapping[str, float] = field(default_factory=dict)
    synchronised: bool = False
    remaining: Remaining | None = None
    screened: tuple[Screened, ...] = ()
    fits: tuple[Hypothesis, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    chosen: Hypothesis | None = None
    trace: tuple[Change, ...] = ()

    @property
    def hypothesis(self) -> Hypothesis:
        """The accepted hypothesis, once the base is fitted."""
        assert self.accepted is not None
        return self.accepted

    @property
    def noise_floor(self) -> float:
        """What noise leaves of the hypothesis that was last looked at, 0 before any was."""
        return self.remaining.noise_floor if self.remaining else 0.0

    @property
    def begun(self) -> SelectionState:
        """This at the beginning of a round: nothing screened, nothing chosen."""
        return replace(self, screened=(), fits=(), candidates=(), chosen=None)

    @property
    def choice(self) -> tuple[str, ...]:
        """Effects of the best hypothesis at present."""
        best = self.chosen or self.accepted
        return best.effects if best else ()

    def refitted(self, old: Hypothesis, new: Hypothesis) -> SelectionState:
        """Return this with ``new`` in place of ``old`` wherever it is held."""
        return replace(
            self,
            accepted=new if self.accepted is old else self.accepted,
            steps=tuple(new if step is old else step for step in self.steps),
            tried={key: new if fit is old else fit for key, fit in self.tried.items()},
        )

    def over(self, fitting: Fitting) -> SelectionState:
        """Return this with ``fitting``, by which its steps are measured."""
        state = replace(self, fitting=fitting)
        for step in self.steps:
            state = state.refitted(step, fitting.measured(step))
        return state


#: Stages that look for something better than what is known: a search that is out of time does without.
FURTHER = frozenset({"find_small_effect", "compare_sliding_laws", "start_from_best_law"})
Stage = Callable[[Context, SelectionState], SelectionState]


def run_stages(stages: Iterable[Stage], context: Context, state: SelectionState) -> SelectionState:
    """Return ``state`` after ``stages``, with a trace of which changed the choice."""
    for stage in stages:
        name = stage.__name__
        if name in context.left_out:
            continue
        if name in FURTHER and context.late:
            given_up = Change(name, state.choice, state.choice, gave_up=True)
            state = replace(state, trace=(*state.trace, given_up))
            continue
        after = stage(context, state)
        if after.choice != state.choice and len(after.trace) == len(state.trace):
            after = replace(after, trace=(*after.trace, Change(name, state.choice, after.choice)))
        state = after
    return state

"""Benchmark of recursive least squares, against a compiled textbook loop and padasip."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from time import process_time
from typing import Protocol

import numpy as np
import padasip
from numpy.typing import NDArray
from spool_estimator.recursion.recursive import ExponentialForgetting

from spool_evaluation.results.timing import Timing, best_of

from .rls_peer import CompiledRls

Array = NDArray[np.float64]

SAMPLES, SIZE, BLOCK, FACTOR = 20_000, 6, 200, 0.9995
#: Samples that are given one by one.
ONE_BY_ONE = 4000


class Recursion(Protocol):
    """Recursive least squares, ours or a peer's."""

    parameters: Array

    def update(self, rows: Array, target: Array) -> None:
        """Take samples."""


def timings() -> Iterator[Timing]:
    """Yield the time of one sample of recursive least squares; the error is the difference of the parameters.

    Ours takes blocks, as the stream brings them. padasip takes samples and is interpreted; a compiled peer is
    given the blocks of ours, and both are given one sample a call, where what counts is the call.
    """
    rows, target = _regression()
    few = slice(0, ONE_BY_ONE)

    def ours() -> ExponentialForgetting:
        return ExponentialForgetting(SIZE, FACTOR, initial=10.0)

    def compiled() -> CompiledRls:
        return CompiledRls(SIZE, FACTOR, 10.0)

    def padasip_run() -> Array:
        fit = padasip.filters.FilterRLS(n=SIZE, mu=FACTOR, eps=0.1, w="zeros")
        fit.run(target, rows)
        return np.asarray(fit.w)

    def taken(make: Callable[[], Recursion], part: slice, block: int) -> float:
        """Return s per sample."""
        samples = target[part].size
        return best_of(5, lambda: _take(make(), rows[part], target[part], block), process_time) / samples

    found = _take(ours(), rows, target, BLOCK)  # compiles
    other = _take(compiled(), rows, target, BLOCK)
    against = padasip_run()
    work = f"a sample of RLS with {SIZE} parameters"
    blocks, ones = f"{work}, ours in blocks of {BLOCK}", f"{work}, one sample a call"
    by_blocks, by_ones = taken(ours, slice(None), BLOCK), taken(ours, few, 1)
    loop, loop_ones = taken(compiled, slice(None), BLOCK), taken(compiled, few, 1)
    theirs = best_of(2, padasip_run, process_time) / SAMPLES
    differences = [float(np.abs(found - peer).max()) for peer in (other, against)]
    yield Timing(
        blocks, f"compiled loop, blocks of {BLOCK}", by_blocks, loop, differences[0], 0.0, compiling=1.0
    )
    yield Timing(
        ones, "compiled loop, one sample a call", by_ones, loop_ones, differences[0], 0.0, compiling=1.0
    )
    yield Timing(
        blocks, "padasip FilterRLS, sample by sample", by_blocks, theirs, differences[1], 0.0, theirs / loop
    )
    yield Timing(
        ones, "padasip FilterRLS, sample by sample", by_ones, theirs, differences[1], 0.0, theirs / loop_ones
    )


def _regression() -> tuple[Array, Array]:
    """Return ``SAMPLES`` rows and targets with noise."""
    generator = np.random.default_rng(0)
    rows = generator.standard_normal((SAMPLES, SIZE))
    return rows, rows @ np.arange(1.0, 1.0 + SIZE) + 0.1 * generator.standard_normal(SAMPLES)


def _take(fit: Recursion, rows: Array, target: Array, block: int) -> Array:
    """Return the parameters after all samples, ``block`` of them a call."""
    for first in range(0, target.size, block):
        fit.update(rows[first : first + block], target[first : first + block])
    return np.asarray(fit.parameters)

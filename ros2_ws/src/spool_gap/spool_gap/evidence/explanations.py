"""The answer as a set: what a record cannot tell apart, and what all of it says with one voice.

The set holds the most probable sets of effects that together make 95 %, of those that predict held-out
windows as well as any other. One that adds something to a more probable one, or lacks something of it, is not
counted beside it. The verdict is what all members say: the effects that they share, and the group on the
machine where they differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from spool_gap.catalogue import EFFECTS
from spool_gap.result import UNEXPLAINED

#: Probability that the members of the set have together, at least.
CREDIBLE = 0.95


def credible(probabilities: Mapping[frozenset[str], float]) -> list[frozenset[str]]:
    """Return the most probable sets of effects that together make 95 %, none of them part of another.

    Examples:
        >>> a, b, c = frozenset({"a"}), frozenset({"b"}), frozenset({"a", "c"})
        >>> credible({a: 0.6, b: 0.2, c: 0.2}) == [a, b]
        True
    """
    found: list[frozenset[str]] = []
    least, total = CREDIBLE * sum(probabilities.values()), 0.0
    for one in sorted(probabilities, key=lambda own: (-probabilities[own], len(own))):
        if total >= least:
            break
        total += probabilities[one]
        if not any(one <= other or other <= one for other in found):
            found.append(one)
    return found


def said_by(members: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return what all of ``members`` say: names that they share, the ids of groups in which they differ.

    ``unexplained`` stands for what they say in different groups.

    Examples:
        >>> said_by([["coulomb_friction", "end_stop"], ["stribeck_friction", "end_stop"]])
        ('end_stop', 'dry_friction')
        >>> said_by([["coulomb_friction"], ["quadratic_damping"]])
        ('unexplained',)
    """
    shared = [name for name in members[0] if all(name in one for one in members)]
    groups = {
        tuple(sorted(EFFECTS[name].group.replace(" ", "_") for name in one if name not in shared))
        for one in members
    }
    if len(groups) > 1:
        return (*shared, UNEXPLAINED)
    return (*shared, *groups.pop())

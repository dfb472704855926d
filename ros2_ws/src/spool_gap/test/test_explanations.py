"""The answer as a set: what a record leaves open, and what all members say."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_gap.catalogue import EFFECTS, group_of
from spool_gap.evidence.explanations import CREDIBLE, credible, said_by

GROUPS = {"dry friction", "drag and oil", "spring and play", "stop", "excitation", "sensor"}
SETS = st.frozensets(st.sampled_from("abcd"), max_size=3)


def test_every_effect_belongs_to_one_group_on_the_machine() -> None:
    assert {entry.group for entry in EFFECTS.values()} == GROUPS
    assert group_of(["end_stop", "stribeck_friction", "mixed_friction"]) == "dry friction+stop"
    assert group_of([]) == ""


@given(st.dictionaries(SETS, st.floats(1e-6, 1.0), min_size=1, max_size=8))
def test_no_member_of_a_set_holds_another_one_and_the_most_probable_is_in_it(
    probabilities: dict[frozenset[str], float],
) -> None:
    members = credible(probabilities)
    assert probabilities[members[0]] == max(probabilities.values())
    assert not any(one < other for one in members for other in members)
    # A missing one is unlikely, or covered by a member that is more probable.
    left = [own for own in probabilities if not any(own <= one or one <= own for one in members)]
    assert sum(probabilities[own] for own in left) <= (1.0 - CREDIBLE) * sum(probabilities.values()) + 1e-12


@pytest.mark.parametrize(
    ("members", "said"),
    [
        ([("coulomb_friction",)], ("coulomb_friction",)),
        ([("coulomb_friction",), ("mixed_friction",)], ("dry_friction",)),
        ([("end_stop", "coulomb_friction"), ("stribeck_friction", "end_stop")], ("end_stop", "dry_friction")),
        ([("coulomb_friction",), ("quadratic_damping",)], ("unexplained",)),
        ([()], ()),
    ],
)
def test_a_verdict_is_what_all_members_say(members: list[tuple[str, ...]], said: tuple[str, ...]) -> None:
    assert said_by(members) == said

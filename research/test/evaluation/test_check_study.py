"""Study of the check before a fit, on a few records."""

from __future__ import annotations

from spool_evaluation.studies.check import parts, recover_case, split_case


def test_recovered_and_halved_records_are_counted_by_their_intervals() -> None:
    rows = [one for number in (0, 1) for one in recover_case((7, number))]
    split = split_case((7, 2))
    assert {one.name for one in rows} == {"spring_stiffness", "viscous_coefficient", "coulomb_force"}
    judged = [one for one in rows if one.holds is not None]
    assert judged
    held = sum(bool(one.holds) for one in judged)
    assert all(one.contradicted == (one.difference > 1.959964) for one in split)
    text = "\n".join(parts(rows, split, 2))
    assert f"{held} of {len(judged)} 95 % intervals hold the truth" in text

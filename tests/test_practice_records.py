"""The estimator on records that another simulator made, see bags/README.md."""

import re
from pathlib import Path

import pytest
from spool_bag.reader import BagReader
from spool_core.uncertainty import Validity
from spool_estimator.estimate import State
from spool_estimator.estimator import Estimator, EstimatorSettings

BAGS = Path(__file__).resolve().parent.parent / "bags"
ROW = re.compile(
    r"\| `(\w+)` \| ([\d.]+) kg \| ([\d.]+) N/m \| ([\d.]+) N s/m \| (none|[\d.]+ N) \|", re.MULTILINE
)
#: Name of the bag -> moving mass (kg), stiffness (N/m), viscous coefficient (N s/m), Coulomb force (N).
TRUTH = {
    name: (float(mass), float(k), float(c), 0.0 if force == "none" else float(force.split()[0]))
    for name, mass, k, c, force in ROW.findall((BAGS / "README.md").read_text("utf-8"))
}


def test_the_readme_tells_the_truth_of_every_bag():
    assert sorted(TRUTH) == sorted(path.parent.name for path in BAGS.glob("*/metadata.yaml"))


@pytest.mark.parametrize("name", sorted(TRUTH))
def test_finds_what_the_other_simulator_ran_with(name):
    mass, stiffness, viscous, coulomb = TRUTH[name]
    reader = BagReader(BAGS / name)
    (valve,) = reader.valves
    estimator = Estimator(EstimatorSettings(mass))
    last = [estimate for block in reader.blocks(valve) for estimate in estimator.update(block)][-1]
    assert last.state is State.TRACKING
    assert last.lost_blocks == last.refused_blocks == 0
    assert all(quantity.validity is Validity.VALID for quantity in last.parameters)
    assert last.parameter("spring_stiffness").value == pytest.approx(stiffness, rel=0.01)
    assert last.parameter("viscous_coefficient").value == pytest.approx(
        viscous, rel=0.12 if coulomb else 0.05
    )
    if coulomb:
        assert last.parameter("coulomb_force").value == pytest.approx(coulomb, rel=0.06)
    else:
        assert abs(last.parameter("coulomb_force").value) < 0.02

"""`./spool simulate`: a bag from the simulator."""

from __future__ import annotations

from spool_report.requests import SimulationSettings

from spool_tools import command as cli


def simulate(out: cli.NewBag, settings: SimulationSettings, _force: cli.Force = False) -> None:
    """Write a bag from the simulator, faster than real time and without DDS.

    Example: ./spool simulate --valve 4weh10_soft --excitation sweep --seconds 40 --out sweep_bag
    """
    from spool_report.records import simulation  # noqa: PLC0415 - slow to load

    simulation.simulate(out, settings)


COMMAND = cli.Command(simulate, place=300, line="a bag from the simulator, faster than real time")

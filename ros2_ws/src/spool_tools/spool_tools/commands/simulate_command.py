"""`./spool simulate`: a bag from the simulator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from spool_report.requests import ModelName

from spool_tools import command as cli
from spool_tools.command import Command


def simulate(
    out: cli.NewBag,
    valve: cli.ValveFile = "4weh10_soft",
    model: ModelName = "coulomb",
    excitation: cli.ExcitationName = "sweep",
    seconds: Annotated[
        float | None, typer.Option(help="Length, s; default: the recorded excitation's, else 40.")
    ] = None,
    sample_rate: Annotated[float, typer.Option(help="Hz")] = 2000.0,
    block_rate: Annotated[float, typer.Option(help="Blocks a second.")] = 50.0,
    coulomb_force: Annotated[float | None, typer.Option(help="N; default: the model's.")] = None,
    noise: Annotated[
        float, typer.Option(help="Sensor noise, rms, m/s^2.", callback=cli.in_range(0.0))
    ] = 0.05,
    filter_: Annotated[
        str,
        typer.Option(
            "--filter",
            help="Low-pass of both channels: instants, mean, linear, causal, or like linear,6,0.42 with "
            "order and corner over the sample rate.",
        ),
    ] = "instants",
    sensors: Annotated[
        Path | None, typer.Option(help="YAML file of the sensors, replaces --noise and --filter.")
    ] = None,
    oil_temperature: Annotated[
        str | None,
        typer.Option(
            help="deg C, or 20:60 for oil that warms; default: the valve file's. Sets the viscosity."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the noise.", min=0)] = 0,
    name: Annotated[str, typer.Option(help="Namespace of the valve in the bag.")] = "valve_1",
    _force: cli.Force = False,
) -> None:
    """Write a bag from the simulator, faster than real time and without DDS.

    Example: ./spool simulate --valve 4weh10_soft --excitation sweep --seconds 40 --out sweep_bag
    """
    from spool_report.records import simulation  # noqa: PLC0415 - slow to load

    settings = simulation.SimulationSettings(
        valve, model, excitation, seconds,
        sample_rate=sample_rate, block_rate=block_rate, coulomb_force=coulomb_force, noise=noise,
        filter=filter_, sensors=sensors, oil_temperature=oil_temperature, seed=seed, name=name,
    )  # fmt: skip
    simulation.simulate(out, settings)


COMMAND = Command(simulate, place=300, line="a bag from the simulator, faster than real time")

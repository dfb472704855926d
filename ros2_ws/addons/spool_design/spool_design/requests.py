"""Requests of what-if and plan; their fields are also the options of the commands, with help."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import typer
from spool_report.requests import ExcitationName, ShippedValve, excitation_names, in_range, model_names


@dataclass(frozen=True, slots=True)
class WhatIfRequest:
    """Change and excitation to predict the response for."""

    valve: ShippedValve
    model: Annotated[
        str | None,
        typer.Option(
            help="Model: its name or a YAML file; a file of fit or gap gives intervals. Default: fluid.",
            autocompletion=model_names,
        ),
    ] = None
    spring_stiffness: Annotated[float | None, typer.Option(help="Other springs, N/m, both together.")] = None
    changed: Annotated[
        Sequence[str],
        typer.Option("--set", help="Other value of a parameter, SI units: mass=0.2; repeatable."),
    ] = ()
    oil: Annotated[str | None, typer.Option(help="Other oil by its name, e.g. HL68 or 'ISO VG 46'.")] = None
    oil_temperature: Annotated[float | None, typer.Option(help="Other oil temperature, deg C.")] = None
    mount_frequency: Annotated[
        float | None, typer.Option(help="Natural frequency of an isolating mount of the valve, Hz.")
    ] = None
    mount_damping: Annotated[float | None, typer.Option(help="Damping ratio of that mount.")] = None
    excitation: Annotated[
        str | None,
        typer.Option(
            help="Preset or YAML file of sines or machine orders, in place of the options below.",
            autocompletion=excitation_names,
        ),
    ] = None
    amplitude: Annotated[
        float | None, typer.Option(help="Peak acceleration of the machine, m/s^2; default: 10.")
    ] = None
    frequency_range: Annotated[
        str | None,
        typer.Option(help="Frequencies to show, Hz; default: around the resonances.", metavar="LOW:HIGH"),
    ] = None
    speed_range: Annotated[
        str | None, typer.Option(help="Speeds of engine or pump, rev/min.", metavar="LOW:HIGH")
    ] = None
    orders: Annotated[
        str | None, typer.Option("--order", help="Orders of engine or pump, e.g. 1,2,9.", metavar="N,...")
    ] = None


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """Record that is planned, and what it is to determine."""

    question: Annotated[
        str | None,
        typer.Option(
            help="Question: coulomb_friction, stribeck_friction, mixed_friction, viscous_coefficient, "
            "spring_stiffness, end_stop or which_effect."
        ),
    ] = None
    valve: ShippedValve = "4weh10_soft"
    excitation: ExcitationName = "sweep"
    seconds: Annotated[float, typer.Option(help="Length of the record, s.")] = 40.0
    sample_rate: Annotated[float, typer.Option(help="Sample rate in Hz.")] = 2000.0
    noise: Annotated[
        float, typer.Option(help="Noise of each sensor, rms, m/s^2.", callback=in_range(0.0))
    ] = 0.05
    effect: Annotated[
        Sequence[str],
        typer.Option(help="Effect to try for which_effect; repeatable; default: five common effects."),
    ] = ()
    seed: Annotated[int, typer.Option(help="Seed of the noise.", min=0)] = 0

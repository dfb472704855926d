"""`./spool what-if`: changed conditions against closed forms, intervals against the truth, refusals."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_core.uncertainty import Quantity
from spool_design.requests import WhatIfRequest
from spool_design.what_if import WhatIf, what_if
from spool_report.fit_tables import save_model
from spool_sim.model import load_model
from spool_sim.valve import Valve, find_valve
from spool_tools.cli import main

SOFT = find_valve("4weh10_soft")
NAMES, STD, CORRELATION = (
    ("spring_stiffness", "viscous_coefficient"),
    (40.0, 0.3),
    np.array([[1.0, 0.6], [0.6, 1.0]]),
)


def closed_form(frequency: Array, stiffness: float, damping: float, mass: float = SOFT.moving_mass) -> Array:
    """Return the transmissibility of a linear oscillator, (k + iwc) / (k + iwc - m w^2)."""
    omega = 2.0 * np.pi * frequency
    force = stiffness + 1j * omega * damping
    return np.abs(force / (force - mass * omega**2))


def fitted(path: Path, stiffness: float, damping: float) -> str:
    """Write the model file of a fit with a known uncertainty."""
    values = {"mass": SOFT.moving_mass, NAMES[0]: stiffness, NAMES[1]: damping}
    units = ("N/m", "N s/m")
    quantities = [
        Quantity(name, unit, values[name], std) for name, unit, std in zip(NAMES, units, STD, strict=True)
    ]
    path.unlink(missing_ok=True)
    save_model(path, load_model("fluid"), "fitted", values, quantities, "drawn", (NAMES, CORRELATION))
    return str(path)


@pytest.fixture(name="steps")
def _steps(tmp_path: Path) -> str:
    """Return an excitation of a few frequencies: a whole sweep takes thirty times as long."""
    path = tmp_path / "steps.yaml"
    path.write_text(
        "kind: stepped_sine\nfrequencies: [8, 12, 14, 16, 20, 30]\ndwell: 1\namplitude: 10\n", "utf-8"
    )
    return str(path)


def resonance(found: WhatIf) -> float:
    return found.after.resonances[0].frequency


def test_other_springs_and_another_mass_move_the_resonance_by_the_root() -> None:
    """Where the drag is 5 % of the critical one the peak lies 0.25 % below the natural frequency."""
    stiff = WhatIfRequest("4weh10_soft", spring_stiffness=4 * 1632.0, changed=["viscous_coefficient=3.43"])
    assert resonance(what_if(stiff)) == pytest.approx(2.0 * SOFT.natural_frequency, rel=4e-3)
    heavy = WhatIfRequest("4weh10_soft", changed=["mass=0.72", "viscous_coefficient=3.43"])
    assert resonance(what_if(heavy)) == pytest.approx(0.5 * SOFT.natural_frequency, rel=4e-3)


@pytest.mark.parametrize("damping", [0.05, 0.3])
def test_an_isolating_mount_acts_by_its_closed_form(damping: float, steps: str) -> None:
    mount = {"mount_frequency": 6.0, "mount_damping": damping}
    found = what_if(WhatIfRequest("4weh10_soft", excitation=steps, **mount)).after
    natural = 2.0 * np.pi * 6.0
    isolation = closed_form(found.frequency, natural**2, 2.0 * damping * natural, 1.0)
    valve = closed_form(found.frequency, SOFT.spring_stiffness, SOFT.viscous_coefficient)
    np.testing.assert_allclose(found.amplitude_ratio, isolation * valve, rtol=1e-3)


def test_a_heavy_body_on_its_mount_shakes_the_valve_as_predicted(steps: str) -> None:
    """The second mass as a separate equation, with the spool acting back on it."""
    body, natural, damping = 20.0, 2.0 * np.pi * 6.0, 0.1
    mounted = {"mount_frequency": 6.0, "mount_damping": damping}
    found = what_if(WhatIfRequest("4weh10_soft", excitation=steps, **mounted)).after
    for frequency, ratio in zip(found.frequency, found.amplitude_ratio, strict=True):
        omega = 2.0 * np.pi * frequency
        mount = body * (natural**2 + 2j * damping * natural * omega)
        spring = SOFT.spring_stiffness + 1j * omega * SOFT.viscous_coefficient
        stiffness = np.array([[mount + spring, -spring], [-spring, spring]])
        mass = np.diag([body, SOFT.moving_mass])
        spool = np.linalg.solve(stiffness - omega**2 * mass, np.array([mount, 0.0]))[1]
        assert ratio == pytest.approx(abs(spool), rel=0.05)  # 0.18 kg act back on 20 kg


def test_warmer_oil_damps_by_the_ratio_of_its_viscosities(steps: str) -> None:
    found = what_if(WhatIfRequest("4weh10_soft", oil_temperature=50.0, excitation=steps)).after
    warm = SOFT.at(50.0).viscous_coefficient
    np.testing.assert_allclose(
        found.amplitude_ratio, closed_form(found.frequency, SOFT.spring_stiffness, warm), rtol=1e-3
    )


def test_another_oil_counts_by_the_catalogue_at_its_temperature(steps: str) -> None:
    found = what_if(WhatIfRequest("4weh10_soft", oil="Azolla ZS22", excitation=steps))
    drag = found.changed["viscous_coefficient"]
    assert drag.before is not None
    assert drag.after is not None
    assert 0.2 < drag.after / drag.before < 0.35  # 22 over 68 mm^2/s at 40 deg C, less at 20 deg C


def test_speeds_to_avoid_lie_around_the_resonance_and_margins_at_the_nearest_speed() -> None:
    request = WhatIfRequest("4weh10_soft", speed_range="600:2400", orders="1,2")
    found = what_if(request).before
    first, second = found.resonances
    assert (first.order, first.margin) == (1.0, 0.0)
    assert first.speed == pytest.approx(60.0 * first.frequency)
    assert second.speed is not None
    assert second.margin == pytest.approx((600.0 - second.speed) / 600.0)
    (span,) = [one for one in found.avoid if one.order == 1.0]
    ends = np.array([span.low, span.high]) / 60.0
    np.testing.assert_allclose(
        closed_form(ends, SOFT.spring_stiffness, SOFT.viscous_coefficient), 1.8, rtol=0.01
    )


def test_friction_makes_the_response_depend_on_the_amplitude_and_a_linear_valve_does_not(steps: str) -> None:
    assert what_if(WhatIfRequest("4weh10_soft", "coulomb", excitation=steps)).depends_on_amplitude
    assert not what_if(WhatIfRequest("4weh10_soft", excitation=steps)).depends_on_amplitude


def test_a_stop_leaves_two_motions_and_the_second_is_named() -> None:
    request = WhatIfRequest(
        "4weh10_soft", "fluid_end_stop", changed=["stop_gap=1.5e-3", "stop_stiffness=2e4"], amplitude=20.0
    )
    both = re.compile(r"after the change: between 23\.\d and 28\.\d Hz two motions are possible")
    assert any(map(both.match, what_if(request).notes))


def test_an_interval_reaches_1_96_deviations_either_way(tmp_path: Path, steps: str) -> None:
    """The response changes so little that its deviation follows from that of the numbers linearly."""
    model = fitted(tmp_path / "model.yaml", SOFT.spring_stiffness, SOFT.viscous_coefficient)
    found = what_if(WhatIfRequest("4weh10_soft", model, excitation=steps)).before
    numbers = np.array([SOFT.spring_stiffness, SOFT.viscous_coefficient])
    slopes = [
        (closed_form(found.frequency, *(numbers + step)) - closed_form(found.frequency, *(numbers - step)))
        for step in np.diag(STD) * 0.1
    ] / np.array([[0.2], [0.2]])
    deviation = np.sqrt(np.einsum("if,ij,jf->f", slopes, CORRELATION, slopes))
    widths = (found.high - found.low) / deviation
    assert float(np.mean(widths)) == pytest.approx(2 * 1.96, rel=0.07)  # of 90 %: 2 * 1.64


@pytest.mark.slow
def test_intervals_hold_the_truth_in_95_of_100_drawn_fits(tmp_path: Path) -> None:
    """200 fits drawn around a truth, each with the same uncertainty; today and with other springs."""
    steps = tmp_path / "steps.yaml"
    steps.write_text(
        "kind: stepped_sine\nfrequencies: [8, 12, 14, 16, 20, 27, 30, 40]\ndwell: 1\namplitude: 10\n", "utf-8"
    )
    drawn = np.random.default_rng(7).multivariate_normal(
        (SOFT.spring_stiffness, SOFT.viscous_coefficient), np.outer(STD, STD) * CORRELATION, 200
    )
    frequency = np.array([8.0, 12.0, 14.0, 16.0, 20.0, 27.0, 30.0, 40.0])
    truths = [
        closed_form(frequency, stiffness, SOFT.viscous_coefficient)
        for stiffness in (SOFT.spring_stiffness, 5846.0)
    ]
    held = []
    for stiffness, damping in drawn:
        model = fitted(tmp_path / "model.yaml", float(stiffness), float(damping))
        found = what_if(WhatIfRequest("4weh10_soft", model, spring_stiffness=5846.0, excitation=str(steps)))
        held.append(
            [
                (one.low <= truth) & (truth <= one.high)
                for one, truth in zip((found.before, found.after), truths, strict=True)
            ]
        )
    assert 0.93 <= np.mean(held) <= 0.97


def test_the_command_writes_json_and_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = fitted(tmp_path / "model.yaml", 1632.0, 8.2)
    written, page = tmp_path / "what_if.json", tmp_path / "what_if.html"
    words = [
        "--spring-stiffness",
        "5846",
        "--speed-range",
        "600:2400",
        "--order",
        "1",
        "--valve",
        "4weh10_soft",
    ]
    assert main(["what-if", *words, "--model", model, "--json", str(written), "--report", str(page)]) == 0
    assert "avoid these speeds: order 1: " in capsys.readouterr().out
    after: dict[str, Any] = json.loads(written.read_text("utf-8"))["after"]
    sizes = {len(after[key]) for key in ("frequency_Hz", "amplitude_ratio", "low", "high", "stroke_m")}
    assert len(sizes) == 1
    assert all(
        low < best < high
        for low, best, high in zip(after["low"], after["amplitude_ratio"], after["high"], strict=True)
    )
    assert after["resonances"][0].keys() >= {"frequency_Hz", "order", "speed_rpm", "margin"}
    text = page.read_text("utf-8")
    for label in ("Campbell diagram", "What changes", "Resonances and margins"):
        assert label in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--set", "stop_gap=1e-3"], "stop_gap: unknown parameter of model 'fluid'"),
        (["--set", "mass"], "write it like mass=0.2"),
        (["--spring-stiffness", "0.1"], "spring_stiffness: 0.1 N/m is out of range"),
        (["--oil", "HL86"], "--oil: unknown oil 'HL86'"),
        (["--oil-temperature", "300"], "out of range for HL68"),
        (["--mount-frequency", "6"], "a mount needs both"),
        (["--mount-frequency", "-6", "--mount-damping", "0.1"], "above 0"),
        (["--speed-range", "600:2400"], "one needs the other"),
        (["--speed-range", "2400:600", "--order", "1"], "write LOW:HIGH"),
        (["--speed-range", "600:2400", "--order", "1,x"], "write numbers above 0"),
        (["--excitation", "multisine"], "one sine at a time"),
        (["--excitation", "sweep", "--amplitude", "3"], "leave out --amplitude"),
        (["--amplitude", "0"], "above 0"),
        (["--model", "fluid_damping_drift"], "damping_drift depends on time"),
        (["--model", "fluid_periodic_force"], "periodic_force depends on time"),
        (["--oil-temperature", "50", "--set", "viscous_coefficient=3"], "the oil changes it as well"),
    ],
)
def test_what_cannot_be_predicted_is_refused_in_one_line(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["what-if", "--valve", "4weh10_soft", *words]) == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1


def test_a_valve_without_its_film_is_refused_unless_the_model_states_the_drag(
    tmp_path: Path, steps: str
) -> None:
    short = Valve(id="short", moving_mass=0.18, spring_stiffness=1632.0)
    path = tmp_path / "short.yaml"
    path.write_text("id: short\nmoving_mass: 0.18\nspring_stiffness: 1632.0\n", "utf-8")
    assert main(["what-if", "--valve", str(path)]) == 2
    model = fitted(tmp_path / "model.yaml", short.spring_stiffness, 8.2)
    assert what_if(WhatIfRequest(str(path), model, excitation=steps)).draws > 0


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("{parameters: [mass], std: [1.0], correlation: [[0.5]]}", "symmetric with 1 on its diagonal"),
        ("{parameters: [mass], std: [1.0, 2.0], correlation: [[1.0]]}", "must have 1 rows"),
        ("{parameters: [weight], std: [1.0], correlation: [[1.0]]}", "unknown parameter"),
        (
            "{parameters: [mass, spring_stiffness], std: [1.0, 1.0], correlation: [[1.0, 2.0], [2.0, 1.0]]}",
            "negative eigenvalue",
        ),
    ],
)
def test_an_impossible_uncertainty_of_a_model_file_is_refused(
    block: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(f"name: one\nterms: [inertia, spring, viscous_friction]\nuncertainty: {block}\n", "utf-8")
    assert main(["what-if", "--valve", "4weh10_soft", "--model", str(path)]) == 2
    assert said in capsys.readouterr().err

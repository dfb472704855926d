"""`./spool gap`: records of a driven mass by command, and the model it saves."""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_report.requests import Part, Selection
from spool_rigs.records import force_records
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, half_step_times
from spool_sim.model import MODELS, load_model
from spool_sim.terms import term
from spool_sim.valve import find_valve
from spool_tools.cli import main

SOFT = find_valve("4weh10_soft")
RATE, SUBSTEPS = 1000.0, 8
NAMES = "time_s,displacement_m,force_N"
PLANTS: dict[str, tuple[str, dict[str, float]]] = {
    "coulomb_friction": ("stribeck_friction", {"coulomb_force": 0.5, "static_force": 0.5}),
    "stribeck_friction": ("stribeck_friction", {"coulomb_force": 0.4, "static_force": 0.9}),
    "spring_backlash": ("spring_backlash", {"backlash": 4e-4}),
}


def driven(hidden: str, seconds: float = 15.0) -> tuple[Array, Array, Array]:
    """Return time, displacement and the force that drives the mass of ``SOFT`` with ``hidden`` in it.

    In a body that is accelerated the spool moves as one that -m w'' drives.
    """
    time = half_step_times(0, round(seconds * RATE), RATE, SUBSTEPS)
    draw = np.random.default_rng(1)
    force = np.zeros(time.size)
    for frequency in (0.7, 1.9, 4.3, 7.1, 11.3, 17.9):
        force += draw.uniform(2.0, 4.0) * np.sin(2.0 * np.pi * frequency * time + draw.uniform(0.0, 6.28))
    force *= 0.6 + 0.4 * np.sin(2.0 * np.pi * time / 7.3)
    name, values = PLANTS[hidden]
    motion = ComposedMotion((*MODELS["fluid"].terms, term(name)))
    known = {
        "mass": SOFT.moving_mass,
        "spring_stiffness": 1632.0,
        "viscous_coefficient": 8.0,
        "stribeck_velocity": 0.02,
        "stribeck_exponent": 2.0,
        **values,
    }
    table = motion.table({entry: known[entry] for entry in motion.names}, 1)
    moved, _ = motion.advance(
        MotionState(), -force / SOFT.moving_mass, table, sample_period=1.0 / RATE, substeps=SUBSTEPS
    )
    place = moved.displacement + 1e-6 * draw.standard_normal(moved.displacement.size)
    measured = force[:: 2 * SUBSTEPS][: place.size]
    measured = measured + 0.02 * draw.standard_normal(place.size)
    return np.arange(place.size) / RATE, place, measured


def write(path: Path, *rows: Array, names: str = NAMES) -> Path:
    np.savetxt(path, np.transpose(rows), fmt="%.9g", delimiter=",", header=names, comments="")
    return path


def gap(folder: Path, *arguments: object) -> dict[str, Any]:
    file = folder / "gap.json"
    assert main(["gap", *map(str, arguments), "--json", str(file)]) == 0
    found: dict[str, Any] = json.loads(file.read_text("utf-8"))
    return found


@pytest.fixture(scope="module", name="rubbing")
def _rubbing() -> tuple[Array, Array, Array]:
    return driven("coulomb_friction")


@pytest.mark.slow
@pytest.mark.parametrize("hidden", ["stribeck_friction", "spring_backlash"])
def test_what_a_driven_mass_lacks_is_named_with_its_size(hidden: str, tmp_path: Path) -> None:
    record = write(tmp_path / "rig.csv", *driven(hidden))
    result = gap(tmp_path, record, "--kind", "driven")
    assert result["verdict"] == hidden
    assert result["kind"] == "driven"
    found = {name: value["value"] for name, value in result["effects"][0]["parameters"].items()}
    # The static force acts for a moment only, as the spool breaks away.
    wanted = {name: value for name, value in PLANTS[hidden][1].items() if name != "static_force"}
    assert {name: found[name] for name in wanted} == pytest.approx(wanted, rel=0.03)
    assert result["gap"]["after"]["nrmse"] < 0.4 * result["gap"]["before"]["nrmse"]


def test_a_reader_who_ends_early_has_all_files_with_a_known_mass_and_columns_of_other_names(
    tmp_path: Path, rubbing: tuple[Array, Array, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `| head` does."""
    record = write(tmp_path / "own.csv", *rubbing, names="t,x,f")
    saved, page, result = (tmp_path / name for name in ("found.yaml", "page.html", "gap.json"))
    columns = "time_s=t,displacement_m=x,force_N=f"
    words = ["gap", record, "--kind", "driven", "--columns", columns, "--valve", "4weh10_soft"]
    files = ["--save-model", saved, "--report", page, "--json", result]
    reading, writing = os.pipe()
    os.close(reading)
    with monkeypatch.context() as patch, contextlib.suppress(BrokenPipeError):
        patch.setattr(sys, "stdout", os.fdopen(writing, "w", buffering=1))
        with pytest.raises((BrokenPipeError, SystemExit)):  # rich ends the program
            main([str(word) for word in (*words, *files)])
        sys.stdout.close()
    told = json.loads(result.read_text("utf-8"))
    assert (told["verdict"], told["kind"]) == ("coulomb_friction", "driven")
    assert told["gap"]["after"]["nrmse"] < 0.4 * told["gap"]["before"]["nrmse"]
    text = page.read_text("utf-8")
    assert "coulomb" in text
    evidence = text[text.index("<summary>Evidence</summary>") :]
    # No body is shaken, so there is one picture less.
    assert evidence.count("<h3>") == 3
    assert evidence.count("Left out: a record of force and displacement holds no acceleration") == 1
    assert evidence.count("Left out: ") == 1
    assert "a step of 0.9" in evidence
    assert len(text.encode()) < 2_000_000
    model = load_model(saved)
    assert model.values["mass"] == SOFT.moving_mass
    assert model.values["spring_stiffness"] == pytest.approx(1632.0, rel=0.02)
    assert model.values["coulomb_force"] == pytest.approx(0.5, rel=0.03)


Spoiled = Callable[[Array, Array, Array], tuple[Array, Array]]


def noise(time: Array, place: Array, force: Array) -> tuple[Array, Array]:
    return 1e-6 * np.random.default_rng(0).standard_normal(time.size), force


def imposed(time: Array, place: Array, force: Array) -> tuple[Array, Array]:
    return place, 900.0 * np.gradient(place, time) - 2.0 * np.gradient(np.gradient(place, time), time)


@pytest.mark.parametrize(
    ("spoiled", "words", "said"),
    [
        (
            lambda _, place, force: (1e3 * place, force),
            ["--valve", "4weh10_soft"],
            "is it in mm instead of m",
        ),
        (lambda _, place, force: (0.0 * place, force), [], "displacement_m does not change"),
        (lambda _, place, force: (place, 0.0 * force), [], "force_N does not change"),
        (lambda _, place, force: (place, 1e3 * force), ["--valve", "4weh10_soft"], "description has 0.18 kg"),
        (noise, [], "hardly more than noise"),
        (imposed, [], "--kind imposed"),
    ],
)
def test_a_driven_record_that_cannot_be_is_refused_in_one_line(
    spoiled: Spoiled, words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    rubbing: tuple[Array, Array, Array],
) -> None:  # fmt: skip
    record = write(tmp_path / "rig.csv", rubbing[0], *spoiled(*rubbing))
    assert main(["gap", str(record), "--kind", "driven", *words]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert len(told.splitlines()) == 1


def test_a_model_out_of_its_limits_is_not_saved_and_all_else_is_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A spring that pushes outward, in kN of a press: no model file may state it."""
    time = np.arange(0.0, 12.0, 5e-3)
    place = 0.02 * np.sin(2.0 * np.pi * 0.4 * time) + 0.01 * np.sin(2.0 * np.pi * 1.1 * time)
    speed = np.gradient(place, 5e-3)
    noise = np.random.default_rng(4).standard_normal(time.size)
    record = write(
        tmp_path / "rig.csv", time, place, 3e4 * speed - 4e5 * place + 5e4 * np.sign(speed) + noise
    )
    model, found = tmp_path / "found.yaml", tmp_path / "found.json"
    words = ["gap", str(record), "--kind", "imposed", "--save-model", str(model), "--json", str(found)]
    assert main(words) == 2
    shown = capsys.readouterr()
    assert re.search(r"spring_stiffness: -4\d*e?\+?\d* N/m is out of range, use 1 to", shown.err)
    assert "coulomb friction" in shown.out
    assert not model.exists()
    force = json.loads(found.read_text())["parameters"]["coulomb_force"]
    assert force["value"] == pytest.approx(5e4, rel=0.02)


def test_an_unevenly_sampled_force_record_is_resampled_and_said(
    tmp_path: Path, rubbing: tuple[Array, Array, Array], capsys: pytest.CaptureFixture[str]
) -> None:
    """A program's loop that samples up to a tenth of a step early or late still shows the friction."""
    time, place, force = rubbing
    draw = np.random.default_rng(2)
    late = time + 0.1 / RATE * draw.uniform(-1.0, 1.0, time.size)
    rows = [np.interp(late, time, row) for row in (place, force)]
    record = write(tmp_path / "loop.csv", late, *rows)
    result = gap(tmp_path, record, "--kind", "driven")
    assert "unevenly sampled" in result["warnings"][0]
    assert "resampled" in capsys.readouterr().err
    assert result["verdict"].startswith("coulomb_friction")


@pytest.mark.parametrize("kind", ["driven", "imposed"])
@pytest.mark.parametrize(
    ("still", "name"), [({"force": 0.0}, "force_N"), ({"displacement": 0.0}, "displacement_m")]
)
def test_a_held_out_record_that_does_not_vary_is_refused(
    kind: str, still: dict[str, float], name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time = np.arange(4000) / RATE
    for file, sizes in (("moving.csv", {}), ("held.csv", still)):
        place = sizes.get("displacement", 1e-3) * np.sin(50.0 * time)
        write(tmp_path / file, time, place, 3.0 + sizes.get("force", 5.0) * np.sin(50.0 * time + 0.1))
    words = ["gap", str(tmp_path / "moving.csv"), "--kind", kind, "--holdout", str(tmp_path / "held.csv")]
    assert main(words) == 2
    assert f"held.csv: {name} does not change" in capsys.readouterr().err


def test_a_record_of_forces_takes_units_rate_and_left_out_columns(tmp_path: Path) -> None:
    time = np.arange(400) / 200.0
    place, force = 1e-3 * np.sin(9.0 * time), 40.0 * np.cos(9.0 * time)
    columns = ((time, place, force), (1e3 * time, 1e3 * place, force, 0.5 * time))
    for name, rows in zip(("si.csv", "own.csv"), columns, strict=True):
        head = "time_s,displacement_m,force_N\n" if name == "si.csv" else ""
        (tmp_path / name).write_text(
            head + "\n".join(",".join(f"{x:.9f}" for x in row) for row in np.transpose(rows)), "utf-8"
        )
    (plain,) = force_records([tmp_path / "si.csv"], "imposed", Selection(), [])
    own = "time=#0,displacement=#1,force=#2"
    asked = Part(columns=own, unit=["time=ms,displacement=mm,force=N"], exclude=["#3"]).selection()
    (found,) = force_records([tmp_path / "own.csv"], "imposed", asked, [])
    assert found.period == pytest.approx(plain.period, rel=1e-9)
    np.testing.assert_allclose(found.displacement, plain.displacement, atol=1e-9)
    np.testing.assert_allclose(found.force, plain.force, atol=1e-9)
    units, columns = ["displacement=mm,force=N"], "displacement=#1,force=#2"
    counted = Part(columns=columns, unit=units, rate=200.0, exclude=["#0,#3"]).selection()
    (timed,) = force_records([tmp_path / "own.csv"], "imposed", counted, [])
    assert timed.period == pytest.approx(1.0 / 200.0, rel=1e-9)
    with pytest.raises(InputError, match=r"--rate 500: .* shows 200 Hz"):
        force_records([tmp_path / "si.csv"], "imposed", Part(rate=500.0).selection(), [])

"""FMU of a valve: the motion of ``./spool simulate`` in any simulator, also without Python."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import zipfile
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np
import pytest
import spool
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from numpy.typing import NDArray
from spool_sim.excitation import PRESETS
from spool_sim.integration.composed_motion import half_step_times
from spool_sim.model import FLUID, MODELS
from spool_tools.cli import main

#: Hz of the records that the FMU is compared with, one step a sample.
RATE = 10_000.0
SECONDS = 5.0
VALVE = "4weh10_soft"
#: References of ``sources/unit.h``.
INTERNAL_STEP, OIL_TEMPERATURE, FIRST_PARAMETER = 20, 2, 100
#: Stick-slip, a stop that is hit, and play: term, parameters.
CASES = {
    "stick_slip": ("stribeck_friction", {"coulomb_force": 0.8, "static_force": 1.4}),
    "stop": ("end_stop", {"stop_gap": 2e-4}),
    "play": ("spring_backlash", {"backlash": 2e-4}),
}
CC = shlex.split(os.environ.get("CC", "cc"))


@dataclass(frozen=True)
class Unit:
    """Exported FMU, unpacked."""

    file: Path
    folder: Path
    version: int

    @property
    def library(self) -> Path:
        return next(self.folder.glob("binaries/*/*.*"))

    @property
    def token(self) -> str:
        text = (self.folder / "modelDescription.xml").read_text(encoding="utf-8")
        found = re.search(r'(?:guid|instantiationToken)="(\w+)"', text)
        assert found is not None
        return found[1]


def exported(folder: Path, model: str, version: int) -> Unit:
    """Export a model once for all tests, beside their folders."""
    file = folder.parent / f"unit_{Path(model).stem}_{version}.fmu"
    if not file.exists():
        assert main(["export", VALVE, "--model", model, "--fmu", str(file), "--fmi", str(version)]) == 0
        with zipfile.ZipFile(file) as archive:
            archive.extractall(file.with_suffix(""))
    return Unit(file, file.with_suffix(""), version)


def model_file(folder: Path, name: str) -> str:
    term, values = CASES[name]
    lines = [f"  {key}: {value}  # SI, ± 0.01 (95 %)" for key, value in values.items()]
    path = folder / f"{name}.yaml"
    path.write_text(
        "\n".join([f"name: {name}", f"terms: [{', '.join((*FLUID, term))}]", "parameters:", *lines]),
        encoding="utf-8",
    )
    return str(path)


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Program in C that loads the library of an FMU and runs it."""
    program = tmp_path_factory.mktemp("driver") / "driver"
    source = Path(__file__).parent / "fmu_driver.c"
    subprocess.run([*CC, "-O1", str(source), "-o", str(program), "-ldl", "-lm"], check=True)
    return program


def run(
    driver: Path, unit: Unit, steps: int, shares: int, *, library: Path | None = None, **more: float
) -> NDArray[np.float64]:
    """Return position, velocity, both accelerations, friction, sticking at each communication step."""
    forcing = unit.folder / "forcing"
    PRESETS["steady"].acceleration(half_step_times(0, steps * shares, RATE, 1)).tofile(forcing)
    words = [str(library or unit.library), str(unit.version), unit.token, str(forcing), repr(1.0 / RATE)]
    words += [str(steps), str(shares), str(INTERNAL_STEP), repr(1.0 / RATE)]
    for reference, value in more.items():
        words += [reference.removeprefix("number_"), repr(value)]
    done = subprocess.run([str(driver), *words], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return np.frombuffer(done.stdout).reshape(-1, 6)


def simulated(folder: Path, model: str, *more: str, seconds: float = SECONDS) -> NDArray[np.float64]:
    """Return the spool's acceleration that ``./spool simulate`` records."""
    bag = folder / "bag"
    arguments = ["--valve", VALVE, "--model", model, "--excitation", "steady", "--noise", "0"]
    arguments += ["--sample-rate", str(RATE), "--seconds", str(seconds), "--out", str(bag), *more]
    assert main(["simulate", *arguments]) == 0
    return spool.read(bag).spool


def difference(found: NDArray[np.float64], wanted: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean((found - wanted) ** 2) / np.mean(wanted**2)))


@pytest.mark.parametrize("case", CASES)
def test_the_motion_is_that_of_simulate_at_any_communication_step(
    case: str, tmp_path: Path, driver: Path
) -> None:
    model = model_file(tmp_path, case)
    wanted = simulated(tmp_path, model)
    newer, older = exported(tmp_path, model, 3), exported(tmp_path, model, 2)
    for shares in (1, 10, 100):  # 0.1 to 10 ms; the input within a step by intermediate update
        found = run(driver, newer, wanted.size // shares, shares)
        assert difference(found[:, 3], wanted[::shares]) < 1e-6
    found = run(driver, older, wanted.size, 1)  # the input within a step by its derivatives
    assert difference(found[:, 3], wanted) < 1e-6
    assert found[:, 5].any() == (case == "stick_slip")
    if case != "stick_slip":  # the spool reaches the stop, and crosses the play
        assert np.abs(found[:, 0]).max() > 2e-4
    # Newton's law: friction is what springs and inertia leave.
    assert found[:, 2] == pytest.approx(
        found[:, 3] - PRESETS["steady"].acceleration(np.arange(wanted.size) / RATE)
    )


@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_finds_no_fault_and_runs_it(version: int, tmp_path: Path) -> None:
    for name in ("fluid", "coulomb", "mixed", "microwedge"):
        assert name in MODELS
        assert validate_fmu(str(exported(tmp_path, name, version).file)) == []
    unit = exported(tmp_path, "coulomb", version)
    time = np.arange(0.0, 1.0, 1e-3)
    body = np.array(
        list(zip(time, 10.0 * np.sin(2.0 * np.pi * 20.0 * time), strict=True)),
        dtype=[("time", "f8"), ("body_acceleration", "f8")],
    )
    words = {"input": body, "stop_time": 0.9, "output_interval": 1e-3}
    slips = fmpy.simulate_fmu(str(unit.file), start_values={"coulomb_force": 0.5}, **words)
    sticks = fmpy.simulate_fmu(str(unit.file), start_values={"coulomb_force": 5.0}, **words)
    assert np.abs(slips["spool_position"]).max() > 1e-4
    assert not sticks["spool_position"].any()
    assert sticks["sticking"].all()
    # At rest friction carries the inertia of the spool, 0.18 kg.
    assert sticks["friction_force"] == pytest.approx(-0.18 * sticks["spool_acceleration_absolute"])


def body_sine(frequency: float, stop: float) -> NDArray[np.void]:
    time = np.arange(0.0, stop, 1e-4)
    rows = zip(time, 10.0 * np.sin(2.0 * np.pi * frequency * time), strict=True)
    return np.array(list(rows), dtype=[("time", "f8"), ("body_acceleration", "f8")])


@pytest.mark.parametrize("version", [2, 3])
def test_the_defaults_of_fmpy_are_warned_of_and_the_recommended_step_is_right(
    version: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """FMPy makes steps longer until a run has 1000 points; input held over those is late."""
    unit = exported(tmp_path, "fluid", version)
    experiment = fmpy.read_model_description(str(unit.file)).defaultExperiment
    assert float(experiment.stepSize) == 1e-4
    words = {"input": body_sine(15.0, 5.1), "stop_time": 5.0, "output": ["spool_position"]}
    found, said = {}, {}
    for step in (None, 1e-4, 2e-5):
        capsys.readouterr()
        found[step] = fmpy.simulate_fmu(str(unit.file), output_interval=step, **words)
        said[step] = capsys.readouterr().out
    finest = found[2e-5]
    errors = {
        step: difference(np.interp(found[step]["time"], finest["time"], finest["spool_position"]),
                         found[step]["spool_position"])
        for step in (None, 1e-4)
    }  # fmt: skip
    assert errors[None] > 0.1
    assert said[None].count("held over steps of 0.0064 s") == 1
    assert errors[1e-4] < 0.01
    assert "held over" not in said[1e-4]


def test_friction_spring_and_inertia_balance(tmp_path: Path, driver: Path) -> None:
    found = run(driver, exported(tmp_path, "coulomb", 3), 2000, 10)
    position, acceleration, friction = found[:, 0], found[:, 3], found[:, 4]
    stiffness = spool.valve(VALVE).spring_stiffness
    slips = found[:, 5] == 0.0
    assert slips.any()
    assert (0.18 * acceleration + stiffness * position + friction)[slips] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("version", [2, 3])
def test_built_again_from_its_sources_it_gives_the_same_numbers(
    version: int, tmp_path: Path, driver: Path
) -> None:
    unit = exported(tmp_path, "stribeck", version)
    again = tmp_path / "again.so"
    options = ["-O2", "-ffp-contract=off", "-fPIC", "-shared", "-Wall", "-Wextra", "-Werror", "-Wno-unused"]
    source = unit.folder / "sources" / f"fmi{version}.c"
    subprocess.run([*CC, "-std=c99", *options, str(source), "-o", str(again), "-lm"], check=True)
    assert (run(driver, unit, 5000, 2, library=again) == run(driver, unit, 5000, 2)).all()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may change its root")
def test_it_runs_where_there_is_nothing_but_the_c_library(tmp_path: Path, driver: Path) -> None:
    unit = exported(tmp_path, "coulomb", 3)
    root = tmp_path / "root"
    needed = subprocess.run(
        ["ldd", str(driver), str(unit.library)], capture_output=True, text=True, check=True
    )
    for file in {Path(one) for one in re.findall(r"(/\S+)(?: \(0x)", needed.stdout)}:
        (root / file.parent.relative_to("/")).mkdir(parents=True, exist_ok=True)
        shutil.copy(file, root / file.relative_to("/"))
    shutil.copy(driver, root / "driver")
    shutil.copy(unit.library, root / "unit.so")
    np.zeros(201).tofile(root / "forcing")
    words = ["/driver", "/unit.so", "3", unit.token, "/forcing", "1e-4", "100", "1"]
    done = subprocess.run(["chroot", str(root), *words], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    assert np.frombuffer(done.stdout).size == 600


def test_warm_oil_drags_less_as_in_simulate(tmp_path: Path, driver: Path) -> None:
    wanted = simulated(tmp_path, "fluid", "--oil-temperature", "60", seconds=2.0)
    found = run(driver, exported(tmp_path, "fluid", 3), wanted.size, 1, **{f"number_{OIL_TEMPERATURE}": 60.0})
    assert difference(found[:, 3], wanted) < 1e-6


def test_a_state_that_was_kept_is_taken_up_again(tmp_path: Path) -> None:
    unit = exported(tmp_path, "fluid_presliding_friction", 3)
    slave = FMU3Slave(
        guid=unit.token,
        unzipDirectory=str(unit.folder),
        modelIdentifier=unit.library.stem,
        instanceName="one",
    )
    slave.instantiate()
    slave.enterInitializationMode()
    slave.exitInitializationMode()

    def moved(first: int, last: int) -> float:
        for number in range(first, last):
            slave.setFloat64([1], [10.0 * np.sin(0.2 * number)])
            slave.doStep(number * 1e-3, 1e-3)
        return float(slave.getFloat64([10])[0])

    moved(0, 50)
    state = slave.getFMUState()
    once = moved(50, 100)
    with pytest.raises(FMICallException):  # the valve would move twice
        moved(50, 100)
    slave.setFMUState(state)
    kept = bytearray(slave.serializeFMUState(state))
    assert moved(50, 100) == once
    slave.freeFMUState(state)
    state = slave.deserializeFMUState(bytes(kept))
    slave.setFMUState(state)
    assert moved(50, 100) == once
    for place in (0, len(kept) // 2, len(kept) - 1):
        damaged = bytearray(kept)
        damaged[place] ^= 4
        with pytest.raises(FMICallException):
            slave.deserializeFMUState(bytes(damaged))
    slave.freeFMUState(state)
    slave.terminate()
    slave.freeInstance()


def test_a_number_out_of_range_is_refused_by_name(tmp_path: Path, driver: Path) -> None:
    for version in (2, 3):
        unit = exported(tmp_path, "coulomb", version)
        with pytest.raises(AssertionError, match="coulomb_force: -1 is out of range, use 0 to 1e"):
            run(driver, unit, 10, 1, **{f"number_{FIRST_PARAMETER + 3}": -1.0})


def test_the_description_has_units_and_the_intervals_of_a_fit(tmp_path: Path) -> None:
    model = model_file(tmp_path, "stick_slip")
    file = spool.export_fmu(spool.valve(VALVE), tmp_path / "one.fmu", model=model)
    described = fmpy.read_model_description(str(file))
    found = {one.name: one for one in described.modelVariables}
    assert found["oil_temperature"].unit == "degC"
    assert found["body_acceleration"].unit == "m/s^2"
    assert found["static_force"].description.endswith("; ± 0.01 (95 %)")
    assert float(found["static_force"].start) == 1.4
    outputs = {name for name, one in found.items() if one.causality == "output"}
    motion = {"spool_position", "spool_velocity", "spool_acceleration", "spool_acceleration_absolute"}
    assert outputs == motion | {"friction_force", "sticking"}


def test_a_model_that_states_all_values_needs_no_valve(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "whole.yaml"
    model.write_text(
        "name: whole\nterms: [inertia, spring, viscous_friction]\n"
        "parameters: {mass: 0.2, spring_stiffness: 1500, viscous_coefficient: 4}\n",
        "utf-8",
    )
    assert main(["export", str(model), "--fmu", str(tmp_path / "whole.fmu")]) == 0
    assert "no input oil_temperature, as no oil is named" in capsys.readouterr().out
    names = [one.name for one in fmpy.read_model_description(str(tmp_path / "whole.fmu")).modelVariables]
    assert "oil_temperature" not in names


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["coulomb", "--fmu", "x.fmu"], "mass, spring_stiffness, viscous_coefficient: not stated"),
        ([VALVE, "--fmu", "x.zip"], "an FMU is a file .fmu"),
        ([VALVE, "--fmu", "x.fmu", "--fmi", "1"], "use 2 or 3"),
        ([VALVE, "--fmu", "x.fmu", "--since", "1m"], "leave them out"),
        ([VALVE], "pass --out FILE"),
        (["bag", "--out", "x.csv", "--fmi", "2"], "go with --fmu"),
        (["coulomb", "--model", "mixed", "--fmu", "x.fmu"], "name a valve in its place"),
        (["nothing", "--fmu", "x.fmu"], "no such valve file"),
    ],
)
def test_what_cannot_be_exported_is_one_line(
    words: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", *words]) == 2
    text = capsys.readouterr().err
    assert said in text
    assert text.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_without_a_compiler_the_error_names_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["export", VALVE, "--fmu", str(tmp_path / "x.fmu")]) == 2
    assert "install a C compiler" in capsys.readouterr().err

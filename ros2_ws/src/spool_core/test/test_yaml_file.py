"""A YAML file costs no more than its size, whatever it holds."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_core.files import LARGEST, YamlError, load_yaml, read_yaml
from spool_core.system import expanded

#: Each of 9 lists holds the one before nine times: 3.5e8 values in some 300 bytes.
BILLION_LAUGHS = 'a0: &a0 [x,x,x,x,x,x,x,x,x]\n' + "".join(
    f"a{n}: &a{n} [{','.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 9)
)  # fmt: skip


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (BILLION_LAUGHS, "line 2: aliases"),
        ("a: &a {<<: *a}", "aliases"),
        ("[" * 20_000, "nested deeper than 32"),
        ("- " * 20_000 + "x", "nested deeper than 32"),
        ("{a: " * 20_000, "nested deeper than 32"),
        ("- 1\n" * 60_000, "line 50000: it has more than 50000 values"),
        ("a: " + "x" * LARGEST, "more than 1000000 characters"),
        ("a: 2020-99-99", "a value can't be read"),
        ("a: !!int ''", "a value can't be read"),
        ("a: !!python/object/apply:os.system [ls]", "could not determine a constructor"),
        ("a: 1\nb: {c: [{a: 1, a: 2}]}", r"duplicate key 'a' \(again in line 2\)"),
        ("a: [", r"not valid YAML in line \d"),
        ("\x00", "not valid YAML"),
    ],
)
def test_what_would_end_the_process_is_refused_in_one_line(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text, "utf-8")
    with pytest.raises(InputError, match=reason) as caught:
        read_yaml(path, "valve")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400 + len(str(path))


VALVE = "id: a\nmoving_mass: 0.18\nspring_stiffness: 1632.0\n"
PARAMETERS = "/**/monitor:\n  ros__parameters:\n    coulomb_change: 0.2\n"
NESTED = "press:\n  left:\n    monitor:\n      ros__parameters: {coulomb_change: 0.2}\n"
VALVES = "- namespace: valve_1\n  valve_file: 4weh10_soft\n"


@pytest.mark.parametrize(
    ("held", "reason"),
    [
        (None, "No such file or directory"),
        (b"a: \xff\xfe", "is not UTF-8 text"),
        ("folder", "Is a directory"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused_with_the_reason(
    tmp_path: Path, held: bytes | str | None, reason: str
) -> None:
    path = tmp_path / "a.yaml"
    if isinstance(held, bytes):
        path.write_bytes(held)
    elif held is not None:
        path.mkdir()
    with pytest.raises(InputError, match=rf"a\.yaml: cannot read the valve file: {reason}"):
        read_yaml(path, "valve")


@pytest.mark.parametrize(
    ("text", "what", "reason"),
    [
        (PARAMETERS, "valve", "this is a parameter file of nodes: pass it as --params-file "),
        (NESTED, "valve", "this is a parameter file of nodes"),
        (VALVES, "valve", "this is a list of valves: pass it as valves_file:="),
        (
            VALVE,
            "parameters",
            "this is a valve description: pass it as --valve to commands, as -p valve_file:=",
        ),
        ("moving_mas: 0.18\nland_length: 0.03", "excitation", "this is a valve description"),
        (VALVE, "valves", "this is a valve description"),
        (PARAMETERS, "valves", "this is a parameter file of nodes"),
    ],
)
def test_a_file_given_in_place_of_another_is_recognised(
    tmp_path: Path, text: str, what: str, reason: str
) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text, "utf-8")
    with pytest.raises(InputError) as caught:
        read_yaml(path, what)
    assert str(caught.value).startswith(f"{path}: {reason}")


@pytest.mark.parametrize(
    ("text", "what"), [(VALVE, "valve"), (NESTED, "parameters"), (VALVES, "valves"), ("a: 1", "valve")]
)
def test_the_right_file_and_one_of_no_known_kind_are_read(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text, "utf-8")
    assert read_yaml(path, what) == load_yaml(text)


@settings(max_examples=150, deadline=None)
@example("? [a]\n: 1")
@example("!!timestamp x")
@example("!!bool x")
@given(st.text(alphabet=st.sampled_from("ab01:-[]{}#&*!|>'\"%@,?<=. \n\t\x1b\x00é\ud800"), max_size=60))
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    try:
        load_yaml(text)
        refused = ""
    except YamlError as error:
        refused = str(error)
    assert "\n" not in refused
    assert len(refused) < 300


def test_the_home_folder_is_meant_by_its_sign_in_any_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "mine.yaml").write_text("a: 1", "utf-8")
    assert read_yaml("~/mine.yaml", "valve") == {"a": 1}
    assert expanded("~/bags/~one") == tmp_path / "bags/~one"
    assert str(expanded("~nobody_of_that_name/x")) == "~nobody_of_that_name/x"

"""A user's YAML file costs no more than its size, whatever it holds."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from spool_sim.files.yaml_file import LARGEST, read_yaml
from spool_sim.valve.description import load_valve
from spool_stream.errors import InputError

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
        ("- 1\n" * 60_000, "more than 50000 values"),
        ("a: " + "x" * LARGEST, "more than 1000000 characters"),
        ("a: 2020-99-99", "a value can't be read"),
        ("a: !!int ''", "a value can't be read"),
        ("a: !!python/object/apply:os.system [ls]", "could not determine a constructor"),
        ("{a: 1, a: 2}", "key 'a' stands twice"),
    ],
)
def test_what_would_end_the_process_is_refused_in_one_line(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=reason) as caught:
        read_yaml(path, "valve")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


@settings(max_examples=150, deadline=None)
@example("? [a]\n: 1")
@example("!!timestamp x")
@example("!!bool x")
@given(st.text(alphabet=st.sampled_from("ab01:-[]{}#&*!|>'\"%@,?<=. \n\t\x1b\x00é"), max_size=60))
def test_any_text_is_read_or_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.mktemp("yaml") / "a.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:  # none of them describes a valve
        load_valve(path)
    assert "\n" not in str(caught.value)


def test_a_long_list_of_faults_is_cut(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("id: " + "x" * 10_000 + "\n" + "".join(f"key_{n}: 1\n" for n in range(1000)))
    with pytest.raises(InputError, match=r"and 9\d\d more") as caught:
        load_valve(path)
    assert len(str(caught.value)) < 5000

"""YAML files: what was written is read to the last bit, and hostile files are refused at once."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from graspcascade.core import yaml_files as module
from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.machine import child_environment
from graspcascade.core.yaml_files import dump_yaml, load_yaml, yaml_files

BILLION_LAUGHS = "a: &a [x, x]\n" + "".join(
    f"{name}: &{name} [*{before}, *{before}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)

numbers = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**63), 2**63) | st.booleans() | st.none()
names = st.text(st.characters(exclude_categories=["C"]), max_size=12)
plain = st.recursive(
    numbers | names, lambda part: st.lists(part, max_size=4) | st.dictionaries(names, part, max_size=4), max_leaves=12
)


@pytest.fixture(params=["libyaml", "python"])
def parser(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read with each of PyYAML's parsers."""
    if request.param == "libyaml" and not yaml.__with_libyaml__:
        pytest.skip("PyYAML was built without libyaml")
    monkeypatch.setattr(yaml, "__with_libyaml__", request.param == "libyaml")


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "file.yaml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(plain)
def test_plain_data_is_read_as_it_was_written(tmp_path: Path, data: object) -> None:
    path = tmp_path / "data.yaml"
    dump_yaml(path, {"data": data}, "two\nlines")
    assert load_yaml(path) == {"data": data}
    assert path.read_text(encoding="utf-8").startswith("# two\n# lines\n")


def test_equal_parts_are_written_in_full(tmp_path: Path) -> None:
    part = [1.0, 2.0]
    dump_yaml(tmp_path / "data.yaml", {"a": part, "b": part}, "")
    assert load_yaml(tmp_path / "data.yaml") == {"a": part, "b": part}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a: &x [1]\nb: *x\n", r"YAML references \(& and \*\)"),
        ("a: &x 1\n", "YAML references"),
        ("&x a: 1\n", "YAML references"),
        (BILLION_LAUGHS, "YAML references"),
        ("&a [*a]", "YAML references"),
        ("base: {a: 1}\nb:\n  <<: {c: 2}\n", r"YAML merge key \(<<\)"),
        ("a: !!python/object/apply:os.system [echo]\n", "the YAML tag 'tag:yaml.org,2002:python/object/apply"),
        ('a: !!int ""\n', "the YAML tag 'tag:yaml.org,2002:int'"),
        ("a: !!binary aGk=\n", "the YAML tag"),
        ("a: !mine 1\n", "the YAML tag '!mine'"),
        ("a: !!bool x\n", "the YAML tag"),
        ("a: !!timestamp x\n", "the YAML tag"),
        ("a: ! 1\n", "the YAML tag '!'"),
        ("a: !mine%0Aand%0Amore 1\n", "the YAML tag"),
        ("[" * 50_000 + "]" * 50_000, "line 1: nested deeper than the 40 levels"),
        ("a: " + "{b: " * 5_000 + "1" + "}" * 5_000, "nested deeper than the 40 levels"),
        ("\n".join(" " * depth + "a:" for depth in range(1_000)), "line 41: nested deeper than the 40 levels"),
        ("- " * 50_000, "nested deeper than the 40 levels"),
        ("? " * 50_000, "used as a key|nested deeper"),
        ("a: x" + "1" * 200_000, "longer than the 100000 bytes"),
        ("a" * 200_000 + ": 1", "longer than the 100000 bytes|not plain YAML"),
        ("a: 1\nb: " + "1" * 5_000, "line 2: a number longer than the 400 characters"),
        ("a: 0x" + "f" * 50_000, "a number longer than the 400 characters"),
        ("a: " + "1:" * 40_000 + "1", "a number longer than the 400 characters"),
        ("a: " + "1:" * 190 + "1.5", "line 1: not plain YAML .*too large"),
        ("a: 0b_\n", "line 1: not plain YAML"),
        ("a: [1, 2", "line [12]: not plain YAML"),
        ("a: 1\n---\nb: 2\n", "line 2: a second document begins"),
        ("a: 1\nb: 2\na: 3\n", "line 3: the key 'a' is twice in one mapping"),
        ("a: {b: 1, b: 1}\n", "line 1: the key 'b' is twice in one mapping"),
        ("? [a]\n: 1\n", "line 1: a list or mapping is used as a key"),
        ("{{a: 1}: 1}\n", "line 1: a list or mapping is used as a key"),
        (b"a: \xff\xfe\n", "not plain YAML"),
        (b"\x00\x01\x02", "not plain YAML"),
        ('a: "\\uD800"\n', "not plain YAML"),
        ('a: "\\UFFFFFFFF"\n', "not plain YAML"),
        ("%TAG ! tag:x\n%TAG ! tag:x\n--- a\n", "not plain YAML"),
    ],
)
@pytest.mark.usefixtures("parser")
def test_a_file_that_is_no_plain_data_is_refused_at_once_in_one_line(
    tmp_path: Path, text: str | bytes, says: str
) -> None:
    start = time.process_time()
    with pytest.raises(FileFormatError, match=says) as caught:
        load_yaml(written(tmp_path, text))
    assert time.process_time() - start < 2
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 400


ATTACKS = (
    "[" * 50_000 + "]" * 50_000,
    "{a: " * 50_000,
    "- " * 50_000,
    "? " * 50_000,
    "\n".join(" " * depth + "a:" for depth in range(5_000)),
    "[[1]," * 30_000,
    "a: &a [x, x]\n" + "".join(f"b{i}: &b{i} [*a, *a]\n" for i in range(50)),
    "a0: &a0 {k: 1}\n" + "".join(f"a{i + 1}: &a{i + 1} {{<<: [*a{i}, *a{i}]}}\n" for i in range(50)),
    '!!int ""',
    "!!bool x",
    "!!timestamp x",
    "a: '" + "x" * 1_000_000 + "'",
    "a: " + "1:" * 400_000 + "1",
)
READ_ALL = """
import resource, sys
from pathlib import Path
from graspcascade.core.errors import FileFormatError
from graspcascade.core.yaml_files import load_yaml

resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30))
resource.setrlimit(resource.RLIMIT_CPU, (30, 30))
for path in sorted(Path(sys.argv[1]).iterdir()):
    try:
        load_yaml(path)
    except FileFormatError as error:
        print(path.name, error, flush=True)
"""


def test_no_file_brings_the_interpreter_down(tmp_path: Path) -> None:
    for number, text in enumerate(ATTACKS):
        (tmp_path / f"{number:02}.yaml").write_text(text)
    command = [sys.executable, "-c", READ_ALL, str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, env=child_environment(), check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert [line.split(".")[0] for line in ended.stdout.splitlines()] == [f"{i:02}" for i in range(len(ATTACKS))]


def test_keys_that_are_chosen_to_collide_take_no_longer_than_others(tmp_path: Path) -> None:
    modulus = sys.hash_info.modulus  # whole numbers this far apart have one hash
    path = written(tmp_path, "".join(f"{number * modulus}: 1\n" for number in range(50_000)))
    start = time.process_time()
    assert len(load_yaml(path)) == 50_000
    assert time.process_time() - start < 5


@pytest.mark.usefixtures("parser")
def test_keys_and_dates_are_text_and_words_without_quotes_are_values(tmp_path: Path) -> None:
    text = "1: 2001-99-99\nyes: yes\nnull: ~\n2001-01-01: 1.5\n'on': 0x10\n\"=\": =\nlist: [-1, 1_000, .5, 1e3, '1']\n"
    assert load_yaml(written(tmp_path, text)) == {
        "1": "2001-99-99",
        "yes": True,
        "null": None,
        "2001-01-01": 1.5,
        "on": 16,
        "=": "=",
        "list": [-1, 1000, 0.5, "1e3", "1"],
    }


@pytest.mark.usefixtures("parser")
def test_a_file_with_nothing_in_it_is_nothing(tmp_path: Path) -> None:
    for text in ("", "# a comment\n", "---\n", "~\n"):
        assert load_yaml(written(tmp_path, text)) is None


@pytest.mark.usefixtures("parser")
def test_a_string_that_looks_like_a_merge_key_or_reference_is_read_where_it_is_quoted(tmp_path: Path) -> None:
    assert load_yaml(written(tmp_path, 'a: "<<"\nb: "*x"\nc: "&x"\n')) == {"a": "<<", "b": "*x", "c": "&x"}


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MAX_BYTES", 1_000_000)
    with pytest.raises(FileFormatError, match="larger than the 1 MB allowed"):
        load_yaml(written(tmp_path, "a: 1\n" * 300_000))
    monkeypatch.setattr(module, "_MAX_PARTS", 100)
    with pytest.raises(FileFormatError, match="line 100: more than the 100 parts allowed"):
        load_yaml(written(tmp_path, "- 1\n" * 200))


def test_a_file_that_is_absent_is_refused(tmp_path: Path) -> None:
    for absent in (tmp_path / "absent.yaml", tmp_path):
        with pytest.raises(InputError, match="there is no file"):
            load_yaml(absent)


def test_yaml_files_of_a_folder_are_listed_by_name(tmp_path: Path) -> None:
    for name in ("b.yaml", "a.YML", "c.json"):
        (tmp_path / name).touch()
    assert [path.name for path in yaml_files(tmp_path)] == ["a.YML", "b.yaml"]

"""Damaged and hostile hand files and YAML grasps: read, or refused in one line, whatever was changed in them."""

import copy
import random
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from graspcascade.core.grasps import Grasps
from graspcascade.core.machine import child_environment
from graspcascade.core.yaml_files import load_yaml
from graspcascade.formats import save_grasps
from graspcascade.hands.hand_file import shipped_hands

MUTANTS = 150
VALUES: tuple[Any, ...] = (
    None, True, "", "x" * 5_000, "\0", "../../etc/passwd", 0, -1, 2**31, 2**64, 10**399, 0.5, -0.0, 1e-320, 1e308,
    float("nan"), float("inf"), [], {}, [[]], [None], {"": None}, ["x"] * 3, [0.0] * 3, [1e308] * 4, list(range(50)),
)  # fmt: skip
SNIPPETS = (
    b"\0", b"\xff\xfe", b"\t", b"\n", b": ", b"- ", b"'", b'"', b"{", b"]", b"|\n", b"? ", b"#", b"\\", b'"\\uD800"',
    b"[" * 2_000, b"{a: " * 50, b"- " * 50, b"&x ", b"*x", b"<<: ", b"!!int ", b"!!python/name:os.system ", b"---\n",
    b"...\n", b"%YAML 9.9\n", b"1:" * 2_000, b"9" * 5_000, b"e999", b".nan", b".inf", b"1" * 200_000,
    "\N{PILE OF POO}\u202e\u0085".encode(),
)  # fmt: skip
READ_ALL = """
import resource, sys
from pathlib import Path
from graspcascade.core.errors import InputError
from graspcascade.formats import load_document
from graspcascade.hands import load_hand

load_hand("shadow")
resource.setrlimit(resource.RLIMIT_AS, (2**32, 2**32))
resource.setrlimit(resource.RLIMIT_CPU, (120, 120))
for path in sorted(Path(sys.argv[2]).glob("mutant*.yaml")):
    try:
        {"load_hand": load_hand, "load_document": load_document}[sys.argv[1]](path)
        print(path.name, "read", flush=True)
    except InputError as error:
        assert len(str(error).splitlines()) == 1 and len(str(error)) < 2_000, (path.name, str(error))
        print(path.name, "refused", flush=True)
    except BaseException as error:
        raise SystemExit(f"{path.name}: {type(error).__name__}: {error}") from error
"""


def leaves(data: Any) -> Iterator[tuple[Any, Any]]:
    """List every place in nested lists and mappings, as the collection and the key or index in it."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ():
        yield data, key
        yield from leaves(value)


def changed_values(path: Path, rng: random.Random) -> bytes:
    """Put values of other types and sizes into some places of a file, or leave these out."""
    data = load_yaml(path)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        inside, key = rng.choice(list(leaves(data)))
        if rng.random() < 0.2:
            del inside[key]
        elif isinstance(inside, dict) and rng.random() < 0.1:
            inside[rng.choice(("", "x", "name", "1"))] = inside.pop(key)
        else:
            inside[key] = copy.deepcopy(rng.choice(VALUES))
        if not data:
            break
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True).encode()


def changed_bytes(path: Path, rng: random.Random) -> bytes:
    """Flip, cut, insert, repeat or leave out bytes of a file."""
    content = path.read_bytes()
    for _ in range(rng.choice((1, 1, 2, 8))):
        at, to = sorted(rng.randrange(len(content) + 1) for _ in range(2))
        to = min(to, at + 200)
        piece = rng.choice(SNIPPETS)
        changes = (
            content[:at] + bytes([rng.randrange(256)]) + content[at + 1 :],
            content[:at],
            content[:at] + content[to:],
            content[:to] + content[at:],
            content[:at] + piece + content[at:],
            content[:at] + piece + content[to:],
        )
        content = rng.choice(changes)
    return content


def check_mutants(reader: str, source: Path, folder: Path) -> list[str]:
    rng = random.Random(18)
    for number in range(MUTANTS):
        change = (changed_values, changed_bytes)[number % 2]
        (folder / f"mutant_{number:04}.yaml").write_bytes(change(source, rng))
    command = [sys.executable, "-c", READ_ALL, reader, str(folder)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=300, env=child_environment(), check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    return [line.split()[1] for line in ended.stdout.splitlines()]


def test_a_mutated_hand_file_is_read_or_refused_in_one_line(tmp_path: Path) -> None:
    source = shipped_hands()["shadow"]
    shutil.copy(source.with_name("shadow_hand.xml"), tmp_path)
    said = check_mutants("load_hand", source, tmp_path)
    assert len(said) == MUTANTS
    assert said.count("refused") > MUTANTS / 2


@pytest.mark.parametrize("name", ["isaac_grasp", "moveit_grasp"])
def test_mutated_grasps_are_read_or_refused_in_one_line(name: str, drawn: Grasps, tmp_path: Path) -> None:
    source, folder = tmp_path / "grasps.yaml", tmp_path / "mutants"
    folder.mkdir()
    one_object = drawn[[0, 9]] if name == "isaac_grasp" else drawn[[0, 10]]
    save_grasps(source, one_object, metadata={"by": "test"}, format=name)
    said = check_mutants("load_document", source, folder)
    assert len(said) == MUTANTS
    assert said.count("refused") > MUTANTS / 4

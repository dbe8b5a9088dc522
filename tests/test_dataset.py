"""The dataset: plain shards, honest metadata, collection that can be cut off anywhere."""

import hashlib
import json
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import graspcascade.studies.collect  # noqa: F401  the module, which the package hides behind the function
from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.families import FAMILIES, ObjectFamily, read_objects
from graspcascade.core.files import LOCK_FILE, sole_writer
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE, Box, GraspObject, as_object
from graspcascade.core.outcomes import VERDICTS, Outcomes
from graspcascade.core.protocols import VARIED, Protocol
from graspcascade.core.tasks import Tasks, draw_tasks
from graspcascade.core.taxonomy import DIGITS, GRASP_TYPES
from graspcascade.engines import run_trials
from graspcascade.engines.mujoco.creep import FAST_FORWARD
from graspcascade.engines.mujoco.runner import MujocoEngine
from graspcascade.hands import Hand
from graspcascade.proposals.heuristic import SPREAD, Heuristic, Placement, cannot_touch
from graspcascade.proposals.prior import PosturePrior
from graspcascade.studies.collect import CollectionSpec, CollectionState
from graspcascade.studies.dataset import SCHEMA_VERSION, from_columns, load_dataset, to_columns

module = sys.modules["graspcascade.studies.collect"]
FEW_NAMES = (
    ("box_small", "tripod"),
    ("cylinder_medium", "parallel_extension"),
    ("sphere_small", "tip_pinch"),
    ("sphere_large", "palmar_pinch"),
)
FEW_CELLS = tuple((as_object(obj), GRASP_TYPES[kind]) for obj, kind in FEW_NAMES)
SPEC = CollectionSpec(trials_per_cell=6, round_per_cell=3, seed=11)
SHARDS = ("part-00000.parquet", "part-00001.parquet")


class CutOffError(Exception):
    """Stand for whatever cuts a collection off."""


def collect(*args: Any, **options: Any) -> CollectionState:
    return module.collect(*args, **{"cells": FEW_CELLS, **options})


@pytest.fixture(scope="module")
def heuristic(hand: Hand, prior: PosturePrior) -> Heuristic:
    return Heuristic(hand, prior)


@pytest.fixture(scope="module")
def collection(heuristic: Heuristic, short: Protocol, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Collect two rounds without interruption."""
    folder = tmp_path_factory.mktemp("collection") / "data"
    collect(heuristic, SPEC, folder, protocol=short)
    return folder


@pytest.fixture
def copy(collection: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(collection, tmp_path / "copy"))


def metadata_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "metadata.json").read_text()))


def write_metadata(folder: Path, metadata: dict[str, Any]) -> None:
    (folder / "metadata.json").write_text(json.dumps(metadata))


def contents(folder: Path) -> dict[str, bytes]:
    """Read every file, the metadata without what it took to collect, which no two collections share."""
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    if b'"effort"' in files.get("metadata.json", b""):
        metadata = metadata_of(folder)
        del metadata["effort"]
        files["metadata.json"] = json.dumps(metadata).encode()
    return files


# What is written


def test_metadata_says_what_each_shard_took(collection: Path) -> None:
    effort = metadata_of(collection)["effort"]
    assert set(effort) == set(SHARDS)
    for spent in effort.values():
        assert spent["seconds"] > 0.0
        assert spent["peak_rss_mb"] > 10.0


def test_a_collection_is_shards_and_a_metadata_file_and_nothing_else(collection: Path) -> None:
    assert {path.name for path in collection.iterdir()} == {*SHARDS, "metadata.json"}


def test_shards_are_plain_tables_with_joints_by_name(collection: Path, hand: Hand) -> None:
    for name in SHARDS:
        table = pq.read_table(collection / name)
        assert table.num_rows == 12
        for prefix in ("posture", "settled"):
            assert {f"{prefix}_{joint}" for joint in hand.joint_names} <= set(table.column_names)
        for touch in (*hand.digits, "palm"):
            assert table.schema.field(f"touch_end_{touch}").type == pa.bool_()
        for digit in hand.digits:
            assert table.schema.field(f"areas_end_{digit}").type == pa.uint16()
        for field in table.schema:
            label = pa.types.is_dictionary(field.type) and field.type.value_type == pa.string()
            assert label or field.type in (pa.bool_(), pa.float32(), pa.uint16()), field


def test_a_shards_values_are_those_of_its_names(collection: Path) -> None:
    rows = pa.concat_tables(
        [pq.read_table(collection / name) for name in SHARDS], promote_options="default"
    ).to_pylist()
    dataset = load_dataset(collection)
    for i, row in enumerate(rows):
        posture = dataset.grasps.posture_by_name()
        assert row["posture_THJ4"] == posture["THJ4"][i]
        assert (row["object_label"], row["grasp_type"]) in FEW_NAMES
        assert row["verdict"] in VERDICTS
        assert row["held"] == (row["verdict"] == "held")
        assert row["faithful"] == dataset.outcomes.faithful(dataset.grasps)[i]
        assert row["object_x_m"] == dataset.grasps.X_hand_object.position_m[i, 0]
        for when, column in (("closed", dataset.outcomes.areas_closed), ("end", dataset.outcomes.areas_end)):
            assert [row[f"areas_{when}_{digit}"] for digit in DIGITS] == column[i].tolist()
        assert row["side_m"] == pytest.approx(CATALOGUE[row["object_label"]].sides_m[row["side_axis"]])


def test_metadata_says_what_the_rows_rest_on(
    collection: Path, hand: Hand, prior: PosturePrior, short: Protocol
) -> None:
    metadata = metadata_of(collection)
    assert metadata["schema_version"] == SCHEMA_VERSION
    assert metadata["hand"] == hand.name
    assert metadata["joint_names"] == list(hand.joint_names)
    assert metadata["pregrasp_rad"] == hand.pregrasp.tolist()
    assert metadata["prior"] == prior.fingerprint()
    assert metadata["protocol"] == short.to_json()
    assert metadata["seed"] == SPEC.seed
    assert metadata["collection"]["trials_per_cell"] == 6
    assert {"graspcascade", "mujoco", "numpy", "python"} <= set(metadata["versions"])
    sizes = {
        name: {"shape": o.shape.kind, "extents_m": list(o.extents_m)}
        for name, o in CATALOGUE.items()
        if name in dict(FEW_NAMES)
    }
    assert metadata["objects"] == sizes
    assert metadata["digits"] == ["thumb", "index", "middle", "ring", "little"]
    assert [shard["file"] for shard in metadata["shards"]] == list(SHARDS)
    for shard in metadata["shards"]:
        assert shard["sha256"] == hashlib.sha256((collection / shard["file"]).read_bytes()).hexdigest()
        assert shard["rows"] == pq.read_metadata(collection / shard["file"]).num_rows


def test_counts_are_those_of_the_rows(collection: Path) -> None:
    dataset, counts = load_dataset(collection), metadata_of(collection)["counts"]
    held, faithful = dataset.outcomes.held, dataset.outcomes.faithful(dataset.grasps)
    assert (counts["trials"], counts["held"], counts["faithful"]) == (24, held.sum(), faithful.sum())
    assert counts["screened_out"] == sum(shard["screened_out"] for shard in dataset.metadata["shards"])
    for cell in counts["cells"]:
        rows = (dataset.grasps.object_name == cell["object"]) & (dataset.grasps.grasp_type == cell["grasp_type"])
        counted = (rows.sum(), held[rows].sum(), faithful[rows].sum())
        assert (cell["trials"], cell["held"], cell["faithful"]) == counted


def test_successes_and_failures_are_kept_alike_and_no_hopeless_candidate_is_tried(collection: Path, hand: Hand) -> None:
    dataset = load_dataset(collection)
    assert 0 < dataset.outcomes.held.sum() < len(dataset.outcomes)
    assert not cannot_touch(hand, dataset.grasps).any()


# Round trip


def test_a_loaded_dataset_equals_what_was_collected(
    heuristic: Heuristic, short: Protocol, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[tuple[Grasps, Outcomes]] = []
    write_round = module.write_round

    def keep(folder: Path, number: int, grasps: Grasps, outcomes: Outcomes, *rest: Any) -> Any:
        written.append((grasps, outcomes))
        return write_round(folder, number, grasps, outcomes, *rest)

    monkeypatch.setattr(module, "write_round", keep)
    collect(heuristic, SPEC, tmp_path / "data", protocol=short)
    dataset = load_dataset(tmp_path / "data")
    assert dataset.grasps.joint_names == heuristic.hand.joint_names
    joined = Grasps.concatenate([g for g, _ in written])
    assert dataset.grasps.tasks.same_as(joined.tasks)
    grasps = joined.columns()
    outcomes = Outcomes.concatenate([o for _, o in written]).columns()
    grasps["object_size_m"] = outcomes["object_size_m"]  # what the trial measured
    assert_equal_in_single_precision(dataset.grasps.columns(), grasps)
    assert_equal_in_single_precision(dataset.outcomes.columns(), outcomes)


def assert_equal_in_single_precision(read: dict[str, Any], expected: dict[str, Any]) -> None:
    assert set(read) == set(expected)
    for name, column in expected.items():
        if column.dtype.kind == "f":
            np.testing.assert_allclose(read[name], column, rtol=1e-6, atol=1e-7, err_msg=name)
        else:
            np.testing.assert_array_equal(read[name], column, err_msg=name)


# Going on


def test_what_was_drawn_for_each_trial_is_recorded_with_it(
    heuristic: Heuristic, short: Protocol, tmp_path: Path
) -> None:
    varied = replace(short, name="varied", variation=VARIED.variation)
    collect(heuristic, SPEC, tmp_path / "one", protocol=varied)
    dataset = load_dataset(tmp_path / "one")
    assert dataset.conditions is not None
    assert len(dataset.conditions) == len(dataset.grasps)
    assert len(np.unique(dataset.conditions.friction)) == len(dataset.grasps)
    assert Protocol.from_json(dataset.metadata["protocol"]) == varied
    again = run_trials(dataset.grasps, short, hand=heuristic.hand, conditions=dataset.conditions)
    agree = again.verdict == dataset.outcomes.verdict
    assert agree.mean() > 0.9  # rows are kept in single precision
    collect(heuristic, SPEC, tmp_path / "two", protocol=varied, workers=2)
    for shard in SHARDS:
        assert (tmp_path / "one" / shard).read_bytes() == (tmp_path / "two" / shard).read_bytes()


def test_a_dataset_of_like_trials_has_no_conditions(collection: Path) -> None:
    assert load_dataset(collection).conditions is None


def test_a_finished_collection_is_left_as_it_is(copy: Path, heuristic: Heuristic, short: Protocol) -> None:
    before = contents(copy)
    state = collect(heuristic, SPEC, copy, protocol=short)
    assert state.rounds == 2
    assert state.trials.tolist() == [6, 6, 6, 6]
    assert contents(copy) == before


def test_a_collection_that_lost_its_last_round_writes_it_again(
    copy: Path, collection: Path, heuristic: Heuristic, short: Protocol
) -> None:
    metadata = metadata_of(copy)
    metadata["shards"].pop()
    write_metadata(copy, metadata)
    (copy / SHARDS[1]).unlink()
    collect(heuristic, SPEC, copy, protocol=short, engine=MujocoEngine(1, creep=FAST_FORWARD))
    assert contents(copy) == contents(collection)


def test_a_collection_cut_off_between_rounds_goes_on_as_if_nothing_had_happened(
    collection: Path, heuristic: Heuristic, short: Protocol, tmp_path: Path
) -> None:
    def stop(state: Any) -> None:
        if state.rounds == 1:
            raise CutOffError

    with pytest.raises(CutOffError):
        collect(heuristic, SPEC, tmp_path / "data", protocol=short, progress=stop)
    assert set(contents(tmp_path / "data")) == {SHARDS[0], "metadata.json"}
    collect(heuristic, SPEC, tmp_path / "data", protocol=short)
    assert contents(tmp_path / "data") == contents(collection)


@pytest.mark.parametrize("step", ["try_round", "write_round", "write_metadata"])
def test_a_collection_cut_off_within_a_round_goes_on_as_if_nothing_had_happened(
    collection: Path,
    heuristic: Heuristic,
    short: Protocol,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    step: str,
) -> None:
    whole, calls = getattr(module, step), []

    def cut_off(*args: Any, **options: Any) -> Any:
        calls.append(step)
        if len(calls) == 2:
            raise CutOffError
        return whole(*args, **options)

    monkeypatch.setattr(module, step, cut_off)
    with pytest.raises(CutOffError):
        collect(heuristic, SPEC, tmp_path / "data", protocol=short)
    monkeypatch.setattr(module, step, whole)
    collect(heuristic, SPEC, tmp_path / "data", protocol=short)
    assert contents(tmp_path / "data") == contents(collection)


@pytest.mark.parametrize(
    ("how", "lost", "less"),
    [("missing", SHARDS[:1], 0), ("missing", SHARDS[1:], 3), ("truncated", SHARDS[1:], 0), ("another", SHARDS, 0)],
)
def test_lost_shards_are_collected_again_and_the_others_kept(
    copy: Path,
    collection: Path,
    heuristic: Heuristic,
    short: Protocol,
    how: str,
    lost: tuple[str, ...],
    less: int,
) -> None:
    for name in lost:
        content = (copy / name).read_bytes()
        (copy / name).unlink()
        if how != "missing":
            (copy / name).write_bytes(content[:100] if how == "truncated" else content[::-1])
    written = {name: (copy / name).stat().st_mtime_ns for name in set(SHARDS) - set(lost)}
    states: list[Any] = []
    spec = replace(SPEC, trials_per_cell=SPEC.trials_per_cell - less)
    end = collect(heuristic, spec, copy, protocol=short, progress=states.append)
    assert states[0].lost == lost
    assert states[0].trials.tolist() == [3 * (2 - len(lost))] * 4
    assert not end.lost
    assert len(load_dataset(copy).grasps) == 24
    assert {name: (copy / name).stat().st_mtime_ns for name in written} == written
    for name in SHARDS:
        assert (copy / name).read_bytes() == (collection / name).read_bytes()
    assert less or contents(copy) == contents(collection)


def test_a_lost_shard_gets_the_cells_that_it_had(heuristic: Heuristic, short: Protocol, tmp_path: Path) -> None:
    """Later rounds draw few cells; asked for more, they would draw others."""
    spec = CollectionSpec(trials_per_cell=0, successes_per_cell=2, most_trials_per_cell=8, round_per_cell=1, seed=3)
    state = collect(heuristic, spec, tmp_path / "data", protocol=short)
    last = tmp_path / "data" / f"part-{state.rounds - 1:05d}.parquet"
    before = last.read_bytes()
    assert 0 < len(pq.read_table(last)) < len(FEW_CELLS)
    last.unlink()
    collect(heuristic, replace(spec, successes_per_cell=4), tmp_path / "data", protocol=short)
    assert last.read_bytes() == before


def test_nobody_else_collects_into_a_folder_in_the_meantime(
    collection: Path, heuristic: Heuristic, short: Protocol, tmp_path: Path
) -> None:
    refused: list[str] = []

    def meddle(state: Any) -> None:
        with pytest.raises(InputError, match="another process is writing to"):
            collect(heuristic, SPEC, tmp_path / "data", protocol=short)
        refused.append(state.rounds)

    collect(heuristic, SPEC, tmp_path / "data", protocol=short, progress=meddle)
    assert refused == [0, 1, 2]
    assert contents(tmp_path / "data") == contents(collection)
    with sole_writer(collection):
        assert len(load_dataset(collection).grasps) == 24  # reading is free


def test_the_lock_of_a_crashed_collection_is_no_hindrance(
    collection: Path, heuristic: Heuristic, short: Protocol, tmp_path: Path
) -> None:
    (tmp_path / LOCK_FILE).touch()
    collect(heuristic, SPEC, tmp_path, protocol=short)
    assert contents(tmp_path) == contents(collection)
    (tmp_path / LOCK_FILE).touch()
    assert len(load_dataset(tmp_path).grasps) == 24


def test_what_a_killed_collection_left_is_no_hindrance(
    collection: Path, heuristic: Heuristic, short: Protocol, tmp_path: Path
) -> None:
    (tmp_path / ".metadata.json.4711.staged").write_text("{")
    collect(heuristic, SPEC, tmp_path, protocol=short)
    assert contents(tmp_path) == contents(collection)


def test_more_may_be_asked_of_a_collection(copy: Path, collection: Path, heuristic: Heuristic, short: Protocol) -> None:
    state = collect(heuristic, replace(SPEC, trials_per_cell=7), copy, protocol=short)
    assert state.rounds == 3
    assert (copy / SHARDS[0]).read_bytes() == (collection / SHARDS[0]).read_bytes()
    assert len(load_dataset(copy).grasps) == 36
    before, now = metadata_of(collection), metadata_of(copy)
    assert "asked_before" not in before
    assert now["asked_before"] == [{"rounds": 2, "collection": before["collection"]}]
    collect(heuristic, replace(SPEC, trials_per_cell=7), copy, protocol=short)
    assert metadata_of(copy) == now


def test_what_holds_too_rarely_is_told_while_it_is_waited_for() -> None:
    trials, held = np.full(54, 1000), np.full(54, 49)
    held[:3] = 50, 60, 1000
    spec = CollectionSpec(trials_per_cell=0, successes_per_cell=60)
    rare = CollectionState(5, trials, held, held).rare
    assert rare(spec).tolist() == list(range(3, 54))
    assert not rare(replace(spec, successes_per_cell=49)).size
    assert not rare(replace(spec, most_trials_per_cell=1000)).size
    assert not rare(replace(spec, trials_per_cell=2000, successes_per_cell=0)).size
    assert not CollectionState(4, trials - 1, held, held).rare(spec).size


def test_only_unfinished_cells_are_drawn(heuristic: Heuristic, short: Protocol, tmp_path: Path) -> None:
    spec = CollectionSpec(trials_per_cell=0, successes_per_cell=1, round_per_cell=2, seed=3)
    states: list[Any] = []
    end = collect(heuristic, spec, tmp_path / "data", protocol=short, progress=states.append)
    assert (end.held >= 1).all()
    for before, after in pairwise(states):
        drawn = after.trials > before.trials
        np.testing.assert_array_equal(drawn, before.held < 1)


def test_a_cell_that_never_holds_is_given_up(heuristic: Heuristic, short: Protocol, tmp_path: Path) -> None:
    spec = CollectionSpec(trials_per_cell=0, successes_per_cell=50, most_trials_per_cell=5, round_per_cell=2, seed=3)
    end = collect(heuristic, spec, tmp_path / "data", protocol=short)
    np.testing.assert_array_equal(end.trials, 6)
    assert end.short(spec).size == len(FEW_CELLS)
    assert not end.unfinished(spec).size


def test_the_numbers_of_processes_and_threads_change_no_byte(
    collection: Path, heuristic: Heuristic, short: Protocol, tmp_path: Path
) -> None:
    for name, threads, workers in (("a", 2, 1), ("b", 0, 2)):
        engine = MujocoEngine(threads, creep=FAST_FORWARD)
        collect(heuristic, SPEC, tmp_path / name, protocol=short, engine=engine, workers=workers)
        assert contents(tmp_path / name) == contents(collection)


# Objects


def test_objects_are_those_that_the_dataset_describes(copy: Path) -> None:
    metadata = metadata_of(copy)
    metadata["objects"]["box_small"]["density_kg_m3"] = 250.0
    write_metadata(copy, metadata)
    objects = load_dataset(copy).grasps.tasks.objects
    assert objects["box_small"] == replace(CATALOGUE["box_small"], density_kg_m3=250.0)
    assert objects["sphere_small"] == CATALOGUE["sphere_small"]
    metadata["objects"]["sphere_small"]["extents_m"] = [0.021, 0.021, 0.021]
    write_metadata(copy, metadata)
    with pytest.raises(FileFormatError, match=r"m wide, but side x of sphere_small is 0\.021 m"):
        load_dataset(copy)


def test_extents_of_the_dataset_win_over_those_of_the_catalogue(
    heuristic: Heuristic, short: Protocol, tmp_path: Path
) -> None:
    other = GraspObject("box_medium", Box(0.021, 0.033, 0.05))
    collect(heuristic, SPEC, tmp_path, protocol=short, cells=((other, GRASP_TYPES["tripod"]),))
    tasks = load_dataset(tmp_path).grasps.tasks
    assert tasks.objects == {"box_medium": other}
    assert set(tasks.side_m) <= set(other.sides_m.values())


def test_a_dataset_of_a_hand_with_four_digits_has_their_touch_columns(
    cut_hands: Mapping[int, Hand], prior: PosturePrior, short: Protocol, tmp_path: Path
) -> None:
    collect(Heuristic(cut_hands[4], prior), SPEC, tmp_path, protocol=short, cells=FEW_CELLS[:1])
    digits = ("thumb", "index", "middle", "ring")
    assert tuple(metadata_of(tmp_path)["digits"]) == digits
    names = pq.read_schema(tmp_path / SHARDS[0]).names
    for when in ("closed", "end"):
        touch = [name for name in names if name.startswith(f"touch_{when}_")]
        assert touch == [f"touch_{when}_{place}" for place in (*digits, "palm")]
    outcomes = load_dataset(tmp_path).outcomes
    assert outcomes.touch_columns == (*digits, "palm")
    assert outcomes.touching_closed.shape == (len(outcomes), 5)


def test_a_dataset_may_be_of_objects_that_the_catalogue_lacks(
    heuristic: Heuristic, short: Protocol, tmp_path: Path
) -> None:
    brick = GraspObject("brick", Box(0.02, 0.04, 0.03), density_kg_m3=1100.0)
    cells = ((brick, GRASP_TYPES["tripod"]), (as_object("sphere:31mm"), GRASP_TYPES["tripod"]))
    collect(heuristic, SPEC, tmp_path, protocol=short, cells=cells)
    grasps = Grasps.concatenate([module.draw_round(heuristic, range(2), n, SPEC, cells)[0] for n in range(2)])
    assert load_dataset(tmp_path).grasps.tasks.same_as(grasps.tasks)
    metadata = metadata_of(tmp_path)
    assert metadata["cells"] == [["brick", "tripod"], ["sphere:31mm", "tripod"]]
    assert [cell["trials"] for cell in metadata["counts"]["cells"]] == [6, 6]
    with pytest.raises(InputError, match="rounds with another objects, cells"):
        collect(heuristic, SPEC, tmp_path, protocol=short, cells=cells[:1])
    del metadata["objects"]["sphere:31mm"]  # whose name says its size
    write_metadata(tmp_path, metadata)
    assert load_dataset(tmp_path).grasps.tasks.same_as(grasps.tasks)
    del metadata["objects"]["brick"]
    write_metadata(tmp_path, metadata)
    with pytest.raises(FileFormatError, match="unknown object 'brick'"):
        load_dataset(tmp_path)


# Objects of random size

FAMILY_NAMES = (("any:box", "tripod"), ("any:sphere", "tip_pinch"), ("box_small", "tripod"))
FAMILY_CELLS = tuple((*read_objects(obj), GRASP_TYPES[kind]) for obj, kind in FAMILY_NAMES)
Going = tuple[Path, Callable[..., CollectionState]]


@pytest.fixture(scope="module")
def of_families(heuristic: Heuristic, short: Protocol, tmp_path_factory: pytest.TempPathFactory) -> Going:
    """Collect two rounds of families under varied conditions and spread placements, and say how to go on."""
    folder = tmp_path_factory.mktemp("families") / "data"
    protocol = replace(short, name="varied", variation=VARIED.variation)
    spread = replace(heuristic, placement=SPREAD)

    def go_on(folder: Path, proposal: Heuristic = spread, **options: Any) -> CollectionState:
        return collect(proposal, SPEC, folder, **{"protocol": protocol, "cells": FAMILY_CELLS, **options})

    go_on(folder)
    return folder, go_on


def test_each_trial_of_a_family_has_an_object_and_conditions_of_its_own(of_families: Going) -> None:
    dataset = load_dataset(of_families[0])
    shapes = np.array([task.object.shape.kind for task in dataset.grasps.tasks])
    names = dataset.grasps.object_name
    assert len(set(names[shapes == "sphere"].tolist())) == (shapes == "sphere").sum() == 6
    assert set(dataset.grasps.grasp_type[shapes == "sphere"]) == {"tip_pinch"}
    assert (names == "box_small").sum() == 6
    assert dataset.conditions is not None
    assert len(np.unique(dataset.conditions.friction)) == len(dataset.grasps) == 18


def test_screening_prefers_no_size(hand: Hand, heuristic: Heuristic) -> None:
    # Were the object drawn again with a posture that cannot touch it, small ones would be tried less often.
    spec, cells = replace(SPEC, round_per_cell=400), FAMILY_CELLS[:2]
    grasps, skipped = module.draw_round(heuristic, range(2), 0, spec, cells)
    rngs = [np.random.default_rng([spec.seed, 0, number]) for number in range(2)]
    asked = [draw_tasks([cell], 400, hand.reach_m, rng) for cell, rng in zip(cells, rngs, strict=True)]
    assert grasps.tasks.same_as(Tasks.concatenate(asked))
    assert not cannot_touch(hand, grasps).any()
    # About as many postures are too wide for their side as are not.
    assert 400 < skipped < 1600


def test_counts_are_by_family(of_families: Going) -> None:
    counts, dataset = metadata_of(of_families[0])["counts"]["cells"], load_dataset(of_families[0])
    assert [(cell["object"], cell["grasp_type"]) for cell in counts] == list(FAMILY_NAMES)
    names = dataset.grasps.object_name
    is_sphere = np.char.startswith(names, "sphere:")
    for cell, rows in zip(counts, (~is_sphere & (names != "box_small"), is_sphere, names == "box_small"), strict=True):
        assert (cell["trials"], cell["held"]) == (6, dataset.outcomes.held[rows].sum())


def test_metadata_says_what_was_drawn_from(of_families: Going) -> None:
    metadata = metadata_of(of_families[0])
    assert list(metadata["objects"]) == ["box_small"]
    assert metadata["families"] == {name: FAMILIES[name].to_json() for name in ("any:box", "any:sphere")}
    assert metadata["families"]["any:sphere"] == {"shape": "sphere", "ranges_m": [[0.02, 0.065]], "widest_m": 0.065}
    assert metadata["placement"] == {"offset_share": 1 / 3, "tilt_rad": pytest.approx(np.pi / 12)}
    assert metadata["cells"] == [list(pair) for pair in FAMILY_NAMES]


def test_a_collection_as_usual_says_nothing_of_families_and_placements(collection: Path) -> None:
    assert not {"families", "placement"} & set(metadata_of(collection))


def test_a_collection_of_families_goes_on_with_the_same_rows_in_any_number_of_processes(
    of_families: Going, tmp_path: Path
) -> None:
    folder, go_on = of_families

    def stop(state: CollectionState) -> None:
        if state.rounds == 1:
            raise CutOffError

    with pytest.raises(CutOffError):
        go_on(tmp_path / "data", progress=stop)
    go_on(tmp_path / "data", workers=2)
    assert contents(tmp_path / "data") == contents(folder)


def test_other_families_and_placements_are_refused_either_way_round(
    of_families: Going, copy: Path, heuristic: Heuristic, short: Protocol
) -> None:
    folder, go_on = of_families
    smaller = ObjectFamily("any:box", Box, ((0.02, 0.03),) * 3)
    for options, words in (
        ({"proposal": heuristic}, "placement"),
        ({"proposal": replace(heuristic, placement=Placement(0.1, 0.1))}, "placement"),
        ({"cells": ((smaller, GRASP_TYPES["tripod"]), *FAMILY_CELLS[1:])}, "families"),
        ({"cells": FAMILY_CELLS[:2]}, "objects, cells"),
    ):
        with pytest.raises(InputError, match=f"holds rounds with another {words};"):
            go_on(folder, **options)
    with pytest.raises(InputError, match="holds rounds with another placement;"):
        collect(replace(heuristic, placement=SPREAD), SPEC, copy, protocol=short)


def test_a_collection_of_one_type_is_not_gone_on_with_for_all(
    heuristic: Heuristic, short: Protocol, tmp_path: Path
) -> None:
    spec = CollectionSpec(trials_per_cell=1, round_per_cell=1)
    collect(heuristic, spec, tmp_path, protocol=short, cells=[(obj, "tripod") for obj in CATALOGUE])
    with pytest.raises(InputError, match="holds rounds with another cells"):
        module.collect(heuristic, spec, tmp_path, protocol=short)


# Refusals


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seed": -1}, "seed must not be negative, got -1"),
        ({"trials_per_cell": -2}, "trials_per_cell must not be negative, got -2"),
        ({"successes_per_cell": -3}, "successes_per_cell must not be negative, got -3"),
        ({"most_trials_per_cell": -4}, "most_trials_per_cell must not be negative, got -4"),
        ({"round_per_cell": 0}, "round_per_cell must be at least 1, got 0"),
        ({"trials_per_cell": 0}, "nothing to collect"),
    ],
)
def test_numbers_that_ask_for_no_collection_are_refused(change: dict[str, int], words: str) -> None:
    with pytest.raises(InputError, match=words):
        replace(SPEC, **change)


@pytest.mark.parametrize("changed", ["seed", "round_per_cell", "protocol", "prior", "hand"])
def test_other_arguments_than_the_collections_own_are_refused_and_nothing_is_lost(
    copy: Path, heuristic: Heuristic, short: Protocol, changed: str
) -> None:
    spec, protocol = SPEC, short
    if changed in ("seed", "round_per_cell"):
        spec = replace(SPEC, **{changed: 5})
    elif changed == "protocol":
        protocol = short.with_physics("short", friction=0.6)
    elif changed == "hand":
        heuristic = replace(heuristic, hand=replace(heuristic.hand, name="another"))
    else:
        metadata = metadata_of(copy)
        write_metadata(copy, metadata | {"prior": "0" * 16})
    before = contents(copy)
    with pytest.raises(InputError, match=f"rounds with another {changed.replace('_', ' ')}"):
        collect(heuristic, spec, copy, protocol=protocol)
    assert contents(copy) == before


class OpenHand:
    """Decode every type to the flat hand, whose opposing places are farther apart than any side is wide."""

    def sample(self, codes: np.ndarray, _: np.random.Generator) -> np.ndarray:
        return np.zeros((len(codes), 22))


def test_a_cell_that_cannot_touch_is_given_up_by_its_name(hand: Hand, prior: PosturePrior) -> None:
    open_hand = Heuristic(hand, replace(prior, decoder=OpenHand()))
    spec = CollectionSpec(trials_per_cell=1, round_per_cell=1)
    with pytest.raises(InputError, match=r"only 0 of 1000 tripod candidates for box_small .* give a prior"):
        module.draw_round(open_hand, range(2), 0, spec, FEW_CELLS)
    with pytest.raises(InputError, match=r"only 0 of 1000 tripod candidates for any:box .* give a prior"):
        module.draw_round(open_hand, range(1), 0, spec, FAMILY_CELLS)


def test_refused_cells_do_not_bind_the_folder(heuristic: Heuristic, short: Protocol, tmp_path: Path) -> None:
    wide = ((as_object("sphere:80mm"), GRASP_TYPES["tripod"]),)
    with pytest.raises(InputError, match="no side of sphere:80mm"):
        collect(heuristic, SPEC, tmp_path, protocol=short, cells=wide)
    assert not list(tmp_path.iterdir())
    assert collect(heuristic, SPEC, tmp_path, protocol=short, cells=FEW_CELLS[:1]).rounds == 2
    before = contents(tmp_path)
    with pytest.raises(InputError, match="rounds with another"):
        collect(heuristic, SPEC, tmp_path, protocol=short, cells=wide)
    assert contents(tmp_path) == before


def test_a_folder_that_holds_something_else_is_refused(heuristic: Heuristic, short: Protocol, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds no collection"):
        collect(heuristic, SPEC, tmp_path, protocol=short)
    assert contents(tmp_path) == {"notes.txt": b"mine"}
    with pytest.raises(FileFormatError, match=r"no metadata\.json"):
        load_dataset(tmp_path)
    with pytest.raises(FileFormatError, match=r"no metadata\.json"):
        load_dataset(tmp_path / "absent")


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '"text"', '{"schema_version": 1}', '{"schema_version": 999}'])
def test_metadata_that_is_no_metadata_is_refused(
    heuristic: Heuristic, short: Protocol, tmp_path: Path, text: str
) -> None:
    (tmp_path / "metadata.json").write_text(text)
    with pytest.raises(FileFormatError, match=r"metadata\.json"):
        load_dataset(tmp_path)
    with pytest.raises(FileFormatError, match=r"metadata\.json"):
        collect(heuristic, SPEC, tmp_path, protocol=short)
    assert contents(tmp_path) == {"metadata.json": text.encode()}


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda d: d["shards"].append(d["shards"][0]), "twice in shards"),
        (lambda d: d["shards"][0].update(file="../part-00000.parquet"), "file"),
        (lambda d: d["shards"][0].pop("sha256"), "sha256"),
        (lambda d: d.update(shards=[1]), "shards"),
        (lambda d: d.update(joint_names=[]), "joint_names"),
        (lambda d: d.update(joint_names=None), "joint_names"),
        (lambda d: d["joint_names"].pop(), "pregrasp_rad"),
        (lambda d: d["joint_names"].append(d["joint_names"][0]), "twice in joint_names"),
        (lambda d: d.update(hand=3), "hand"),
        (lambda d: d.pop("protocol"), "protocol"),
    ],
)
def test_doctored_metadata_is_refused(
    copy: Path, heuristic: Heuristic, short: Protocol, change: Callable[[Any], Any], word: str
) -> None:
    metadata = metadata_of(copy)
    change(metadata)
    write_metadata(copy, metadata)
    for read in (load_dataset, lambda folder: collect(heuristic, SPEC, folder, protocol=short)):
        with pytest.raises(FileFormatError, match=rf"metadata\.json .*{word}"):
            read(copy)


@pytest.mark.parametrize(
    "change", [{"held": [9] * 4}, {"trials": [3] * 3}, {"faithful": [-1] * 4}, {"screened_out": "x"}]
)
def test_doctored_counts_of_a_collection_are_refused(
    copy: Path, heuristic: Heuristic, short: Protocol, change: dict[str, Any]
) -> None:
    metadata = metadata_of(copy)
    metadata["shards"][0] |= change
    write_metadata(copy, metadata)
    with pytest.raises(FileFormatError, match=r"metadata\.json"):
        collect(heuristic, SPEC, copy, protocol=short)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("verdict", "fine"),
        ("verdict", "missed"),
        ("posture_THJ4", np.nan),
        ("object_y_m", 40.0),
        ("object_z_m", np.nan),
        ("object_qw", 2.0),
        ("areas_end_thumb", 2**13),
        ("areas_closed_little", 1),
    ],
)
def test_values_that_no_trial_gives_are_refused_by_their_column(
    collection: Path, short: Protocol, column: str, value: Any
) -> None:
    data = load_dataset(collection)
    columns = to_columns(data.grasps, data.outcomes)
    held = int(np.flatnonzero(columns["held"])[0])
    columns[column] = columns[column].copy()
    columns[column][held] = value
    with pytest.raises(FileFormatError, match=f"column '{'held' if value == 'missed' else column}'"):
        from_columns(columns, data.metadata)


def test_a_refused_collection_leaves_no_new_folder(heuristic: Heuristic, tmp_path: Path) -> None:
    wide = (GraspObject("wall", Box(0.5, 0.5, 0.5)), GRASP_TYPES["tripod"])
    with pytest.raises(InputError, match="reach"):
        collect(heuristic, SPEC, tmp_path / "new", protocol="paper", cells=[wide])
    assert contents(tmp_path) == {}
    assert not (tmp_path / "new").exists()


def test_a_dataset_without_shards_is_refused(copy: Path) -> None:
    write_metadata(copy, metadata_of(copy) | {"shards": []})
    with pytest.raises(InputError, match="holds no shards yet"):
        load_dataset(copy)


@pytest.mark.parametrize("keep", [0, 4, 1000, -1])
def test_a_truncated_shard_is_refused_by_its_name(copy: Path, keep: int) -> None:
    shard = copy / SHARDS[1]
    shard.write_bytes(shard.read_bytes()[:keep])
    with pytest.raises(FileFormatError, match=SHARDS[1]):
        load_dataset(copy)


def test_an_absent_shard_is_refused_by_its_name(copy: Path) -> None:
    (copy / SHARDS[0]).unlink()
    with pytest.raises(FileFormatError, match=SHARDS[0]):
        load_dataset(copy)


def test_a_readable_shard_of_another_collection_is_refused(copy: Path) -> None:
    shutil.copy(copy / SHARDS[0], copy / SHARDS[1])
    with pytest.raises(FileFormatError, match="checksum"):
        load_dataset(copy)


def test_each_shard_is_read_once(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read_bytes = Path.read_bytes

    def read_and_remove(path: Path) -> bytes:
        content = read_bytes(path)
        path.unlink()
        return content

    monkeypatch.setattr(Path, "read_bytes", read_and_remove)
    assert len(load_dataset(copy).grasps) == 24
    assert not any((copy / name).exists() for name in SHARDS)


def drop_column(folder: Path, *names: str) -> None:
    metadata = metadata_of(folder)
    for shard in metadata["shards"]:
        path = folder / shard["file"]
        pq.write_table(pq.read_table(path).drop_columns(list(names)), path)
        shard["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    write_metadata(folder, metadata)


def test_turns_that_an_earlier_version_did_not_record_are_unknown(copy: Path) -> None:
    drop_column(copy, "turn_rad")
    dataset = load_dataset(copy)
    assert np.isnan(dataset.outcomes.turn_rad).all()
    assert dataset.outcomes.held.any()


def test_areas_that_an_earlier_version_did_not_record_are_none(copy: Path) -> None:
    drop_column(copy, *(f"areas_{when}_{digit}" for when in ("closed", "end") for digit in DIGITS))
    dataset = load_dataset(copy)
    assert dataset.outcomes.areas_end.shape == (24, 5)
    assert not dataset.outcomes.areas_closed.any()
    assert not dataset.outcomes.areas_end.any()
    assert dataset.outcomes.faithful(dataset.grasps).any(), "the paper's types do not ask for areas"


def test_a_shard_without_the_areas_of_one_digit_is_refused(copy: Path) -> None:
    drop_column(copy, "areas_end_middle")
    with pytest.raises(FileFormatError, match="lacks column 'areas_end_middle'"):
        load_dataset(copy)


def test_a_shard_without_a_column_is_refused_by_the_columns_name(copy: Path) -> None:
    drop_column(copy, "posture_THJ4")
    with pytest.raises(FileFormatError, match="lacks column 'posture_THJ4'"):
        load_dataset(copy)


@pytest.mark.parametrize(
    "wrong",
    [
        {"trials_per_cell": -1},
        {"successes_per_cell": -1},
        {"round_per_cell": 0},
        {"most_trials_per_cell": -1},
        {"trials_per_cell": 0, "successes_per_cell": 0},
    ],
)
def test_a_collection_of_nothing_is_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(InputError):
        CollectionSpec(**wrong)

"""Tables of plain scalars: what is spread over columns is put together again, by one naming wherever it is stored."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade.core.grasps import Grasps
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.poses import Pose, canonical_quat
from graspcascade.core.records import gather, gather_pose, spread, spread_pose
from graspcascade.formats import save_grasps
from graspcascade.studies.dataset import to_columns


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 5))
def test_spread_columns_gather_again_to_the_last_bit(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    names, values = ("THJ4", "FFJ1", "WRJ1"), rng.normal(size=(n, 3))
    pose = Pose(rng.normal(size=(n, 3)), canonical_quat(rng.normal(size=(n, 4))))
    columns = spread("posture", names, values) | spread_pose("object", pose)
    assert all(column.shape == (n,) for column in columns.values())
    np.testing.assert_array_equal(gather(columns, "posture", names), values)
    np.testing.assert_array_equal(gather(columns, "posture", names[::-1]), values[:, ::-1])
    gathered = gather_pose(columns, "object")
    np.testing.assert_array_equal(gathered.position_m, pose.position_m)
    np.testing.assert_array_equal(gathered.quat_wxyz, pose.quat_wxyz)


def test_columns_are_named_by_what_they_hold() -> None:
    columns = spread_pose("object", Pose(np.array([[1.0, 2.0, 3.0]]), np.array([[0.5, -0.5, 0.25, 0.75]])))
    assert {name: column.tolist() for name, column in columns.items()} == {
        "object_x_m": [1.0],
        "object_y_m": [2.0],
        "object_z_m": [3.0],
        "object_qw": [0.5],
        "object_qx": [-0.5],
        "object_qy": [0.25],
        "object_qz": [0.75],
    }
    with pytest.raises(KeyError, match="posture_THJ4"):
        gather(columns, "posture", ("THJ4",))


def test_datasets_and_grasp_files_name_their_columns_alike(drawn: Grasps, outcomes: Outcomes, tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    save_grasps(tmp_path / "g.parquet", drawn, metadata={})
    in_file, in_dataset = set(pq.read_table(tmp_path / "g.parquet").column_names), set(to_columns(drawn, outcomes))
    own = {"probability", *(f"pregrasp_{name}" for name in drawn.joint_names)}
    assert in_file - in_dataset == own

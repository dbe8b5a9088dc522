"""What one browser looks at: sampling, flipping, trying, wording, packing; no browser needed."""

import io
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from graspcascade.cascade import GraspSampler
from graspcascade.errors import InputError
from graspcascade.formats import FORMATS_BY_NAME, load_grasps, save_grasps
from graspcascade.grasps import Grasps
from graspcascade.hands import HandModel
from graspcascade.trials import PAPER, VERDICTS, Outcomes, Protocol
from graspcascade.viewer import Batch, SampleRequest, Session, file_batch, sample_batch, with_friction
from graspcascade.viewer.downloads import pack
from graspcascade.viewer.tables import MEANING, grasp_html, message_html, rate_text, table_html


@pytest.fixture(scope="module")
def sampler() -> GraspSampler:
    return GraspSampler.pretrained()


@pytest.fixture
def session(drawn: Grasps, short: Protocol) -> Session:
    return Session(Batch(drawn[[0, 10, 20, 30]], "some", {"source": "test"}), short)


@pytest.fixture
def overlapping(drawn: Grasps) -> Grasps:
    inside = drawn[[0]]  # a list of rows copies: the shared grasps stay as they are
    inside.X_hand_object.position_m[:] = [0.01, 0.0, 0.05]
    return inside


def test_samples_are_the_samplers(sampler: GraspSampler) -> None:
    batch = sample_batch(sampler, SampleRequest("tip_pinch", "sphere_small", "x", 3, 5))
    np.testing.assert_array_equal(batch.grasps.posture, sampler.sample("tip_pinch", "sphere_small", "x", 3, 5).posture)
    assert batch.name == "tip_pinch_sphere_small_x_seed5"
    assert batch.metadata["asked"] == {
        "grasp_type": "tip_pinch",
        "object_label": "sphere_small",
        "side_axis": "x",
        "n": 3,
        "seed": 5,
    }


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (SampleRequest(n=0), "n must be between 1 and 200, got 0"),
        (SampleRequest(n=10**18), "n must be between 1 and 200"),
        (SampleRequest(seed=-1), "seed must be between 0 and"),
        (SampleRequest(grasp_type="tripood"), "Did you mean 'tripod'"),
        (SampleRequest(object_label="cylinder_large", side_axis="z"), "beyond the hand's reach"),
    ],
)
def test_bad_requests_are_refused_in_words(sampler: GraspSampler, request_: SampleRequest, words: str) -> None:
    with pytest.raises(InputError, match=words):
        sample_batch(sampler, request_)


def test_another_friction_is_another_protocol_by_name() -> None:
    assert with_friction(0.8) is PAPER
    assert with_friction(0.6) == replace(PAPER, name="paper, friction 0.6", friction=0.6)
    for bad in (0.0, -1.0, 5.1, float("nan"), float("inf")):
        with pytest.raises(InputError, match="friction must be between"):
            with_friction(bad)


def test_behind_the_last_grasp_comes_the_first(session: Session) -> None:
    session.go(4)
    assert session.index == 0
    session.go(-1)
    assert session.index == 3


def test_views_are_the_grasps_own(session: Session) -> None:
    grasp = session.grasp
    for view, angles in (("pregrasp", grasp.pregrasp), ("posture", grasp.posture)):
        frame = session.frame(view)
        np.testing.assert_array_equal(frame.posture, angles[0])
        np.testing.assert_array_equal(frame.X_hand_object.position_m, grasp.X_hand_object.position_m[0])
    with pytest.raises(InputError, match="unknown view"):
        session.frame("sideways")


def test_the_settled_view_executes_the_trial_once(session: Session) -> None:
    assert session.outcome is None
    frame = session.frame("settled")
    assert session.outcome is not None
    np.testing.assert_array_equal(frame.posture, session.outcome.settled_posture[0])
    assert session.recording() is session.recording()


def test_a_grasp_that_never_closed_has_no_settled_view(overlapping: Grasps, short: Protocol) -> None:
    session = Session(Batch(overlapping, "inside"), short)
    with pytest.raises(InputError, match="its trial ended as overlap"):
        session.frame("settled")


def test_trying_some_tries_all_in_the_end_and_agrees_with_the_recordings(session: Session) -> None:
    assert [session.try_some(3), session.try_some(3), session.try_some(3)] == [1, 0, 0]
    verdicts = {index: str(outcome.verdict[0]) for index, outcome in session.outcomes.items()}
    assert set(verdicts) == {0, 1, 2, 3}
    for index in verdicts:
        session.go(index)
        assert str(session.recording().outcome.verdict[0]) == verdicts[index]
    assert session.held().rate == list(verdicts.values()).count("held") / 4


def test_verdicts_belong_to_their_protocol(session: Session, short: Protocol) -> None:
    session.try_some()
    session.use(short)
    assert len(session.outcomes) == 4
    session.use(replace(short, name="slippery", friction=0.1))
    assert session.outcomes == {}
    session.try_some()
    session.show(session.batch)
    assert session.outcomes == {}


def test_a_file_opens_with_its_joints_in_the_hands_order(drawn: Grasps, hand: HandModel, tmp_path: Path) -> None:
    some, path = drawn[:3], tmp_path / "grasps.json"
    turned = replace(
        some,
        joint_names=some.joint_names[::-1],
        posture=some.posture[:, ::-1],
        pregrasp=some.pregrasp[:, ::-1],
    )
    save_grasps(path, turned, metadata={"by": "test"})
    batch = file_batch(path, hand)
    assert (batch.name, batch.metadata) == ("grasps", {"by": "test"})
    assert batch.grasps.joint_names == hand.joint_names
    np.testing.assert_array_equal(batch.grasps.posture, some.posture)


def test_a_file_without_grasps_or_joints_is_refused(drawn: Grasps, hand: HandModel, tmp_path: Path) -> None:
    path = tmp_path / "grasps.json"
    save_grasps(path, drawn[[]], metadata={})
    with pytest.raises(InputError, match="holds no grasps"):
        file_batch(path, hand)
    fewer = replace(
        drawn[:1], joint_names=hand.joint_names[1:], posture=drawn.posture[:1, 1:], pregrasp=drawn.pregrasp[:1, 1:]
    )
    save_grasps(path, fewer, metadata={})
    with pytest.raises(InputError, match=f"lacks joints of {hand.description.name}: FFJ4"):
        file_batch(path, hand)


def test_every_verdict_has_words_and_stands_with_its_protocol(session: Session, outcomes: Outcomes) -> None:
    assert set(MEANING) == set(VERDICTS)
    assert "none tried yet under protocol short" in rate_text(session)
    session.try_some()
    assert "protocol short" in grasp_html(session, "posture")
    assert "gc-verdict" not in grasp_html(session, "trial", playing=True)
    assert "of 4 tried held" in rate_text(session)
    assert "protocol short" in rate_text(session)


def test_the_table_has_a_row_for_each_grasp_and_marks_the_one_looked_at(session: Session) -> None:
    session.go(2)
    table = table_html(session)
    assert table.count("<tr") == 1 + len(session)
    assert table.count("gc-current") == 1
    assert "gc-current" not in table_html(session, mark=False)
    assert table.index("gc-current") < table.index(">2</td>")


def test_words_from_outside_are_escaped(session: Session) -> None:
    session.protocol = replace(session.protocol, name="<script>")
    for html in (table_html(session), grasp_html(session, "<script>"), message_html("<script>", error=True)):
        assert "<script>" not in html
    assert message_html("") == ""


@pytest.mark.parametrize("name", list(FORMATS_BY_NAME))
def test_every_format_can_be_downloaded(name: str, session: Session) -> None:
    for missing in FORMATS_BY_NAME[name].missing:
        pytest.importorskip(missing)
    session.try_some()
    packed = pack(session.batch, name, [0, 1, 2, 3], session.outcomes)
    assert len(packed.content) > 100
    if packed.name.endswith(".zip"):
        assert zipfile.ZipFile(io.BytesIO(packed.content)).testzip() is None


@pytest.mark.parametrize("name", ["json", "parquet"])
def test_native_downloads_are_read_back_exactly(name: str, session: Session, tmp_path: Path) -> None:
    for rows in ([0, 1, 2, 3], [2]):
        packed = pack(session.batch, name, rows)
        (tmp_path / packed.name).write_bytes(packed.content)
        read, written = load_grasps(tmp_path / packed.name), session.batch.grasps[rows]
        for column, values in written.columns().items():
            np.testing.assert_array_equal(read.columns()[column], values)
    assert packed.name == f"some_grasp2.{name}"


def test_a_format_whose_package_is_missing_says_so(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    find: Callable[[str], object] = lambda name: None  # noqa: E731
    monkeypatch.setattr("graspcascade.formats.registry.find_spec", find)
    with pytest.raises(InputError, match="parquet needs a package that is not installed here: pyarrow"):
        pack(session.batch, "parquet", [0])

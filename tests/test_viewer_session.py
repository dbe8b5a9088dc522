"""What one browser looks at: sampling, flipping, trying, wording, packing; no browser needed."""

import io
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE, as_object
from graspcascade.core.outcomes import VERDICTS
from graspcascade.core.protocols import PAPER, Protocol
from graspcascade.core.taxonomy import as_type
from graspcascade.formats import FORMATS_BY_NAME, load_grasps, save_grasps
from graspcascade.hands import Hand
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.heuristic import Heuristic, Screened
from graspcascade.proposals.prior import PosturePrior
from graspcascade.viewer import Batch, SampleRequest, Session, file_batch, sample_batch, with_friction
from graspcascade.viewer.session import measured, pack
from graspcascade.viewer.words import MEANING, grasp_html, measured_html, message_html, rate_text, table_html


@pytest.fixture(scope="module")
def sampler() -> GraspSampler:
    return GraspSampler.pretrained()


@pytest.fixture
def session(drawn: Grasps, hand: Hand, short: Protocol) -> Session:
    return Session(Batch(drawn[[0, 10, 20, 30]], "some", {"source": "test"}), hand, short)


@pytest.fixture
def overlapping(drawn: Grasps) -> Grasps:
    inside = drawn[[0]]  # a list of rows copies: the shared grasps stay as they are
    inside.X_hand_object.position_m[:] = [0.01, 0.0, 0.05]
    return inside


def test_samples_are_the_samplers(sampler: GraspSampler, hand: Hand) -> None:
    for axis, name in (("x", "tip_pinch_sphere_small_x_seed5"), (None, "tip_pinch_sphere_small_seed5")):
        batch = sample_batch(sampler, hand, SampleRequest.of("tip_pinch", "sphere_small", axis, 3, 5))
        theirs = sampler.sample("tip_pinch", "sphere_small", axis, 3, 5)
        np.testing.assert_array_equal(batch.grasps.posture, theirs.posture)
        assert batch.name == name
        assert batch.metadata["measured"] == {"tip_pinch/sphere_small": sampler.measured["tip_pinch/sphere_small"]}
        asked = {"grasp_type": "tip_pinch", "object": "sphere_small", "side_axis": axis, "n": 3, "seed": 5}
        assert batch.metadata["asked"] == asked


def test_a_heuristic_samples_objects_of_any_size(hand: Hand, prior: PosturePrior) -> None:
    heuristic, request = Screened(Heuristic(hand, prior)), SampleRequest.of("tripod", "box:32x41x60mm", "x", 4, 1)
    one, again = (sample_batch(heuristic, hand, request) for _ in range(2))
    np.testing.assert_array_equal(one.grasps.X_hand_object.position_m, again.grasps.X_hand_object.position_m)
    assert one.name == "tripod_box_32x41x60mm_x_seed1"
    assert one.grasps.side_m.tolist() == [0.032] * 4
    assert one.metadata == heuristic.origin(request.grasp_type, request.object) | {"asked": one.metadata["asked"]}
    assert (one.metadata["source"], one.metadata["model"]) == ("heuristic", "screened")
    assert Session(one, hand).frame("settled").object == as_object("box:32x41x60mm")


def test_a_friction_asked_of_a_model_that_estimates_no_chances_is_refused(sampler: GraspSampler, hand: Hand) -> None:
    with pytest.raises(InputError, match=r"model3 estimates no chances, so that a friction of 0\.5 is of no use"):
        sample_batch(sampler, hand, SampleRequest.of(friction=0.5))


def test_what_a_model_says_of_its_grasps_comes_along(hand: Hand, prior: PosturePrior) -> None:
    batch = sample_batch(Screened(Heuristic(hand, prior), most_draws=1), hand, SampleRequest.of(n=100))
    assert "grasps are not screened" in batch.notes[0]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"n": 0}, "n must be a whole number between 1 and 200, got 0"),
        ({"n": 10**18}, "n must be a whole number between 1 and 200"),
        ({"n": 1.5}, "n must be a whole number"),
        ({"n": float("nan")}, "n must be a whole number"),
        ({"seed": -1}, "seed must be a whole number between 0 and"),
        ({"grasp_type": "tripood"}, "Did you mean 'tripod'"),
        ({"object": "cylinder_large", "side_axis": "z"}, "beyond the hand's reach"),
        ({"object": "box_small", "side_axis": ""}, "unknown side axis ''"),
        ({"object": "sphere:90mm"}, "no side of sphere:90mm is within the hand's reach of 6.5 cm"),
        ({"object": "sphere:41mm"}, "knows 9 objects"),
    ],
)
def test_bad_requests_are_refused_in_words(
    sampler: GraspSampler, hand: Hand, asked: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        sample_batch(sampler, hand, SampleRequest.of(**asked))


def test_another_friction_is_another_protocol_by_name() -> None:
    assert with_friction(0.8) is PAPER
    assert with_friction(0.6) == PAPER.with_physics("paper, friction 0.6", friction=0.6)
    for bad in (0.0, -1.0, 5.1, 99.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="friction must be between"):
            with_friction(bad)


def test_behind_the_last_grasp_comes_the_first(session: Session) -> None:
    session.go(4)
    assert session.index == 0
    session.go(-1)
    assert session.index == 3


def test_views_are_the_grasps_own(session: Session) -> None:
    grasp = session.grasp
    for view, angles in (("pregrasp", grasp.pregrasp), ("target", grasp.posture)):
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


def test_the_settled_view_of_a_grasp_that_never_closed_is_the_end_of_its_trial(
    overlapping: Grasps, hand: Hand, short: Protocol
) -> None:
    session = Session(Batch(overlapping, "inside"), hand, short)
    np.testing.assert_array_equal(session.frame("settled").posture, overlapping.pregrasp[0])
    assert not session.closed
    assert str(session.outcome.verdict[0]) == "overlap"


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
    session.use(short.with_physics("slippery", friction=0.1))
    assert session.outcomes == {}
    session.try_some()
    session.show(session.batch)
    assert session.outcomes == {}


def test_a_file_opens_with_its_joints_in_the_hands_order(drawn: Grasps, hand: Hand, tmp_path: Path) -> None:
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


def test_a_file_without_grasps_or_joints_is_refused(drawn: Grasps, hand: Hand, tmp_path: Path) -> None:
    path = tmp_path / "grasps.json"
    save_grasps(path, drawn[:0], metadata={})
    with pytest.raises(InputError, match="holds no grasps"):
        file_batch(path, hand)
    fewer = replace(
        drawn[:1], joint_names=hand.joint_names[1:], posture=drawn.posture[:1, 1:], pregrasp=drawn.pregrasp[:1, 1:]
    )
    save_grasps(path, fewer, metadata={})
    with pytest.raises(InputError, match=f"lacks joints of {hand.name}: FFJ4"):
        file_batch(path, hand)


def test_joints_of_another_order_or_hand_are_put_right_or_refused(
    sampler: GraspSampler, hand: Hand, prior: PosturePrior
) -> None:
    turned = replace(hand, joint_names=hand.joint_names[::-1])
    batch, straight = (sample_batch(sampler, one, SampleRequest.of(n=2)) for one in (turned, hand))
    assert batch.grasps.joint_names == turned.joint_names
    np.testing.assert_array_equal(batch.grasps.posture, straight.grasps.posture[:, ::-1])
    other = replace(hand, joint_names=("J1", *hand.joint_names))
    with pytest.raises(InputError, match="lack joints of shadow_hand_right: J1"):
        sample_batch(sampler, other, SampleRequest.of(n=1))


def test_every_verdict_has_words_and_stands_with_its_protocol(session: Session) -> None:
    assert set(MEANING) == set(VERDICTS)
    assert "none tried yet under protocol short" in rate_text(session)
    session.try_some()
    assert "protocol short" in grasp_html(session, "target")
    assert "gc-verdict" not in grasp_html(session, "trial", playing=True)
    assert "of 4 tried held" in rate_text(session)
    assert "protocol short" in rate_text(session)


def test_the_measured_rate_of_a_type_and_object_comes_with_interval_and_protocol(
    sampler: GraspSampler, hand: Hand, prior: PosturePrior
) -> None:
    often = measured(sampler, as_type("tripod"), as_object("box_small"))
    assert often == {"held": 466, "n": 500, "protocol": "paper"}
    assert "93 % (95 %: 91 to 95 %) of 500 trials held, protocol paper" in measured_html(often)
    assert 'data-kind="note"' in measured_html(often)
    same_size = measured(sampler, as_type("tripod"), as_object("box:20x30x40mm"))
    assert same_size == often
    assert measured(sampler, as_type("tripod"), as_object("box:21x30x40mm")) is None
    assert measured(Heuristic(hand, prior), as_type("tripod"), CATALOGUE["box_small"]) is None
    assert "has not been measured" in measured_html(None)


@pytest.mark.parametrize(("held", "rare"), [(0, True), (149, True), (150, False), (500, False)])
def test_a_rate_below_thirty_percent_comes_with_a_warning(held: int, rare: bool) -> None:
    html = measured_html({"held": held, "n": 500, "protocol": "paper"})
    assert ("rarely hold" in html) is rare
    assert ('data-kind="error"' in html) is rare


@pytest.mark.parametrize(
    ("chances", "cells", "of_first", "mean"),
    [
        ([0.934, np.nan, 0.9, 0.96], ["93 %", "-", "90 %", "96 %"], "93 %</span>", "93 % on average</div>"),
        (
            [0.4, 0.2, 0.9, np.nan],
            ["40 %", "20 %", "90 %", "-"],
            "40 %: <b>likely to fail</b></span>",
            "50 % on average<",
        ),
        (
            [0.001, 0.0, 1.0, 0.999],
            ["under 1 %", "0 %", "100 %", "over 99 %"],
            "under 1 %: <b>likely",
            "50 % on average<",
        ),
        (
            [0.3, 0.1, 0.2, 0.2],
            ["30 %", "10 %", "20 %", "20 %"],
            "30 %: <b>likely",
            "20 % on average. <b>Most such grasps",
        ),
    ],
)
def test_each_grasps_chance_is_told_where_known_with_a_plain_word_where_it_is_low(
    session: Session, chances: list[float], cells: list[str], of_first: str, mean: str
) -> None:
    session.show(replace(session.batch, grasps=replace(session.batch.grasps, probability=np.array(chances))))
    assert f"chance of success {of_first}" in grasp_html(session, "target")
    table = table_html(session)
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in table.split("<tr")[2:]]
    assert [row[-2] for row in rows] == cells
    assert f"chance of success: {mean}" in table


def test_where_no_chance_is_known_none_is_spoken_of(session: Session) -> None:
    assert "chance" not in grasp_html(session, "target") + table_html(session)


@pytest.mark.parametrize("metadata", [{"ranking": 3}, {"ranking": {}}, {"ranking": {"friction": "<b>"}}, {}])
def test_a_file_may_say_anything_of_the_friction_that_chances_are_for(
    session: Session, metadata: dict[str, Any]
) -> None:
    known = replace(session.batch.grasps, probability=np.full(4, 0.9))
    session.show(replace(session.batch, grasps=known, metadata=metadata))
    assert ": 90 % on average" in table_html(session)
    assert "friction <b>" not in table_html(session)


@pytest.mark.parametrize("text", ["", "short", "long " * 200])
def test_messages_take_the_same_room_whatever_they_say(text: str) -> None:
    height = "height:4.35em;overflow:auto"
    assert height in message_html(text)
    assert height in message_html(text, error=True)


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


@pytest.mark.parametrize("name", list(FORMATS_BY_NAME))
def test_every_format_can_be_downloaded(name: str, session: Session) -> None:
    for missing in FORMATS_BY_NAME[name].missing:
        pytest.importorskip(missing)
    session.try_some()
    packed = pack(session, name, [0, 1, 2, 3])
    assert len(packed.content) > 100
    if packed.name.endswith(".zip"):
        assert zipfile.ZipFile(io.BytesIO(packed.content)).testzip() is None


@pytest.mark.parametrize("name", ["json", "parquet"])
def test_native_downloads_are_read_back_exactly(name: str, session: Session, tmp_path: Path) -> None:
    for rows in ([0, 1, 2, 3], [2]):
        packed = pack(session, name, rows)
        (tmp_path / packed.name).write_bytes(packed.content)
        read, written = load_grasps(tmp_path / packed.name), session.batch.grasps[rows]
        for column, values in written.columns().items():
            np.testing.assert_array_equal(read.columns()[column], values)
    assert packed.name == f"some_grasp2.{name}"


def test_a_format_whose_package_is_missing_says_so(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    find: Callable[[str], object] = lambda name: None  # noqa: E731
    monkeypatch.setattr("graspcascade.formats.registry.find_spec", find)
    with pytest.raises(InputError, match="parquet needs a package that is not installed here: pyarrow"):
        pack(session, "parquet", [0])


def test_an_unknown_format_is_refused(session: Session) -> None:
    with pytest.raises(InputError, match=r"unknown format 'jsonn'\. Did you mean 'json'"):
        pack(session, "jsonn", [0])

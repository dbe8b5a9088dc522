"""The geometric heuristic: where it puts an object, and what it may draw."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE, Box, Cylinder, GraspObject, Site, Sphere, as_object
from graspcascade.core.poses import Pose, rotate
from graspcascade.core.tasks import Task, Tasks, draw_tasks
from graspcascade.core.taxonomy import GRASP_TYPES, GraspType, as_type
from graspcascade.hands import Hand
from graspcascade.proposals.heuristic import CENTRED, SPREAD, Heuristic, Placement, Screened, cannot_touch, place
from graspcascade.proposals.prior import PosturePrior

N = 40
seeds = st.integers(0, 2**32 - 1)
extents = st.floats(0.005, 0.065)
primitives = st.one_of(
    st.builds(Box, extents, extents, extents), st.builds(Cylinder, extents, extents), st.builds(Sphere, extents)
).map(lambda shape: GraspObject(shape.spelling(), shape))


def draw(hand: Hand, prior: PosturePrior, seed: int, objects: Sequence[Any] = ()) -> Grasps:
    rng = np.random.default_rng(seed)
    kinds, things = list(GRASP_TYPES.values()), list(objects or CATALOGUE.values())
    cells = [(things[rng.integers(len(things))], kinds[rng.integers(len(kinds))]) for _ in range(N)]
    postures = prior.sample([kind.name for _, kind in cells], rng)
    return place(hand, postures, draw_tasks(cells, 1, hand.reach_m, rng), rng)


def pairs(hand: Hand, grasps: Grasps) -> tuple[np.ndarray, np.ndarray]:
    """Locate each grasp's opposition pair, one at a time."""
    places = [hand.opposition(g.posture, as_type(str(g.grasp_type[0]))) for g in grasps]
    return np.concatenate([thumb for thumb, _ in places]), np.concatenate([other for _, other in places])


def body_axes(grasps: Grasps) -> np.ndarray:
    return np.array([task.site.axis for task in grasps.tasks])


@settings(max_examples=25)
@given(seed=seeds, obj=primitives)
def test_any_primitive_is_centred_between_the_opposing_places_with_its_side_along_their_line(
    hand: Hand, prior: PosturePrior, seed: int, obj: GraspObject
) -> None:
    grasps = draw(hand, prior, seed, [obj, *CATALOGUE.values()])
    thumb, other = pairs(hand, grasps)
    np.testing.assert_allclose(grasps.X_hand_object.position_m, (thumb + other) / 2, atol=1e-12)
    line = (other - thumb) / np.linalg.norm(other - thumb, axis=1, keepdims=True)
    along = rotate(grasps.X_hand_object.quat_wxyz, body_axes(grasps))
    np.testing.assert_allclose(np.abs((along * line).sum(axis=1)), 1, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(grasps.X_hand_object.quat_wxyz, axis=1), 1)
    assert (grasps.X_hand_object.quat_wxyz[:, 0] >= 0).all()


def test_a_site_off_the_objects_centre_comes_to_lie_midway_between_the_opposing_places(
    hand: Hand, prior: PosturePrior
) -> None:
    ruler, oblique = as_object("box:150x20x5mm"), (0.6, 0.8, 0.0)
    tripod = GRASP_TYPES["tripod"]
    tasks = Tasks.of(
        [
            Task(tripod, ruler, Site((0.0, 1.0, 0.0), 0.020, (0.060, 0.0, 0.0))),
            Task(tripod, ruler, Site(oblique, 0.025, (-0.050, 0.001, 0.002))),
        ]
    )
    rng = np.random.default_rng(0)
    grasps = place(hand, prior.sample(tasks.grasp_type, rng), tasks, rng)
    thumb, other = pairs(hand, grasps)
    centres = np.array([task.site.centre_m for task in tasks])
    middle = grasps.X_hand_object.position_m + rotate(grasps.X_hand_object.quat_wxyz, centres)
    np.testing.assert_allclose(middle, (thumb + other) / 2, atol=1e-12)
    line = (other - thumb) / np.linalg.norm(other - thumb, axis=1, keepdims=True)
    along = rotate(grasps.X_hand_object.quat_wxyz, body_axes(grasps))
    np.testing.assert_allclose(np.abs((along * line).sum(axis=1)), 1, atol=1e-9)


@pytest.mark.parametrize(
    "site",
    [
        Site((1.0, 0.0, 0.0), 0.02),
        Site((1.0, 0.0, 0.0), 0.03, (0.0, 0.05, 0.0)),
        Site((1.0, 0.0, 0.0), 0.03, (0.01, 0.0, 0.0)),
        Site((0.6, 0.8, 0.0), 0.03),
    ],
    ids=["of another width", "beside the object", "not midway", "oblique"],
)
def test_a_site_that_does_not_end_on_the_objects_surface_is_refused(
    hand: Hand, prior: PosturePrior, site: Site
) -> None:
    tasks = Tasks.of([Task(GRASP_TYPES["tripod"], CATALOGUE["box_medium"], site)])
    with pytest.raises(InputError, match=r"cm wide, does not end on the surface of box_medium; its sides: x = 3 cm"):
        Heuristic(hand, prior).propose(tasks, np.random.default_rng(0))


@pytest.mark.parametrize("obj", [*CATALOGUE.values(), as_object("sphere:1mm"), as_object("box:1x1000x1000mm")])
def test_every_side_of_an_object_ends_on_its_surface(obj: GraspObject) -> None:
    assert all(obj.shape.has_site(site) for site in obj.sites().values())


def test_the_free_angle_is_uniform(hand: Hand, prior: PosturePrior) -> None:
    n = 4000
    rng = np.random.default_rng(0)
    posture = np.repeat(prior.sample(["tripod"], rng), n, axis=0)
    tasks = Tasks.repeat(Task.of("tripod", "box_small", "x"), n)
    turned = place(hand, posture, tasks, rng)
    least = place(hand, posture[:1], tasks[:1], np.random.default_rng(1))
    reference = rotate(least.X_hand_object.quat_wxyz, np.array([0.0, 1.0, 0.0]))[0]
    across = rotate(turned.X_hand_object.quat_wxyz, np.array([0.0, 1.0, 0.0]))
    line = rotate(least.X_hand_object.quat_wxyz, np.array([1.0, 0.0, 0.0]))[0]
    angle = np.arctan2(across @ np.cross(line, reference), across @ reference)
    counts, _ = np.histogram(angle, bins=16, range=(-np.pi, np.pi))
    chi_square = ((counts - n / 16) ** 2 / (n / 16)).sum()
    assert chi_square < 45, "15 degrees of freedom: one draw in 10,000 exceeds this"


@settings(max_examples=15)
@given(seed=seeds)
def test_columns_say_what_was_placed(hand: Hand, prior: PosturePrior, seed: int) -> None:
    grasps = draw(hand, prior, seed)
    assert (grasps.hand, grasps.joint_names) == (hand.name, hand.joint_names)
    np.testing.assert_array_equal(grasps.posture, hand.executed(grasps.posture))
    np.testing.assert_array_equal(grasps.pregrasp, np.tile(hand.pregrasp, (N, 1)))
    np.testing.assert_array_equal(grasps.grasp_size_m, hand.grasp_size(grasps.posture))
    sides = [as_object(o).sides_m[a] for o, a in zip(grasps.object_name.tolist(), grasps.side_axis, strict=True)]
    np.testing.assert_array_equal(grasps.side_m, sides)
    assert np.isnan(grasps.probability).all()
    assert np.isnan(grasps.object_size_m).all()


@settings(max_examples=15)
@given(seed=seeds, obj=primitives)
def test_grasps_that_cannot_touch_are_those_wider_than_their_side(
    hand: Hand, prior: PosturePrior, seed: int, obj: GraspObject
) -> None:
    grasps = draw(hand, prior, seed, [obj])
    thumb, other = pairs(hand, grasps)
    np.testing.assert_array_equal(cannot_touch(hand, grasps), np.linalg.norm(other - thumb, axis=1) > grasps.side_m)


@settings(max_examples=5)
@given(seed=seeds)
def test_the_same_generator_draws_the_same_grasps(hand: Hand, prior: PosturePrior, seed: int) -> None:
    first, second, other = (draw(hand, prior, s) for s in (seed, seed, seed + 1))
    assert first.tasks.same_as(second.tasks)
    for name, column in first.columns().items():
        np.testing.assert_array_equal(column, second.columns()[name], err_msg=name)
    assert not np.array_equal(first.X_hand_object.quat_wxyz, other.X_hand_object.quat_wxyz)


# Proposals


def test_records_tell_the_screened_heuristic_from_the_papers(hand: Hand, prior: PosturePrior) -> None:
    heuristic, screened = Heuristic(hand, prior), Screened(Heuristic(hand, prior))
    assert (heuristic.name, screened.name) == ("heuristic", "screened")
    assert heuristic.describe() == {"prior": prior.fingerprint()}
    assert screened.describe() == {"prior": prior.fingerprint(), "most_draws": 200}
    with pytest.raises(InputError, match="most_draws must be at least 1, got 0"):
        Screened(heuristic, most_draws=0)


@pytest.mark.parametrize("screen", [lambda heuristic: heuristic, Screened])
def test_the_same_generator_proposes_the_same_grasps(hand: Hand, prior: PosturePrior, screen: Any) -> None:
    heuristic, wide = screen(Heuristic(hand, prior)), as_object("box:20x41x160mm")
    tasks = Tasks.of(Task.of(kind, obj, "x") for kind in GRASP_TYPES for obj in (wide, "cylinder:14x60mm", "box_large"))

    def both(seed: int) -> list[Grasps]:
        rng = np.random.default_rng(seed)
        return [heuristic.propose(tasks, rng), heuristic.propose_any_side(wide, GRASP_TYPES["tripod"], 9, rng)]

    for one, two, other in zip(both(3), both(3), both(4), strict=True):
        assert one.tasks.same_as(two.tasks)
        for name, column in one.columns().items():
            np.testing.assert_array_equal(column, two.columns()[name], err_msg=name)
        assert not np.array_equal(one.posture, other.posture)


@pytest.mark.parametrize("kind", [Heuristic, Screened])
def test_one_line_samples_an_own_size_by_an_axis_a_site_or_any_side(kind: Any) -> None:
    proposal, box = kind.pretrained(), as_object("box:32x41x60mm")
    by_axis, by_site = (proposal.sample("tripod", box, side, n=3, seed=1) for side in ("y", box.site("y", 0.065)))
    assert by_axis.side_axis.tolist() == ["y"] * 3
    np.testing.assert_array_equal(by_axis.posture, by_site.posture)
    task = Task.of("tripod", box, "y")
    proposed = proposal.propose(Tasks.repeat(task, 3), np.random.default_rng(1))
    np.testing.assert_array_equal(by_axis.X_hand_object.position_m, proposed.X_hand_object.position_m)
    assert set(proposal.sample("tripod", "box:32x41x60mm", n=20).side_axis) == {"x", "y", "z"}
    with pytest.raises(InputError, match="n must be at least 1, got 0"):
        proposal.sample("tripod", box, n=0)


def test_screening_draws_again_only_where_the_digits_cannot_touch(hand: Hand, prior: PosturePrior) -> None:
    things = [*CATALOGUE.values(), as_object("cylinder:8x30mm"), as_object("box:60x60x9mm")]
    cells = [(obj, kind) for obj in things for kind in GRASP_TYPES.values()]
    tasks = draw_tasks(cells, 3, hand.reach_m, np.random.default_rng(0))
    plain = Heuristic(hand, prior).propose(tasks, np.random.default_rng(1))
    assert cannot_touch(hand, plain).any()
    screened = Screened(Heuristic(hand, prior)).propose(tasks, np.random.default_rng(1))
    assert not cannot_touch(hand, screened).any()
    assert screened.tasks.same_as(tasks)
    kept = ~cannot_touch(hand, plain)
    np.testing.assert_array_equal(screened.posture[kept], plain.posture[kept])


def test_a_hand_with_fewer_joints_gets_the_postures_of_the_joints_it_has(hand: Hand, prior: PosturePrior) -> None:
    wider = replace(prior, joint_names=("spare", *prior.joint_names), decoder=WithSpareJoint(prior.decoder))
    task = Tasks.repeat(Task.of("tripod", "box:32x41x60mm", "x"), 5)
    one, other = (Heuristic(hand, p).propose(task, np.random.default_rng(0)) for p in (prior, wider))
    np.testing.assert_array_equal(one.posture, other.posture)


class WithSpareJoint:
    """Decode postures with a joint more, which comes first."""

    def __init__(self, decoder: Any) -> None:
        self.decoder = decoder

    def sample(self, codes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        postures = self.decoder.sample(codes, rng)
        return np.concatenate([np.full((len(postures), 1), 9.0), postures], axis=1)


def test_a_prior_of_other_joints_is_refused(hand: Hand, prior: PosturePrior) -> None:
    with pytest.raises(InputError, match=r"lack THJ1 of shadow_hand_right; train the prior for this hand"):
        Heuristic(hand, replace(prior, joint_names=(*prior.joint_names[:-1], "elbow")))


# Sides


@pytest.mark.parametrize("name", [*CATALOGUE, "box:32x41x160mm", "cylinder:80x20mm"])
def test_sides_are_drawn_uniformly_and_only_graspable_ones(hand: Hand, prior: PosturePrior, name: str) -> None:
    n, obj = 6000, as_object(name)
    options = list(obj.sites(hand.reach_m))
    drawn = draw_tasks([(obj, GRASP_TYPES["tripod"])], n, hand.reach_m, np.random.default_rng(0)).side_axis
    counts = np.array([(drawn == axis).sum() for axis in options])
    assert counts.sum() == n
    expected = n / len(options)
    assert ((counts - expected) ** 2 / expected).sum() < 20, "two degrees of freedom at most: once in 20,000 draws"
    proposed = Heuristic(hand, prior).propose_any_side(obj, GRASP_TYPES["tripod"], 20, np.random.default_rng(0))
    assert set(proposed.side_axis) <= set(options)


def test_sides_are_drawn_for_each_object_of_a_mixed_batch(hand: Hand) -> None:
    cells = [(obj, kind) for obj in CATALOGUE.values() for kind in GRASP_TYPES.values()]
    tasks = draw_tasks(cells, 10, hand.reach_m, np.random.default_rng(2))
    assert [task.cell for task in tasks] == [(obj.name, kind.name) for obj, kind in cells for _ in range(10)]
    assert all(task.site in task.object.sites(hand.reach_m).values() for task in tasks)


def test_equivalent_axes_become_the_one_that_names_the_side(hand: Hand) -> None:
    posture = hand.pregrasp[None].repeat(3, axis=0)
    tasks = Tasks.of(map(Task.of, ["tripod"] * 3, ["cylinder_small", "sphere_small", "box_small"], ["y", "z", "y"]))
    assert place(hand, posture, tasks, np.random.default_rng(0)).side_axis.tolist() == ["x", "x", "y"]


# Placement


def measure(hand: Hand, grasps: Grasps) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Measure offsets ``(n, 3)`` of the opposing places' middle from the site's centre, as shares of the extents.

    Further, of each site's axis against the line between the places: the angle, the axis and the line.
    """
    thumb, other = pairs(hand, grasps)
    centres = np.array([task.site.centre_m for task in grasps.tasks])
    extents = np.array([task.object.extents_m for task in grasps.tasks])
    offset = (grasps.X_hand_object.inverse().apply((thumb + other) / 2) - centres) / extents
    line = (other - thumb) / np.linalg.norm(other - thumb, axis=1, keepdims=True)
    along = rotate(grasps.X_hand_object.quat_wxyz, body_axes(grasps))
    along = np.where((along * line).sum(axis=1, keepdims=True) < 0, -along, along)
    across = np.linalg.norm(np.cross(along, line), axis=1)
    return offset, np.arctan2(across, (along * line).sum(axis=1)), along, line


@settings(max_examples=25)
@given(seed=seeds, obj=primitives, share=st.floats(0.0, 0.5), tilt_rad=st.floats(0.0, np.pi / 2))
def test_a_placed_object_is_off_centre_and_tilted_within_bounds(
    hand: Hand, prior: PosturePrior, seed: int, obj: GraspObject, share: float, tilt_rad: float
) -> None:
    rng, kinds = np.random.default_rng(seed), list(GRASP_TYPES.values())
    tasks = draw_tasks([(each, kind) for each in (obj, CATALOGUE["box_small"]) for kind in kinds], 2, np.inf, rng)
    proposal = Heuristic(replace(hand, reach_m=np.inf), prior, Placement(share, tilt_rad))
    for grasps in (proposal.propose(tasks, rng), Screened(proposal, 2).propose(tasks, rng)):
        offset, tilt, _, _ = measure(hand, grasps)
        assert (np.abs(offset) <= share + 1e-9).all()
        np.testing.assert_allclose((offset * body_axes(grasps)).sum(axis=1), 0.0, atol=1e-9)
        assert (tilt <= tilt_rad + 1e-6).all()
        np.testing.assert_allclose(np.linalg.norm(grasps.X_hand_object.quat_wxyz, axis=1), 1)
        assert (grasps.X_hand_object.quat_wxyz[:, 0] >= 0).all()


def test_offsets_and_tilts_are_even_within_their_bounds(hand: Hand, prior: PosturePrior) -> None:
    n = 3000
    tasks = Tasks.repeat(Task.of("tripod", "box_medium", "y"), n)
    grasps = Heuristic(hand, prior, SPREAD).propose(tasks, np.random.default_rng(0))
    offset, tilt, along, line = measure(hand, grasps)
    np.testing.assert_allclose(offset[:, 1], 0.0, atol=1e-9)
    draws = {"x": (offset[:, 0], -1 / 3, 1 / 3), "z": (offset[:, 2], -1 / 3, 1 / 3), "tilt": (tilt, 0, np.pi / 12)}
    across = along - (along * line).sum(axis=1, keepdims=True) * line
    reference = np.cross(line, [0.0, 0.0, 1.0])
    turn = np.arctan2((np.cross(line, reference) * across).sum(axis=1), (reference * across).sum(axis=1))
    draws["direction of the tilt"] = (turn, -np.pi, np.pi)
    for name, (values, low, high) in draws.items():
        counts, _ = np.histogram(values, bins=10, range=(low - 1e-9, high + 1e-9))
        assert counts.sum() == n, name
        assert ((counts - n / 10) ** 2 / (n / 10)).sum() < 34, f"{name}, 9 degrees of freedom: once in 10,000 draws"
    correlation = np.corrcoef([offset[:, 0], offset[:, 2], tilt])
    assert np.abs(correlation - np.eye(3)).max() < 4 / np.sqrt(n)


def test_a_site_off_the_objects_centre_is_placed_about_that_site(hand: Hand, prior: PosturePrior) -> None:
    ruler = as_object("box:150x20x5mm")
    task = Task(GRASP_TYPES["tripod"], ruler, Site((0.0, 1.0, 0.0), 0.020, (0.060, 0.0, 0.0)))
    rng = np.random.default_rng(0)
    grasps = Heuristic(hand, prior, Placement(0.01, 0.1)).propose(Tasks.repeat(task, 50), rng)
    offset, tilt, _, _ = measure(hand, grasps)
    assert np.abs(offset).max() <= 0.01
    assert 0.05 < tilt.max() <= 0.1


@pytest.mark.parametrize("screen", [lambda heuristic: heuristic, Screened])
def test_no_spread_is_the_papers_placement_and_draws_nothing(hand: Hand, prior: PosturePrior, screen: Any) -> None:
    drawn, states = [], []
    for heuristic in (Heuristic(hand, prior), Heuristic(hand, prior, Placement(0.0, 0.0))):
        rng = np.random.default_rng(0)
        drawn.append(screen(heuristic).propose_any_side(CATALOGUE["box_small"], GRASP_TYPES["tripod"], 20, rng))
        states.append(rng.bit_generator.state)
    assert states[0] == states[1]
    for name, column in drawn[0].columns().items():
        np.testing.assert_array_equal(column, drawn[1].columns()[name], err_msg=name)


def test_a_spread_changes_places_alone(hand: Hand, prior: PosturePrior) -> None:
    tasks = Tasks.repeat(Task.of("tripod", "box_medium", "x"), 20)
    centred, spread = (
        Heuristic(hand, prior, placement).propose(tasks, np.random.default_rng(0)) for placement in (CENTRED, SPREAD)
    )
    np.testing.assert_array_equal(centred.posture, spread.posture)
    # The free angle is the same: seen from the tilted object, only the tilt is new.
    apart = Pose(centred.X_hand_object.position_m, centred.X_hand_object.quat_wxyz).inverse() @ spread.X_hand_object
    angle = 2 * np.arccos(np.clip(np.abs(apart.quat_wxyz[:, 0]), 0, 1))
    np.testing.assert_allclose(angle, measure(hand, spread)[1], atol=1e-6)


@pytest.mark.parametrize("most_draws", [1, 200])
def test_a_screened_heuristic_spreads_objects_too(hand: Hand, prior: PosturePrior, most_draws: int) -> None:
    tasks = Tasks.repeat(Task.of("tripod", "box_small", "x"), 50)
    screened = Screened(Heuristic(hand, prior, SPREAD), most_draws)
    offset, tilt, _, _ = measure(hand, screened.propose(tasks, np.random.default_rng(0)))
    assert (np.abs(offset[:, 1:]) > 0).all()
    assert tilt.min() > 0


def test_records_say_how_objects_were_spread(hand: Hand, prior: PosturePrior) -> None:
    spread = Heuristic(hand, prior, Placement(0.25, 0.1))
    placement = {"offset_share": 0.25, "tilt_rad": 0.1}
    assert spread.describe() == {"prior": prior.fingerprint(), "placement": placement}
    assert Screened(spread).describe()["placement"] == placement
    assert spread.sample("tripod", "box_small", n=1).X_hand_object.quat_wxyz.shape == (1, 4)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"offset_share": -0.1}, "offset_share of a placement must be 0 to 0.5, got -0.1"),
        ({"offset_share": 0.6}, "offset_share of a placement must be 0 to 0.5, got 0.6"),
        ({"tilt_rad": 15.0}, "tilt_rad of a placement must be 0 to 1.571, got 15.0"),
        ({"tilt_rad": np.nan}, "tilt_rad of a placement must be 0 to 1.571, got nan"),
    ],
)
def test_a_placement_out_of_bounds_is_refused(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Placement(**wrong)


# Input


def place_one(hand: Hand, kind: str = "tripod", obj: str = "box_small", axis: str = "x") -> Grasps:
    task = Task.of(kind, obj, axis)
    return place(hand, hand.pregrasp[None], Tasks.of([task]), np.random.default_rng(0))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"kind": "tripodd"}, "unknown grasp type 'tripodd'. Did you mean 'tripod'"),
        ({"obj": "box_smal"}, "unknown object 'box_smal'. Did you mean 'box_small'"),
        ({"axis": "w"}, "unknown side axis 'w'"),
        (
            {"obj": "box_large", "axis": "z"},
            "side z of box_large is 7 cm, beyond the hand's reach of 6.5 cm. Graspable sides: x = 4 cm, y = 5.5 cm.",
        ),
        ({"obj": "sphere:80mm"}, "beyond the hand's reach of 6.5 cm. Graspable sides: none."),
    ],
)
def test_what_cannot_be_placed_is_refused(hand: Hand, wrong: dict[str, str], message: str) -> None:
    with pytest.raises(InputError) as caught:
        place_one(hand, **wrong)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_an_object_without_a_side_within_reach_is_refused(hand: Hand, prior: PosturePrior) -> None:
    with pytest.raises(InputError, match=r"no side of sphere:80mm is within the hand's reach of 6\.5 cm"):
        Heuristic(hand, prior).propose_any_side(
            as_object("sphere:80mm"), GRASP_TYPES["tripod"], 2, np.random.default_rng(0)
        )


def lacking(hand: Hand, *missing: str) -> Hand:
    places = {name: point for name, point in hand.places.items() if name not in missing}
    return replace(hand, name="three_fingers", places=places)


@pytest.mark.parametrize("kind", GRASP_TYPES.values(), ids=lambda kind: kind.name)
def test_a_hand_without_a_place_that_a_type_opposes_is_refused(
    hand: Hand, prior: PosturePrior, kind: GraspType
) -> None:
    for missing in kind.opposition:
        fewer = lacking(hand, missing)
        assert kind.name not in fewer.grasp_types
        tasks = Tasks.of([Task.of(kind, "box_small", "x")])
        for refused in (
            lambda fewer=fewer: place_one(fewer, kind=kind.name),
            lambda fewer=fewer, tasks=tasks: Heuristic(fewer, prior).propose(tasks, np.random.default_rng(0)),
            lambda fewer=fewer: fewer.closure(hand.pregrasp[None], [kind], np.zeros(1, dtype=np.intp)),
        ):
            with pytest.raises(InputError) as caught:
                refused()
            said = str(caught.value)
            assert missing in said
            assert "three_fingers" in said
            assert kind.name in said
            assert len(said.splitlines()) == 1


def test_a_hand_needs_only_the_places_of_the_types_it_is_asked_for(hand: Hand) -> None:
    pinch = GRASP_TYPES["tip_pinch"]
    two_fingers = lacking(hand, *(name for name in hand.places if name not in pinch.opposition))
    np.testing.assert_array_equal(
        place_one(two_fingers, kind="tip_pinch").X_hand_object.position_m,
        place_one(hand, kind="tip_pinch").X_hand_object.position_m,
    )


def test_names_are_kept_as_the_tables_spell_them(hand: Hand) -> None:
    grasps = place_one(hand, kind="Tip pinch", obj="Box-Small")
    assert grasps.grasp_type.tolist() == ["tip_pinch"]
    assert grasps.object_name.tolist() == ["box_small"]


def test_columns_of_different_length_are_refused(hand: Hand) -> None:
    tasks = Tasks.repeat(Task.of("tripod", "box_small", "x"), 2)
    with pytest.raises(InputError, match="got 1 postures for 2 tasks"):
        place(hand, hand.pregrasp[None], tasks, np.random.default_rng(0))

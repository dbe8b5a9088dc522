"""Trials under conditions of their own, with objects of any size, and through other phases than the paper's."""

from dataclasses import replace

import numpy as np
import pytest

from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import GraspObject, as_object
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.poses import Pose, as_rotation, canonical_quat, quat_multiply
from graspcascade.core.protocols import VARIED, Carry, Close, Conditions, Physics, Protocol, Shake
from graspcascade.core.tasks import Task, Tasks, draw_tasks
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.engines import as_engine, run_trials
from graspcascade.engines.mujoco.creep import FAST_FORWARD
from graspcascade.engines.mujoco.idle import IdleFinder
from graspcascade.hands import Hand
from graspcascade.proposals.heuristic import Heuristic, Screened
from test_engine_trials import assert_same

SIZES = ("box:24x33x52mm", "cylinder:27x80mm", "sphere:38mm", "box:30x30x240mm", "cylinder:22x21mm", "sphere:6.3cm")


def with_objects(grasps: Grasps, objects: list[GraspObject]) -> Grasps:
    """Put other objects into the hand in place of those of the grasps, held by the same axis."""
    rows = zip(grasps.tasks, objects, strict=True)
    tasks = Tasks.of(Task(task.grasp_type, obj, obj.site(task.site.name)) for task, obj in rows)
    return Grasps.from_columns(grasps.hand, grasps.joint_names, tasks, grasps.columns())


def larger(obj: GraspObject, by_m: float) -> GraspObject:
    """Make an object that is larger by so much along every axis."""
    sizes = {name: size + by_m for name, size in vars(obj.shape).items()}
    return replace(obj, name=f"larger {obj.name}", shape=replace(obj.shape, **sizes))


@pytest.fixture(scope="module")
def some(drawn: Grasps) -> Grasps:
    return drawn[::3]


@pytest.fixture(scope="module")
def plain(some: Grasps, outcomes: Outcomes) -> Outcomes:
    return outcomes[::3]


# -- conditions


@pytest.mark.parametrize("reduced", [True, False])
def test_each_trial_goes_as_in_a_batch_under_its_own_physics(some: Grasps, short: Protocol, reduced: bool) -> None:
    physics = [
        {"friction": 0.3},
        {"friction": 1.1, "gain_factor": 1.0},
        {"density_factor": 12.0},
        {"friction": 0.6, "density_factor": 0.4, "gain_factor": 5.0},
    ]
    which = np.arange(len(some)) % len(physics)
    columns = {
        name: np.array([numbers.get(name, getattr(Physics(), name)) for numbers in physics])[which]
        for name in ("friction", "density_factor", "gain_factor")
    }
    mixed = run_trials(
        some, short, conditions=Conditions.of(short.physics, len(some), **columns), n_slots=5, reduced=reduced
    )
    for number, numbers in enumerate(physics):
        rows = which == number
        alone = run_trials(some[rows], short.with_physics("own", **numbers), reduced=reduced)
        np.testing.assert_array_equal(mixed.verdict[rows], alone.verdict)
        np.testing.assert_array_equal(mixed.touching_closed[rows], alone.touching_closed)
        np.testing.assert_allclose(mixed.settled_posture[rows], alone.settled_posture, rtol=0, atol=1e-12)
    assert not np.array_equal(mixed.settled_posture, run_trials(some, short, reduced=reduced).settled_posture)


def test_nominal_conditions_change_nothing(some: Grasps, plain: Outcomes, short: Protocol) -> None:
    assert_same(run_trials(some, short, conditions=Conditions.of(short.physics, len(some))), plain)


@pytest.mark.parametrize("reduced", [True, False])
@pytest.mark.parametrize("error_m", [0.001, -0.002])
def test_an_object_that_is_larger_than_it_is_said_to_be_acts_as_a_larger_object(
    some: Grasps, plain: Outcomes, short: Protocol, error_m: float, reduced: bool
) -> None:
    wrong = run_trials(
        some, short, conditions=Conditions.of(short.physics, len(some), size_error_m=error_m), reduced=reduced
    )
    real = with_objects(some, [larger(task.object, error_m) for task in some.tasks])
    expected = run_trials(real, short, reduced=reduced)
    np.testing.assert_array_equal(wrong.verdict, expected.verdict)
    np.testing.assert_allclose(wrong.settled_posture, expected.settled_posture, rtol=0, atol=1e-9)
    assert np.nanmax(np.abs(wrong.settled_posture - plain.settled_posture)) > 1e-3


def test_a_position_error_moves_the_start(some: Grasps, short: Protocol) -> None:
    error = np.random.default_rng(0).normal(scale=0.003, size=(len(some), 3))
    wrong = run_trials(some, short, conditions=Conditions.of(short.physics, len(some), position_error_m=error))
    moved = replace(some, X_hand_object=Pose(some.X_hand_object.position_m + error, some.X_hand_object.quat_wxyz))
    assert_same(wrong, run_trials(moved, short))


def test_a_rotation_error_turns_the_start_about_the_objects_centre(some: Grasps, short: Protocol) -> None:
    error = np.random.default_rng(0).normal(scale=0.1, size=(len(some), 3))
    error[0] = 0.0
    wrong = run_trials(some, short, conditions=Conditions.of(short.physics, len(some), rotation_error_rad=error))
    turn = canonical_quat(as_rotation([1.0, 0, 0, 0]).from_rotvec(error).as_quat(scalar_first=True))
    pose = some.X_hand_object
    turned = replace(some, X_hand_object=Pose(pose.position_m, canonical_quat(quat_multiply(turn, pose.quat_wxyz))))
    expected = run_trials(turned, short)
    np.testing.assert_array_equal(wrong.verdict, expected.verdict)
    np.testing.assert_allclose(wrong.settled_posture, expected.settled_posture, rtol=0, atol=1e-6)
    assert_same(wrong[:1], run_trials(some[:1], short))


def test_conditions_do_not_depend_on_order_threads_or_slots(some: Grasps, short: Protocol) -> None:
    rng = np.random.default_rng(2)
    conditions = Conditions.of(
        short.physics,
        len(some),
        friction=rng.uniform(0.3, 1.2, len(some)),
        size_error_m=rng.normal(scale=0.001, size=len(some)),
        position_error_m=rng.normal(scale=0.002, size=(len(some), 3)),
    )
    expected, order = run_trials(some, short, conditions=conditions), rng.permutation(len(some))
    for n_threads, n_slots in ((1, 1), (1, 5), (2, 64)):
        shuffled = run_trials(some[order], short, conditions=conditions[order], n_threads=n_threads, n_slots=n_slots)
        assert_same(shuffled, expected[order])


def test_a_protocol_that_varies_draws_for_each_trial(some: Grasps, plain: Outcomes, short: Protocol) -> None:
    varied = replace(short, name="varied", variation=VARIED.variation)
    drawn = run_trials(some, varied, seed=3)
    assert_same(drawn, run_trials(some, short, conditions=varied.conditions(len(some), 3)))
    assert_same(drawn[:5], run_trials(some[:5], varied, seed=3))
    assert not np.array_equal(drawn.settled_posture, run_trials(some, varied, seed=4).settled_posture)
    assert not np.array_equal(drawn.settled_posture, plain.settled_posture)


def test_an_engine_is_not_left_to_guess_what_a_protocol_varies(some: Grasps, hand: Hand) -> None:
    with pytest.raises(InputError, match="protocol varied varies: give the conditions"):
        as_engine().run(hand, some, VARIED)


def test_conditions_of_another_number_of_trials_are_refused(some: Grasps, short: Protocol) -> None:
    with pytest.raises(InputError, match=f"conditions of 3 trials for {len(some)} grasps"):
        run_trials(some, short, conditions=Conditions.of(short.physics, 3))


def test_a_size_error_that_leaves_nothing_of_an_object_is_refused(some: Grasps, short: Protocol) -> None:
    spheres = with_objects(some[:2], [as_object("box_small"), as_object("box:45x45x45mm")])
    conditions = Conditions.of(short.physics, 2, size_error_m=[-0.001, -0.045])
    with pytest.raises(
        InputError, match=r"trial 1: a size error of -0.045 m leaves nothing .* 0.045 m of box:45x45x45mm"
    ):
        run_trials(spheres, short, conditions=conditions)


@pytest.mark.parametrize("changes", [{"density_factor": 1e-9}, {"size_error_m": -0.0199999}])
def test_an_object_too_small_or_too_light_for_the_engine_is_refused(
    some: Grasps, short: Protocol, changes: dict
) -> None:
    small = with_objects(some[:1], [replace(as_object("box_small"), density_kg_m3=1.0)])
    with pytest.raises(InputError, match=r"box_small of .* kg/m3, .* m larger, cannot be simulated: ") as caught:
        run_trials(small, short, conditions=Conditions.of(short.physics, 1, **changes))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("column", "factor", "says"),
    [
        ("posture", np.nan, "posture is not finite"),
        ("pregrasp", np.inf, "pregrasp is not finite"),
        ("posture", 57.3, "posture has an angle of .* looks like degrees"),
        ("position_m", 1000.0, "centre is .* m from the palm, .* millimetres"),
        ("position_m", np.nan, "position_m is not finite"),
        ("quat_wxyz", 3.0, r"must have norm 1, got norm 3"),
        ("quat_wxyz", 0.0, r"must have norm 1, got norm 0"),
    ],
)
def test_numbers_that_are_no_grasp_are_not_tried(
    some: Grasps, short: Protocol, column: str, factor: float, says: str
) -> None:
    columns = some.columns()
    columns[column] = columns[column] + factor if np.isinf(factor) else columns[column] * factor
    wrong = Grasps.from_columns(some.hand, some.joint_names, some.tasks, columns)
    with pytest.raises(InputError, match=f"^grasp 0: .*{says}"):
        run_trials(wrong, short)


# -- objects of any size


@pytest.fixture(scope="module")
def sized(hand: Hand, prior: object) -> Grasps:
    """Draw four grasps of each of several sizes, screened."""
    cells = [(as_object(size), kind) for size in SIZES for kind in list(GRASP_TYPES.values())[:2]]
    rng = np.random.default_rng(11)
    return Screened(Heuristic(hand, prior), 50).propose(draw_tasks(cells, 2, hand.reach_m, rng), rng)


@pytest.mark.parametrize("creep", [True, False])
def test_any_sizes_in_one_batch_end_as_each_alone(sized: Grasps, short: Protocol, creep: bool) -> None:
    options = {"creep": FAST_FORWARD} if creep else {}
    together = run_trials(sized, short, n_slots=7, **options)
    assert together.held.sum() >= 6
    for _, rows in sized.tasks.groups(lambda task: task.object):
        assert_same(together[rows], run_trials(sized[rows], short, **options))
    order = np.random.default_rng(1).permutation(len(sized))
    assert_same(together[order], run_trials(sized[order], short, n_threads=2, **options))


def test_a_size_that_is_spelled_acts_as_the_catalogue_object_of_that_size(
    some: Grasps, plain: Outcomes, short: Protocol
) -> None:
    spelled = with_objects(some, [as_object(task.object.shape.spelling()) for task in some.tasks])
    assert_same(run_trials(spelled, short), plain)


def test_a_long_object_is_followed_to_its_far_ends(sized: Grasps, short: Protocol) -> None:
    """Digits that are left out near the end of an object far from its centre would be missed by its sweep."""
    rods = sized[sized.object_name == "box:30x30x240mm"]
    loose = short.with_physics("loose", friction=0.15)
    for protocol in (short, loose):
        tried = run_trials(rods, protocol)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(IdleFinder, "find", lambda *_: None)
            whole = run_trials(rods, protocol)
        np.testing.assert_array_equal(tried.verdict, whole.verdict)
        np.testing.assert_array_equal(tried.touching_closed, whole.touching_closed)


@pytest.mark.parametrize("reduced", [True, False])
def test_an_object_is_as_large_to_the_engine_as_it_is(drawn: Grasps, short: Protocol, reduced: bool) -> None:
    """A ball of any size beside the palm overlaps it exactly where its radius says."""
    back_of_the_palm_m = 0.0117
    balls = [as_object(f"sphere:{size}mm") for size in (8, 45, 101, 240)]
    for depth_m, overlaps in ((0.0009, False), (0.0011, True)):
        grasps = with_objects(drawn[drawn.object_name == "sphere_medium"][[0] * 4], balls)
        position = np.array([[0.011, back_of_the_palm_m + ball.extents_m[0] / 2 - depth_m, 0.04] for ball in balls])
        # Flat, the hand touches nothing else than the ball behind it.
        flat = replace(grasps, posture=grasps.pregrasp, X_hand_object=Pose(position, grasps.X_hand_object.quat_wxyz))
        verdict = run_trials(flat, short, reduced=reduced).verdict
        assert ((verdict == "overlap") == overlaps).all()


# -- other phases


@pytest.mark.parametrize(
    "phases",
    [
        (Close(), Carry(0.4)),
        (Close(), Shake(cycles=1)),
        (Close(), Carry(0.2), Shake(cycles=1), Carry(0.2)),
        (Close(), Shake(cycles=1), Carry(0.2, 4.0), Carry(0.2, 9.81)),
        (Close(0.3, 0.102), Carry(0.211)),
    ],
    ids=lambda phases: " ".join(phase.kind for phase in phases),
)
def test_a_trial_goes_through_whatever_phases_its_protocol_has(
    drawn: Grasps, outcomes: Outcomes, phases: tuple
) -> None:
    protocol = Protocol("phases", phases)
    rows = np.flatnonzero(outcomes.held)[:12]
    tried = run_trials(drawn[rows], protocol)
    assert tried.held.mean() > 0.7
    np.testing.assert_allclose(tried.duration_s[tried.held], protocol.schedule.total_steps * 0.004)
    order = np.arange(len(rows))[::-1]
    assert_same(run_trials(drawn[rows][order], protocol, n_slots=5), tried[order])


def test_the_weight_of_every_phase_is_felt(drawn: Grasps, outcomes: Outcomes) -> None:
    rows = np.flatnonzero(outcomes.held)[:8]
    heavy_first = Protocol("heavy first", (Close(), Carry(0.6, 900.0), Shake(cycles=1), Carry(0.2)))
    heavy_last = Protocol("heavy last", (Close(), Carry(0.2), Shake(cycles=1), Carry(0.6, 900.0)))
    light = Protocol("light", (Close(), Carry(0.2), Carry(0.6, 0.0)))
    first, last = run_trials(drawn[rows], heavy_first), run_trials(drawn[rows], heavy_last)
    assert set(first.verdict) == set(last.verdict) == {"dropped"}
    assert first.duration_s.max() < 0.7 + 0.6
    assert last.duration_s.min() > 0.7 + 0.2 + 1.0
    assert run_trials(drawn[rows], light).held.mean() > 0.7


# -- engines by name


def test_an_engine_is_made_by_name_with_its_own_options() -> None:
    engine = as_engine("mujoco", n_threads=1, n_slots=3)
    assert (engine.n_threads, engine.n_slots) == (1, 3)  # type: ignore[attr-defined]


def test_an_unknown_engine_or_protocol_is_refused_and_the_nearest_named(some: Grasps) -> None:
    with pytest.raises(InputError, match=r"unknown engine 'mujocco'\. Did you mean 'mujoco'"):
        run_trials(some[:1], engine="mujocco")
    with pytest.raises(InputError, match=r"unknown protocol 'papr'\. Did you mean 'paper'"):
        run_trials(some[:1], "papr")


@pytest.mark.parametrize("options", [{"n_threads": -1}, {"n_slots": 0}])
def test_threads_and_slots_that_cannot_be_are_refused(some: Grasps, short: Protocol, options: dict) -> None:
    with pytest.raises(InputError, match="threads must be at least 0 and slots at least 1"):
        run_trials(some, short, **options)


def test_joints_that_the_hand_does_not_have_are_refused(some: Grasps, short: Protocol) -> None:
    names = (*some.joint_names, "XXJ1")
    wider = np.concatenate([some.posture, np.zeros((len(some), 1))], axis=1)
    columns = some.columns() | {"posture": wider, "pregrasp": wider}
    with pytest.raises(InputError, match="shadow_hand_right has no joints XXJ1"):
        run_trials(Grasps.from_columns(some.hand, names, some.tasks, columns), short)

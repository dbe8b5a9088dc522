"""The nine objects: their measures, the sides a hand reaches round, and rotations that are the same grasp."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graspcascade.errors import InputError
from graspcascade.objects import AXES, CATALOGUE, DENSITY_KG_M3, MAX_SIDE_M, GraspObject, grasp_object
from graspcascade.poses import canonical_quat, quat_conjugate, quat_multiply, rotate, rotation_angle

SAME_RAD = 1e-6

every_object = pytest.mark.parametrize("obj", CATALOGUE.values(), ids=list(CATALOGUE))
MEDIUM = {label: obj for label, obj in CATALOGUE.items() if label.endswith("medium")}
each_shape = pytest.mark.parametrize("obj", MEDIUM.values(), ids=list(MEDIUM))
seeds = st.integers(0, 2**32 - 1)


def quats(*shape: int) -> st.SearchStrategy[np.ndarray]:
    drawn = hnp.arrays(float, (*shape, 4), elements=st.floats(-1.0, 1.0), fill=st.just(0.5))
    return drawn.filter(lambda quat: bool((np.linalg.norm(quat, axis=-1) > 0.1).all())).map(canonical_quat)


def random_quats(rng: np.random.Generator, n: int) -> np.ndarray:
    return canonical_quat(rng.normal(size=(n, 4)))


def dense_symmetries(obj: GraspObject) -> np.ndarray:
    """Spell the symmetry group out, independently of how folding goes about it."""
    if obj.shape == "box":
        return np.eye(4)
    half = np.linspace(0, np.pi, 721)[:-1]
    zero = np.zeros_like(half)
    spins = np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)
    flips = np.stack([zero, np.cos(half), np.sin(half), zero], axis=-1)
    return np.concatenate([spins, flips])


def margin_rad(obj: GraspObject, quat: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Measure how much farther the runner-up image is than the nearest: zero at a tie."""
    images = quat_multiply(quat[..., None, :], dense_symmetries(obj))
    angles = rotation_angle(reference[..., None, :], images)
    if obj.shape == "box":
        nearest = np.sort(angles, axis=-1)
        return nearest[..., 1] - nearest[..., 0]
    spun, flipped = np.split(angles, 2, axis=-1)
    return np.abs(spun.min(axis=-1) - flipped.min(axis=-1))


def surface_points(obj: GraspObject) -> np.ndarray:
    """Give corners of a box, rim points of a cylinder or points of a sphere, in the body frame."""
    half = np.array(obj.extents_m) / 2
    if obj.shape == "box":
        return np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * half
    if obj.shape == "cylinder":
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        rim = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=-1)
        return np.concatenate([rim, rim * [1, 1, -1]]) * half
    directions = np.random.default_rng(0).normal(size=(60, 3))
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True) * half


def on_surface(obj: GraspObject, points: np.ndarray) -> np.ndarray:
    """Tell which body-frame points are corners, rim points or surface points of the object."""
    half = np.array(obj.extents_m) / 2
    if obj.shape == "box":
        return np.isclose(np.abs(points), half, atol=1e-9).all(axis=-1)
    if obj.shape == "cylinder":
        radius = np.hypot(points[..., 0], points[..., 1])
        return np.isclose(radius, half[0], atol=1e-9) & np.isclose(np.abs(points[..., 2]), half[2], atol=1e-9)
    return np.isclose(np.linalg.norm(points, axis=-1), half[0], atol=1e-9)


# -- the symmetry group


@each_shape
@given(seed=seeds)
def test_a_symmetry_maps_the_object_onto_itself(obj: GraspObject, seed: int) -> None:
    symmetry = obj.random_symmetry(np.random.default_rng(seed), 8)
    assert symmetry.shape == (8, 4)
    np.testing.assert_allclose(np.linalg.norm(symmetry, axis=-1), 1.0)
    assert (symmetry[:, 0] >= 0).all()
    assert on_surface(obj, rotate(symmetry[:, None, :], surface_points(obj))).all()


@each_shape
@given(seed=seeds)
def test_symmetries_form_a_group(obj: GraspObject, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = obj.random_symmetry(rng, 16), obj.random_symmetry(rng, 16)
    points = surface_points(obj)
    for element in (quat_multiply(a, b), quat_conjugate(a), quat_multiply(a, quat_conjugate(a))):
        assert on_surface(obj, rotate(element[:, None, :], points)).all()


def test_a_box_has_four_symmetries_and_all_of_them_are_drawn() -> None:
    drawn = CATALOGUE["box_small"].random_symmetry(np.random.default_rng(1), 200)
    assert {tuple(row) for row in drawn.tolist()} == {(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)}


def test_a_cylinder_is_turned_about_its_axis_and_across_it() -> None:
    drawn = CATALOGUE["cylinder_small"].random_symmetry(np.random.default_rng(1), 400)
    axis = rotate(drawn, [0.0, 0.0, 1.0])[:, 2]
    assert np.isclose(np.abs(axis), 1.0).all()
    assert 120 < (axis > 0).sum() < 280
    turned = drawn[axis > 0]
    azimuth = 2 * np.arctan2(turned[:, 3], turned[:, 0])
    assert np.histogram(azimuth, bins=4, range=(-np.pi, np.pi))[0].min() > 20


def test_a_sphere_is_turned_every_way() -> None:
    pole = rotate(CATALOGUE["sphere_small"].random_symmetry(np.random.default_rng(1), 400), [0.0, 0.0, 1.0])
    assert np.abs(pole.mean(axis=0)).max() < 0.15


# -- folding: one rotation for all that are the same grasp


@each_shape
@given(quat=quats(6), reference=quats(), seed=seeds)
def test_folding_forgets_the_symmetry(obj: GraspObject, quat: np.ndarray, reference: np.ndarray, seed: int) -> None:
    symmetry = obj.random_symmetry(np.random.default_rng(seed), len(quat))
    clear = (
        margin_rad(obj, quat, np.broadcast_to(reference, quat.shape)) > 1e-4 if obj.shape != "sphere" else slice(None)
    )
    folded = obj.fold(quat, reference)
    same = obj.fold(quat_multiply(quat, symmetry), reference)
    assert (rotation_angle(folded, same)[clear] < SAME_RAD).all()


@each_shape
@given(quat=quats(6), reference=quats())
def test_folding_twice_is_folding_once(obj: GraspObject, quat: np.ndarray, reference: np.ndarray) -> None:
    folded = obj.fold(quat, reference)
    assert (rotation_angle(obj.fold(folded, reference), folded) < SAME_RAD).all()


@each_shape
@given(quat=quats(6), reference=quats())
def test_a_folded_rotation_places_the_object_where_the_original_does(
    obj: GraspObject, quat: np.ndarray, reference: np.ndarray
) -> None:
    folded = obj.fold(quat, reference)
    points_in_world = rotate(folded[:, None, :], surface_points(obj))
    points_in_original_body = rotate(quat_conjugate(quat)[:, None, :], points_in_world)
    assert on_surface(obj, points_in_original_body).all()
    if obj.shape == "box":  # the eight corners land on eight different corners
        corners = np.round(points_in_original_body / np.array(obj.extents_m) * 2).astype(int)
        assert all(len({tuple(corner) for corner in cube}) == 8 for cube in corners.tolist())


@each_shape
@given(quat=quats(6), reference=quats(), seed=seeds)
def test_no_symmetric_image_is_nearer_to_the_reference_than_the_folded_one(
    obj: GraspObject, quat: np.ndarray, reference: np.ndarray, seed: int
) -> None:
    symmetry = obj.random_symmetry(np.random.default_rng(seed), 300)
    images = quat_multiply(quat[:, None, :], symmetry)
    nearest = rotation_angle(obj.fold(quat, reference), reference)
    assert (nearest[:, None] <= rotation_angle(images, reference) + SAME_RAD).all()
    assert (nearest <= rotation_angle(quat, reference) + SAME_RAD).all()


@each_shape
@given(quat=quats(6), reference=quats())
def test_folding_reads_a_quaternion_and_its_negative_alike(
    obj: GraspObject, quat: np.ndarray, reference: np.ndarray
) -> None:
    folded = obj.fold(quat, reference)
    assert (folded[:, 0] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(folded, axis=-1), 1.0)
    assert (rotation_angle(obj.fold(-quat, reference), folded) < SAME_RAD).all()
    assert (rotation_angle(obj.fold(quat, -reference), folded) < SAME_RAD).all()


@each_shape
@given(quat=quats(4), reference=quats(), frame=quats())
def test_folding_does_not_depend_on_the_frame(
    obj: GraspObject, quat: np.ndarray, reference: np.ndarray, frame: np.ndarray
) -> None:
    if obj.shape != "sphere":
        assume((margin_rad(obj, quat, np.broadcast_to(reference, quat.shape)) > 1e-4).all())
    elsewhere = obj.fold(quat_multiply(frame, quat), quat_multiply(frame, reference))
    assert (rotation_angle(elsewhere, quat_multiply(frame, obj.fold(quat, reference))) < SAME_RAD).all()


@each_shape
@given(reference=quats(), seed=seeds)
def test_every_image_of_the_reference_folds_to_the_reference(
    obj: GraspObject, reference: np.ndarray, seed: int
) -> None:
    images = quat_multiply(reference, obj.random_symmetry(np.random.default_rng(seed), 8))
    assert (rotation_angle(obj.fold(images, reference), reference) < SAME_RAD).all()


@each_shape
def test_folding_a_batch_folds_each_rotation_by_its_own_reference(obj: GraspObject) -> None:
    rng = np.random.default_rng(3)
    quat, reference = random_quats(rng, 12).reshape(3, 4, 4), random_quats(rng, 12).reshape(3, 4, 4)
    folded = obj.fold(quat, reference)
    assert folded.shape == quat.shape
    for index in np.ndindex(3, 4):
        np.testing.assert_allclose(folded[index], obj.fold(quat[index], reference[index]), atol=1e-12)
    assert obj.fold(np.zeros((0, 4)), reference[0, 0]).shape == (0, 4)


def test_a_box_is_never_more_than_two_thirds_of_a_turn_from_its_reference() -> None:
    rng = np.random.default_rng(4)
    quat, reference = random_quats(rng, 4000), random_quats(rng, 4000)
    angle = rotation_angle(CATALOGUE["box_large"].fold(quat, reference), reference)
    assert angle.max() <= 2 * np.pi / 3 + SAME_RAD
    assert rotation_angle(quat, reference).max() > 3.0


def test_a_cylinder_is_never_more_than_a_quarter_turn_from_its_reference() -> None:
    rng = np.random.default_rng(5)
    quat, reference = random_quats(rng, 4000), random_quats(rng, 4000)
    angle = rotation_angle(CATALOGUE["cylinder_large"].fold(quat, reference), reference)
    assert angle.max() <= np.pi / 2 + SAME_RAD


def test_a_sphere_always_folds_to_its_reference() -> None:
    rng = np.random.default_rng(6)
    reference = random_quats(rng, 50)
    np.testing.assert_allclose(CATALOGUE["sphere_small"].fold(random_quats(rng, 50), reference), reference)


def test_a_rotation_exactly_between_two_images_folds_the_same_way_despite_rounding() -> None:
    box, between = CATALOGUE["box_small"], np.array([1.0, 1.0, 0.0, 0.0]) / np.sqrt(2)
    folded = box.fold(between, [1.0, 0.0, 0.0, 0.0])
    for noise in np.random.default_rng(7).normal(scale=1e-15, size=(50, 4)):
        assert rotation_angle(box.fold(between + noise, [1.0, 0.0, 0.0, 0.0]), folded) < SAME_RAD


# -- measures


def test_the_catalogue_has_the_nine_objects_of_the_design() -> None:
    assert {label: tuple(round(extent * 1000, 6) for extent in obj.extents_m) for label, obj in CATALOGUE.items()} == {
        "box_small": (20, 30, 40),
        "box_medium": (30, 45, 60),
        "box_large": (40, 55, 70),
        "cylinder_small": (20, 20, 50),
        "cylinder_medium": (35, 35, 70),
        "cylinder_large": (50, 50, 90),
        "sphere_small": (30, 30, 30),
        "sphere_medium": (45, 45, 45),
        "sphere_large": (60, 60, 60),
    }
    assert all(obj.label == label and label.startswith(obj.shape) for label, obj in CATALOGUE.items())
    assert pytest.approx(0.065) == MAX_SIDE_M


@pytest.mark.parametrize(
    ("label", "graspable_mm"),
    [
        ("box_small", {"x": 20, "y": 30, "z": 40}),
        ("box_medium", {"x": 30, "y": 45, "z": 60}),
        ("box_large", {"x": 40, "y": 55}),
        ("cylinder_small", {"x": 20, "z": 50}),
        ("cylinder_medium", {"x": 35}),
        ("cylinder_large", {"x": 50}),
        ("sphere_small", {"x": 30}),
        ("sphere_medium", {"x": 45}),
        ("sphere_large", {"x": 60}),
    ],
)
def test_the_graspable_sides_are_those_within_reach(label: str, graspable_mm: dict[str, float]) -> None:
    assert {axis: round(side * 1000, 6) for axis, side in CATALOGUE[label].graspable_sides_m.items()} == graspable_mm


@given(st.floats(0.001, 0.2))
def test_a_side_is_graspable_up_to_and_including_the_reach(extent_m: float) -> None:
    assume(abs(extent_m - MAX_SIDE_M) > 1e-8)
    ball = GraspObject("ball", "sphere", (extent_m, extent_m, extent_m))
    assert bool(ball.graspable_sides_m) == (extent_m < MAX_SIDE_M)
    exact = GraspObject("exact", "box", (MAX_SIDE_M, MAX_SIDE_M, 0.2))
    assert list(exact.graspable_sides_m) == ["x", "y"]


@pytest.mark.parametrize(
    ("label", "volume_cm3", "mass_g"),
    [
        ("box_small", 24.0, 14.4),
        ("box_medium", 81.0, 48.6),
        ("box_large", 154.0, 92.4),
        ("cylinder_small", 15.70796, 9.42478),
        ("cylinder_medium", 67.34788, 40.40873),
        ("cylinder_large", 176.71459, 106.02875),
        ("sphere_small", 14.13717, 8.48230),
        ("sphere_medium", 47.71294, 28.62776),
        ("sphere_large", 113.09734, 67.85840),
    ],
)
def test_volumes_and_masses_follow_from_the_extents(label: str, volume_cm3: float, mass_g: float) -> None:
    volume_m3 = CATALOGUE[label].volume_m3
    assert volume_m3 * 1e6 == pytest.approx(volume_cm3, rel=1e-5)
    assert volume_m3 * DENSITY_KG_M3 * 1e3 == pytest.approx(mass_g, rel=1e-5)


@every_object
def test_the_volume_is_the_share_of_the_bounding_box_that_the_shape_fills(obj: GraspObject) -> None:
    points = np.random.default_rng(0).uniform(-1, 1, size=(20000, 3))
    inside = {
        "box": np.ones(len(points), dtype=bool),
        "cylinder": np.hypot(points[:, 0], points[:, 1]) <= 1,
        "sphere": np.linalg.norm(points, axis=-1) <= 1,
    }[obj.shape]
    assert obj.volume_m3 / np.prod(obj.extents_m) == pytest.approx(inside.mean(), abs=0.02)


# -- asking for a side


@every_object
def test_every_graspable_side_is_found_by_axis_and_by_length(obj: GraspObject) -> None:
    for axis, side_m in obj.graspable_sides_m.items():
        assert obj.side_axis(axis) == axis
        assert obj.side_axis_of_length(side_m) == axis


@every_object
@given(offset_m=st.floats(-0.00049, 0.00049))
def test_a_length_may_be_half_a_millimetre_off(obj: GraspObject, offset_m: float) -> None:
    for axis, side_m in obj.graspable_sides_m.items():
        assert obj.side_axis_of_length(side_m + offset_m) == axis


@every_object
@given(side_m=st.floats(0.0005, 0.5))
def test_a_length_the_object_does_not_have_is_refused_with_the_sides_it_has(obj: GraspObject, side_m: float) -> None:
    assume(all(abs(side_m - side) > 0.00051 for side in obj.sides_m.values()))
    with pytest.raises(InputError) as caught:
        obj.side_axis_of_length(side_m)
    message = str(caught.value)
    assert obj.label in message
    assert obj.describe_sides() in message
    assert ("beyond the hand's reach of 6.5 cm" in message) == (side_m > MAX_SIDE_M)


@pytest.mark.parametrize(("label", "axis"), [("box_large", "z"), ("cylinder_medium", "z"), ("cylinder_large", "z")])
def test_a_side_beyond_reach_is_refused_with_the_sides_within_it(label: str, axis: str) -> None:
    obj = CATALOGUE[label]
    expected = f"beyond the hand's reach of 6.5 cm. Graspable sides: {obj.describe_sides()}."
    with pytest.raises(InputError) as by_axis:
        obj.side_axis(axis)
    with pytest.raises(InputError) as by_length:
        obj.side_axis_of_length(obj.sides_m[axis])
    assert expected in str(by_axis.value)
    assert expected in str(by_length.value)


def test_sides_are_worded_in_centimetres_by_axis() -> None:
    assert CATALOGUE["box_large"].describe_sides() == "x = 4 cm, y = 5.5 cm"
    assert CATALOGUE["cylinder_small"].describe_sides() == "x = 2 cm, z = 5 cm"


@pytest.mark.parametrize(
    ("label", "axis", "equal"),
    [
        ("cylinder_small", "y", "x"),
        ("cylinder_large", "y", "x"),
        ("sphere_small", "z", "x"),
        ("sphere_large", "y", "x"),
    ],
)
def test_an_axis_equal_by_symmetry_is_named_by_its_first(label: str, axis: str, equal: str) -> None:
    assert CATALOGUE[label].side_axis(axis) == equal


@every_object
@given(axis=st.text(max_size=5).filter(lambda text: text not in AXES))
def test_an_axis_that_does_not_exist_is_refused(obj: GraspObject, axis: str) -> None:
    with pytest.raises(InputError, match=r"unknown side axis .* Valid: x"):
        obj.side_axis(axis)


@pytest.mark.parametrize("side_m", [0.0, -0.03, np.nan, np.inf, -np.inf])
def test_a_side_must_be_a_positive_length(side_m: float) -> None:
    with pytest.raises(InputError, match=r"a side must be a positive length, got .* cm"):
        CATALOGUE["box_medium"].side_axis_of_length(side_m)


# -- asking for an object


@every_object
def test_every_object_is_found_by_its_label_however_it_is_written(obj: GraspObject) -> None:
    for written in (obj.label, obj.label.upper(), obj.label.replace("_", "-"), f" {obj.label} "):
        assert grasp_object(written) is obj


@pytest.mark.parametrize(
    ("given_label", "nearest"),
    [("box_mediun", "box_medium"), ("sphere", "sphere_"), ("cylinder_lrage", "cylinder_large")],
)
def test_an_unknown_object_is_refused_and_the_nearest_one_named(given_label: str, nearest: str) -> None:
    with pytest.raises(
        InputError, match=rf"unknown object '{given_label}'\. Did you mean '{nearest}.*Valid: box_small, "
    ):
        grasp_object(given_label)


def test_an_object_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        CATALOGUE["box_small"].label = "other"  # type: ignore[misc]

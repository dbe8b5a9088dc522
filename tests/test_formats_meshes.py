"""Object meshes: closed, convex, outward, of the object's size, and loadable by the engine that the benchmark runs."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE, Array, Shape
from graspcascade.formats import ExportOptions, save_grasps
from graspcascade.worlds.meshes import shape_mesh, write_obj

TARGET = ExportOptions(contact="target")
every_object = pytest.mark.parametrize("label", list(CATALOGUE))


@every_object
def test_a_mesh_is_closed_convex_and_faces_outwards(label: str) -> None:
    mesh = shape_mesh(CATALOGUE[label].shape)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.is_convex
    assert mesh.euler_number == 2
    assert (np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles_center) > 0).all()


@every_object
def test_a_mesh_has_the_objects_extents_and_volume(label: str) -> None:
    obj, mesh = CATALOGUE[label], shape_mesh(CATALOGUE[label].shape)
    np.testing.assert_allclose(mesh.extents, obj.extents_m, rtol=2e-3)
    np.testing.assert_allclose(mesh.bounds.sum(axis=0), 0.0, atol=1e-15)
    assert 0.99 * obj.shape.volume_m3 < mesh.volume <= obj.shape.volume_m3 * (1 + 1e-12)


@every_object
def test_a_meshs_vertices_lie_on_the_surface(label: str) -> None:
    obj, mesh = CATALOGUE[label], shape_mesh(CATALOGUE[label].shape)
    half = np.array(obj.extents_m) / 2
    unit = np.abs(mesh.vertices) / half
    if obj.shape.kind == "sphere":
        distance = np.linalg.norm(unit, axis=1)
    elif obj.shape.kind == "cylinder":
        distance = np.maximum(np.hypot(unit[:, 0], unit[:, 1]), unit[:, 2])
    else:
        distance = unit.max(axis=1)
    np.testing.assert_allclose(distance, 1.0, atol=1e-9)


def test_a_shape_that_is_none_of_ours_is_not_taken_for_a_ball() -> None:
    class Wedge(Shape):
        def _images(self, quat: Array, reference: Array) -> Array:
            return quat

    with pytest.raises(NotImplementedError, match="no mesh for a Wedge"):
        shape_mesh(Wedge())


@every_object
def test_an_obj_file_holds_the_mesh_to_the_last_bit(label: str, tmp_path: Path) -> None:
    mesh = shape_mesh(CATALOGUE[label].shape)
    write_obj(tmp_path / "m.obj", mesh)
    lines = [line.split() for line in (tmp_path / "m.obj").read_text().splitlines()]
    vertices = np.array([[float(v) for v in line[1:]] for line in lines if line[0] == "v"])
    triangles = np.array([[int(v) - 1 for v in line[1:]] for line in lines if line[0] == "f"])
    np.testing.assert_array_equal(vertices, mesh.vertices)
    np.testing.assert_array_equal(triangles, mesh.faces)


def test_dexgraspbench_objects_weigh_what_the_benchmark_asks_for(drawn: Grasps, tmp_path: Path) -> None:
    save_grasps(tmp_path / "bench", drawn, metadata={}, format="dexgraspbench", options=TARGET)
    assert {p.name for p in (tmp_path / "bench" / "objects").iterdir()} == set(CATALOGUE)
    for label, obj in CATALOGUE.items():
        folder = tmp_path / "bench" / "objects" / label
        info = json.loads((folder / "info" / "simplified.json").read_text())
        assert info == {"mass": pytest.approx(obj.shape.volume_m3, rel=0.01), "density": 1.0, "scale": 1.0}
        (piece,) = (folder / "urdf" / "meshes").iterdir()
        spec = mujoco.MjSpec()
        spec.add_mesh(name="piece", file=str(piece))
        body = spec.worldbody.add_body(name="object")
        body.add_freejoint()
        # The benchmark gives the mesh the density at which an object of this volume has the mass it wants.
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="piece", density=0.1 / info["mass"])
        model = spec.compile()
        assert model.body("object").mass[0] == pytest.approx(0.1, rel=1e-4)
        np.testing.assert_allclose(model.body("object").ipos, 0.0, atol=1e-9)


def test_dexgraspnet_objects_are_beside_their_grasps(drawn: Grasps, tmp_path: Path) -> None:
    save_grasps(tmp_path / "net", drawn, metadata={}, format="dexgraspnet", options=TARGET)
    for label in CATALOGUE:
        assert (tmp_path / "net" / "dataset" / f"{label}.npy").is_file()
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "net" / "meshdata" / label / "coacd" / "coacd.urdf"))
        assert model.ngeom >= 1

"""Object meshes: closed, convex, outward, of the object's size, and loadable by the engine that the benchmark runs."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from graspcascade.formats import save_grasps
from graspcascade.formats.meshes import Mesh, object_mesh, write_obj
from graspcascade.grasps import Grasps
from graspcascade.objects import CATALOGUE

every_object = pytest.mark.parametrize("label", list(CATALOGUE))


@every_object
def test_a_mesh_is_closed_convex_and_faces_outwards(label: str) -> None:
    mesh = object_mesh(CATALOGUE[label])
    edges = np.concatenate([mesh.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    directed = {tuple(edge) for edge in edges.tolist()}
    assert len(directed) == len(edges)
    assert directed == {(b, a) for a, b in directed}
    assert len(mesh.vertices_m) - len(edges) // 2 + len(mesh.triangles) == 2
    a, b, c = np.moveaxis(mesh.vertices_m[mesh.triangles], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert (np.einsum("ij,ij->i", normal, a) > 0).all()
    beyond = mesh.vertices_m @ normal.T - np.einsum("ij,ij->i", normal, a)
    assert beyond.max() < 1e-12


@every_object
def test_a_mesh_has_the_objects_extents_and_volume(label: str) -> None:
    obj, mesh = CATALOGUE[label], object_mesh(CATALOGUE[label])
    np.testing.assert_allclose(np.ptp(mesh.vertices_m, axis=0), obj.extents_m, rtol=2e-3)
    np.testing.assert_allclose(mesh.vertices_m.max(axis=0), -mesh.vertices_m.min(axis=0), atol=1e-15)
    assert 0.99 * obj.volume_m3 < mesh.volume_m3 <= obj.volume_m3 * (1 + 1e-12)


def test_the_volume_of_a_known_tetrahedron() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    mesh = Mesh(corners + 5.0, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    assert mesh.volume_m3 == pytest.approx(1 / 6)


@every_object
def test_an_obj_file_holds_the_mesh_to_the_last_bit(label: str, tmp_path: Path) -> None:
    mesh = object_mesh(CATALOGUE[label])
    write_obj(tmp_path / "m.obj", mesh)
    lines = [line.split() for line in (tmp_path / "m.obj").read_text().splitlines()]
    vertices = np.array([[float(v) for v in line[1:]] for line in lines if line[0] == "v"])
    triangles = np.array([[int(v) - 1 for v in line[1:]] for line in lines if line[0] == "f"])
    np.testing.assert_array_equal(vertices, mesh.vertices_m)
    np.testing.assert_array_equal(triangles, mesh.triangles)


def test_dexgraspbench_objects_weigh_what_the_benchmark_asks_for(drawn: Grasps, tmp_path: Path) -> None:
    save_grasps(tmp_path / "bench", drawn, metadata={}, format="dexgraspbench")
    assert {p.name for p in (tmp_path / "bench" / "objects").iterdir()} == set(CATALOGUE)
    for label, obj in CATALOGUE.items():
        folder = tmp_path / "bench" / "objects" / label
        info = json.loads((folder / "info" / "simplified.json").read_text())
        assert info == {"mass": pytest.approx(obj.volume_m3, rel=0.01), "density": 1.0, "scale": 1.0}
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
    save_grasps(tmp_path / "net", drawn, metadata={}, format="dexgraspnet")
    for label in CATALOGUE:
        assert (tmp_path / "net" / "dataset" / f"{label}.npy").is_file()
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "net" / "meshdata" / label / "coacd" / "coacd.urdf"))
        assert model.ngeom >= 1

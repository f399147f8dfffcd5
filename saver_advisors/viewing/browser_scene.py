"""Mirror the geometry of a MuJoCo model in a scene of viser, https://viser.studio."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from saver_envs.robots.description import COLLISION_GROUP

_GEOM: Final = mujoco.mjtGeom
ENDLESS: Final = 3.0
"""Half size of a plane that MuJoCo draws without an end, metres."""
_MOST_GEOMS: Final = 2000
_VISIBLE: Final = 1e-4
"""Skins are sent again once a vertex has moved this far, metres."""


class _Mesh(NamedTuple):
    """A geom as a mesh in its own frame."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    flat: bool


class BrowserScene:
    """Keeps meshes in browsers equal to what MuJoCo would draw of a state.

    :param server: of viser
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._model: mujoco.MjModel | None = None
        self._options = mujoco.MjvOption()
        self._options.geomgroup[COLLISION_GROUP] = 0
        self._handles: dict[int, Any] = {}
        self._looks: dict[int, tuple[Any, ...]] = {}
        self._poses: dict[int, NDArray[np.float64]] = {}

    def update(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Show a state.

        :param model: what is drawn
        :param data: of the model, with kinematics up to date
        """
        if model is not self._model:
            self._model = model
            self._scene = mujoco.MjvScene(model, maxgeom=_MOST_GEOMS)
            self._looks.clear()
        everything, camera = mujoco.mjtCatBit.mjCAT_ALL, mujoco.MjvCamera()
        mujoco.mjv_updateScene(
            *(model, data, self._options, mujoco.MjvPerturb(), camera, everything, self._scene)
        )
        shown = self._scene.geoms[: self._scene.ngeom]
        for index in set(self._handles) - set(range(len(shown))):
            self._handles.pop(index).remove()
            self._looks.pop(index, None)
        for index, geom in enumerate(shown):
            self._show(index, geom)

    def _show(self, index: int, geom: Any) -> None:
        look = (geom.type, geom.dataid, geom.objid, geom.size.tobytes(), geom.rgba.tobytes())
        if self._looks.get(index) != look:
            self._add(index, geom)
            self._looks[index] = look
            self._poses.pop(index, None)
        handle = self._handles[index]
        if geom.type == _GEOM.mjGEOM_SKIN:
            vertices = self._skin(geom.objid)
            if np.abs(vertices - handle.vertices).max() > _VISIBLE:
                handle.vertices = vertices
            return
        pose = np.array([*geom.pos, *geom.mat.ravel()])
        shown = self._poses.get(index)
        if shown is None or not np.array_equal(pose, shown):
            self._poses[index] = pose
            quaternion = np.empty(4)
            mujoco.mju_mat2Quat(quaternion, pose[3:])
            handle.position, handle.wxyz = pose[:3], quaternion

    def _add(self, index: int, geom: Any) -> None:
        if index in self._handles:
            self._handles.pop(index).remove()
        mesh = self._mesh_of(geom)
        colour = np.clip(255 * geom.rgba, 0, 255).round().astype(int)
        self._handles[index] = self._server.scene.add_mesh_simple(
            f"/geoms/{index}",
            mesh.vertices,
            mesh.faces,
            color=tuple(colour[:3].tolist()),
            opacity=None if geom.rgba[3] >= 1 else float(geom.rgba[3]),
            flat_shading=mesh.flat,
            side="double" if geom.type == _GEOM.mjGEOM_PLANE else "front",
        )

    def _mesh_of(self, geom: Any) -> _Mesh:
        assert self._model is not None
        model, size, kind = self._model, geom.size.astype(float), geom.type
        if kind == _GEOM.mjGEOM_MESH:
            mesh = geom.dataid // 2  # odd ones are convex hulls
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            begin, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
            vertices = model.mesh_vert[first : first + count]
            return _Mesh(vertices, model.mesh_face[begin : begin + faces], flat=False)
        if kind == _GEOM.mjGEOM_SKIN:
            begin, faces = model.skin_faceadr[geom.objid], model.skin_facenum[geom.objid]
            skin = self._skin(geom.objid)
            return _Mesh(skin, model.skin_face[begin : begin + faces], flat=False)
        if kind == _GEOM.mjGEOM_PLANE:
            x, y = np.where(size[:2] > 0, size[:2], ENDLESS)
            corners = np.array([(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)], np.float32)
            return _Mesh(corners, np.array([(0, 1, 2), (0, 2, 3)], np.int32), flat=True)
        if kind == _GEOM.mjGEOM_BOX:
            shape = trimesh.creation.box(extents=2 * size)
        elif kind == _GEOM.mjGEOM_CYLINDER:
            shape = trimesh.creation.cylinder(radius=size[0], height=2 * size[2])
        elif kind == _GEOM.mjGEOM_CAPSULE:
            shape = trimesh.creation.capsule(radius=size[0], height=2 * size[2])
        else:  # a sphere or an ellipsoid; our scenes have nothing else
            shape = trimesh.creation.icosphere(subdivisions=3)
            shape.apply_scale(size)
        flat = kind in (_GEOM.mjGEOM_BOX, _GEOM.mjGEOM_CYLINDER)
        return _Mesh(shape.vertices.astype(np.float32), shape.faces.astype(np.int32), flat)

    def _skin(self, skin: int) -> NDArray[np.float32]:
        """Return the present vertices (k, 3) of a skin, world frame, metres."""
        first, count = self._scene.skinvertadr[skin], self._scene.skinvertnum[skin]
        vertices = self._scene.skinvert.reshape(-1, 3)[first : first + count]
        return np.array(vertices, np.float32)

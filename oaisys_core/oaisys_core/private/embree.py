"""The C interface of the Embree library that comes with Blender: rays at meshes and instances.

Private part: ``libembree4.so.4`` as Blender has loaded it, called by ctypes. Open3D and embreex
    wrap Embree, too, but neither of them exposes its instances.
Tried with: Embree 4.4.0 of bpy 4.5.15, Embree 4.4.1 of bpy 5.2.3.
Public way without it: Open3D's rays at single meshes, for instances at copies of them or by their
    boxes (`oaisys_core.raycast.instance_boxes`). The images are the same.
Lost without it: time; rays at 100,000 rocks take ten times as long, and their structure 2.7 s.
"""

from __future__ import annotations

import sys
import weakref
from collections.abc import Sequence
from ctypes import CDLL, PyDLL, c_char_p, c_int, c_size_t, c_ssize_t, c_uint, c_void_p
from functools import cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import RenderError
from oaisys_core.private.embree_loop import cast_packets
from oaisys_core.system.fallbacks import report_fallback
from oaisys_core.types import FloatArray

LIBRARY = "libembree4.so.4"
"""Blender has loaded it already, so the dynamic linker finds it without a path."""

MIN_VERSION = 40300
"""First version with instance arrays: 4.3.0 in Embree's notation."""

VERSION, TRIANGLES_SUPPORTED = 0, 96
TRIANGLE, INSTANCE_ARRAY = 0, 122
INDEX, VERTEX, TRANSFORM = 0, 1, 23
UINT3, FLOAT3, FLOAT3X4_COLUMN_MAJOR = 0x5003, 0x9003, 0x9234
ROBUST = 4
"""Values of ``RTCDeviceProperty``, ``RTCGeometryType``, ``RTCBufferType``, ``RTCFormat`` and
``RTCSceneFlags``."""

PACKET, FIELDS, RAY_FIELDS = 8, 21, 12
"""Rays per call, and 32-bit fields per ray, of an ``RTCRayHit8`` and of an ``RTCRay8``: the most
that Embree casts together without AVX-512."""
ORIGIN, NEAR, DIRECTION, TIME, FAR, MASK, FLAGS = slice(0, 3), 3, slice(4, 7), 7, 8, 9, 11
PRIMITIVE, INSTANCE, INSTANCE_PRIMITIVE = 17, 19, 20
"""Indices of fields."""

COHERENT_RAYS, ALL_FEATURES = 1 << 16, 0xFFFFFFFF
"""Values of ``RTCRayQueryFlags`` and ``RTCFeatureFlags``."""

ARGUMENT_BYTES = 128
"""More than any version's arguments of a call; what follows the first two fields is 0."""

INVALID_ID = 0xFFFFFFFF
"""Id that Embree gives where a ray hit nothing."""

ALIGNMENT = 64
"""Bytes, of the memory that Embree reads rays from."""

_SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    "rtcNewDevice": (c_void_p, [c_char_p]),
    "rtcGetDeviceProperty": (c_ssize_t, [c_void_p, c_int]),
    "rtcGetDeviceError": (c_int, [c_void_p]),
    "rtcNewScene": (c_void_p, [c_void_p]),
    "rtcSetSceneFlags": (None, [c_void_p, c_int]),
    "rtcCommitScene": (None, [c_void_p]),
    "rtcReleaseScene": (None, [c_void_p]),
    "rtcNewGeometry": (c_void_p, [c_void_p, c_int]),
    "rtcSetSharedGeometryBuffer": (
        None,
        [c_void_p, c_int, c_uint, c_int, c_void_p, *[c_size_t] * 3],
    ),
    "rtcSetGeometryInstancedScene": (None, [c_void_p, c_void_p]),
    "rtcCommitGeometry": (None, [c_void_p]),
    "rtcAttachGeometry": (c_uint, [c_void_p, c_void_p]),
    "rtcReleaseGeometry": (None, [c_void_p]),
    "rtcIntersect8": (None, [c_void_p] * 4),
    "rtcOccluded8": (None, [c_void_p] * 4),
}


class Embree:
    """Builds scenes that rays can be cast at."""

    def __init__(self, library: CDLL) -> None:
        """Declare the library's functions and open a device.

        Raises:
            RenderError: The library is too old, or was built without triangles.
        """
        self.library = library
        # Calls of a microsecond must not let another thread take Python's lock each time.
        self.held = PyDLL(LIBRARY)
        for name, (result, arguments) in _SIGNATURES.items():
            for each in (library, self.held):
                function = getattr(each, name)
                function.restype, function.argtypes = result, arguments
        self._device = library.rtcNewDevice(b"")
        version, triangles = (
            library.rtcGetDeviceProperty(self._device, each)
            for each in (VERSION, TRIANGLES_SUPPORTED)
        )
        if version < MIN_VERSION or not triangles:
            raise RenderError(
                f"Embree: received version {version}, expected {MIN_VERSION} or later"
            )
        self._kept: WeakKeyDictionary[Any, EmbreeScene] = WeakKeyDictionary()

    def mesh(self, vertices_m: FloatArray, triangles: NDArray[np.int32]) -> EmbreeScene:
        """Return a scene of (V, 3) vertices and (T, 3) triangles."""
        # Embree reads 16 bytes per vertex, so the last one needs padding.
        corners = np.zeros((len(vertices_m) + 1, 3), np.float32)
        corners[:-1] = vertices_m
        indices = np.ascontiguousarray(triangles, np.uint32)
        geometry = self._geometry(TRIANGLE)
        self._share(geometry, VERTEX, FLOAT3, corners, len(vertices_m))
        self._share(geometry, INDEX, UINT3, indices, len(indices))
        return self._scene([geometry], [corners, indices])

    def keep_mesh(
        self, owner: object, vertices_m: FloatArray, triangles: NDArray[np.int32]
    ) -> EmbreeScene:
        """Return `mesh` of the same arrays, made once and kept as long as ``owner``."""
        scene = self._kept.get(owner)
        if scene is None:
            scene = self._kept[owner] = self.mesh(vertices_m, triangles)
        return scene

    def instances(
        self, meshes: Sequence[EmbreeScene], poses: Sequence[NDArray[np.float64]]
    ) -> EmbreeScene:
        """Return a scene with one instance of each mesh at each of its (N, 4, 4) poses."""
        geometries: list[Any] = []
        kept: list[Any] = []
        for mesh, T in zip(meshes, poses, strict=True):
            columns = np.ascontiguousarray(T[:, :3].transpose(0, 2, 1), np.float32)
            geometry = self._geometry(INSTANCE_ARRAY)
            self.library.rtcSetGeometryInstancedScene(geometry, mesh.handle)
            self._share(geometry, TRANSFORM, FLOAT3X4_COLUMN_MAJOR, columns, len(columns))
            geometries.append(geometry)
            kept += [mesh, columns]
        return self._scene(geometries, kept)

    def _geometry(self, kind: int) -> Any:
        return self.library.rtcNewGeometry(self._device, kind)

    def _share(self, geometry: Any, kind: int, form: int, values: NDArray[Any], count: int) -> None:
        stride = values.strides[0]
        address = values.ctypes.data
        self.library.rtcSetSharedGeometryBuffer(geometry, kind, 0, form, address, 0, stride, count)

    def _scene(self, geometries: Sequence[Any], kept: Sequence[Any]) -> EmbreeScene:
        library = self.library
        handle = library.rtcNewScene(self._device)
        scene = EmbreeScene(library, self.held, handle, kept)
        library.rtcSetSceneFlags(handle, ROBUST)
        for geometry in geometries:
            library.rtcCommitGeometry(geometry)
            library.rtcAttachGeometry(handle, geometry)
            library.rtcReleaseGeometry(geometry)
        library.rtcCommitScene(handle)
        error = library.rtcGetDeviceError(self._device)
        if error:
            raise RenderError(f"Embree failed with its error {error}")
        return scene


class EmbreeScene:
    """A scene that rays can be cast at; a scene of its instances keeps it alive."""

    def __init__(self, library: CDLL, held: PyDLL, handle: Any, kept: Sequence[Any]) -> None:
        """Own a handle, and keep alive the arrays and scenes that it refers to.

        ``held`` is the library, called without releasing Python's lock.
        """
        self.handle = handle
        self._held = held
        self._kept = kept
        weakref.finalize(self, library.rtcReleaseScene, handle).atexit = False

    def nearest(
        self, origins: FloatArray, directions: FloatArray, limits: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """Return the first hit of each ray.

        Args:
            origins: (R, 3), or (3,) for all rays.
            directions: (R, 3) of any length.
            limits: (R,) lengths of the rays, in units of the directions' lengths.

        Returns:
            (R,) distances in the same units, the limit for a miss, and (3, R) indices of mesh,
            instance of that mesh, and triangle, all `INVALID_ID` for a miss. In a scene of one
            mesh without instances, only the triangle is valid.
        """
        count = len(directions)
        packets = _packets_of(origins, directions, limits, FIELDS)
        ids = packets.view(np.uint32)
        # Not as coherent rays: of two triangles at their edge, these may hit the other one.
        self._cast(packets, self._held.rtcIntersect8, None)
        places = (INSTANCE, INSTANCE_PRIMITIVE, PRIMITIVE)
        found = np.stack([ids[:, place].ravel()[:count] for place in places])
        return packets[:, FAR].ravel()[:count], found

    def first(
        self, origins: FloatArray, directions: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """See `TriangleBvh.first`; only for a scene without instances."""
        distances, ids = self.nearest(origins, directions, np.full(len(directions), np.inf))
        return distances, ids[-1]

    def occludes(self, origins: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        """See `TriangleBvh.occludes`; also for a scene of instances."""
        limits = np.full(len(directions), np.inf)
        packets = _packets_of(origins, directions, limits, RAY_FIELDS)
        arguments = np.zeros(ARGUMENT_BYTES // 4, np.uint32)
        arguments[:2] = COHERENT_RAYS, ALL_FEATURES
        self._cast(packets, self._held.rtcOccluded8, arguments.ctypes.data)
        # Embree sets the length of a ray that hits something to minus infinity.
        return np.asarray(packets[:, FAR].ravel()[: len(directions)] < 0)

    def prepare(self) -> None:
        """See `TriangleBvh.prepare`; the scene is built already."""

    def _cast(self, packets: NDArray[np.float32], function: Any, arguments: int | None) -> None:
        """Write the hits into packets of rays.

        ``arguments`` is the address of Embree's arguments of a call; None: its own.
        """
        valid = _allocate_aligned((PACKET,), np.int32)
        valid[:] = -1
        cast_packets(function, valid.ctypes.data, self.handle, packets, arguments)


@cache
def blenders_embree() -> Embree | None:
    """Return Embree as Blender has loaded it; None without Blender, or with another version."""
    try:
        return Embree(CDLL(LIBRARY))
    except (OSError, AttributeError, RenderError) as error:
        if "bpy" in sys.modules:
            instead = "Open3D casts all rays, which takes longer where there are many objects"
            report_fallback("Blender's Embree", str(error), instead)
        return None


def _packets_of(
    origins: FloatArray, directions: FloatArray, limits: FloatArray, fields: int
) -> NDArray[np.float32]:
    """Return rays as a (packets, fields, PACKET) array."""
    packets = _allocate_aligned((-(-len(directions) // PACKET), fields, PACKET), np.float32)
    packets[:, (NEAR, TIME)] = 0.0
    ids = packets.view(np.uint32)
    ids[:, MASK:] = INVALID_ID
    ids[:, FLAGS] = 0
    _fill(packets[:, ORIGIN], np.broadcast_to(origins, directions.shape), 0.0)
    _fill(packets[:, DIRECTION], directions, 0.0)
    # The last packet is filled up with rays of negative length, which hit nothing.
    _fill(packets[:, FAR : FAR + 1], limits[:, None], -np.inf)
    return packets


def _allocate_aligned(shape: tuple[int, ...], dtype: type[np.generic]) -> NDArray[Any]:
    """Return an uninitialised array that is aligned to `ALIGNMENT` bytes."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = np.empty(size + ALIGNMENT, np.uint8)
    first = -memory.ctypes.data % ALIGNMENT
    return memory[first : first + size].view(dtype).reshape(shape)


def _fill(fields: NDArray[np.float32], values: FloatArray, rest: float) -> None:
    """Write (R, F) values of rays into (P, F, PACKET) fields, and ``rest`` behind the last ray."""
    whole, width = len(values) // PACKET, values.shape[1]
    fields[:whole] = values[: whole * PACKET].reshape(whole, PACKET, width).transpose(0, 2, 1)
    if whole < len(fields):
        fields[whole] = rest
        fields[whole, :, : len(values) - whole * PACKET] = values[whole * PACKET :].T

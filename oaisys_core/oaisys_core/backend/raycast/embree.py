"""Embree, called in the library that comes with Blender.

It knows instances, which Open3D, that has a copy of it inside, does not hand on.
"""

from __future__ import annotations

import weakref
from collections import deque
from collections.abc import Sequence
from ctypes import CDLL, c_char_p, c_int, c_size_t, c_ssize_t, c_uint, c_void_p
from functools import cache
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import RenderError
from oaisys_core.types import FloatArray

LIBRARY = "libembree4.so.4"
"""By this name alone it is the one that is loaded already, with Blender."""

OLDEST = 40300
"""First version with arrays of instances, as Embree writes 4.3.0."""

VERSION, TRIANGLES_SUPPORTED = 0, 96
TRIANGLE, INSTANCE_ARRAY = 0, 122
INDEX, VERTEX, TRANSFORM = 0, 1, 23
UINT3, FLOAT3, FLOAT3X4_COLUMN_MAJOR = 0x5003, 0x9003, 0x9234
ROBUST = 4
"""Values of ``RTCDeviceProperty``, ``RTCGeometryType``, ``RTCBufferType``, ``RTCFormat`` and
``RTCSceneFlags``."""

PACKET, FIELDS = 16, 21
"""Rays of one call, and numbers of 32 bits that each has: a ``RTCRayHit16``."""
ORIGIN, NEAR, DIRECTION, TIME, FAR, MASK, FLAGS = slice(0, 3), 3, slice(4, 7), 7, 8, 9, 11
PRIMITIVE, INSTANCE, INSTANCE_PRIMITIVE = 17, 19, 20
"""Places among these."""

NOTHING = 0xFFFFFFFF
"""Id of what was not met."""

ALIGNMENT = 64

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
    "rtcIntersect16": (None, [c_void_p] * 4),
}


class Embree:
    """Makes structures that rays can be cast at."""

    def __init__(self, library: CDLL) -> None:
        """Open a library of `LIBRARY`'s name.

        Raises:
            RenderError: It is too old, or was built without triangles.
        """
        self.library = library
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        self._device = library.rtcNewDevice(b"")
        version, triangles = (
            library.rtcGetDeviceProperty(self._device, each)
            for each in (VERSION, TRIANGLES_SUPPORTED)
        )
        if version < OLDEST or not triangles:
            raise RenderError(f"Embree: received version {version}, expected {OLDEST} or later")

    def mesh(self, vertices_m: FloatArray, triangles: NDArray[np.int32]) -> EmbreeScene:
        """Return a structure over (V, 3) vertices and (T, 3) triangles."""
        # It reads 16 bytes of each vertex, of the last one, too.
        corners = np.zeros((len(vertices_m) + 1, 3), np.float32)
        corners[:-1] = vertices_m
        indices = np.ascontiguousarray(triangles, np.uint32)
        geometry = self._geometry(TRIANGLE)
        self._share(geometry, VERTEX, FLOAT3, corners, len(vertices_m))
        self._share(geometry, INDEX, UINT3, indices, len(indices))
        return self._scene([geometry], [corners, indices])

    def instances(
        self, meshes: Sequence[EmbreeScene], poses: Sequence[NDArray[np.float64]]
    ) -> EmbreeScene:
        """Return a structure in which each mesh stands at its (N, 4, 4) poses."""
        geometries, kept = [], []
        for mesh, T in zip(meshes, poses, strict=True):
            columns = np.ascontiguousarray(T[:, :3].transpose(0, 2, 1), np.float32)
            geometry = self._geometry(INSTANCE_ARRAY)
            self.library.rtcSetGeometryInstancedScene(geometry, mesh.handle)
            self._share(geometry, TRANSFORM, FLOAT3X4_COLUMN_MAJOR, columns, len(columns))
            geometries.append(geometry)
            kept.append(columns)
        return self._scene(geometries, [*meshes, *kept])

    def _geometry(self, kind: int) -> Any:
        return self.library.rtcNewGeometry(self._device, kind)

    def _share(self, geometry: Any, kind: int, form: int, values: NDArray[Any], count: int) -> None:
        stride = values.strides[0]
        address = values.ctypes.data
        self.library.rtcSetSharedGeometryBuffer(geometry, kind, 0, form, address, 0, stride, count)

    def _scene(self, geometries: Sequence[Any], kept: Sequence[Any]) -> EmbreeScene:
        library = self.library
        handle = library.rtcNewScene(self._device)
        scene = EmbreeScene(library, handle, kept)
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
    """One structure; it may be part of another, which then keeps it."""

    def __init__(self, library: CDLL, handle: Any, kept: Sequence[Any]) -> None:
        """Own a handle, and keep what its memory is in."""
        self.handle = handle
        self._library = library
        self._kept = kept
        weakref.finalize(self, library.rtcReleaseScene, handle).atexit = False

    def nearest(
        self, origins: FloatArray, directions: FloatArray, limits: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """Return what each ray meets first.

        Args:
            origins: (R, 3), or (3,) for all rays.
            directions: (R, 3) of any length.
            limits: (R,) distances, in units of the directions' lengths, where rays end.

        Returns:
            (R,) distances in these units, the limit for none, and (3, R) which mesh, which of its
            instances, and which triangle of it, all `NOTHING` for none; of a structure that is
            itself a mesh, the triangle alone.
        """
        count = len(directions)
        packets = _packets(-(-count // PACKET))
        ids = packets.view(np.uint32)
        packets[:, (NEAR, TIME)] = 0.0
        ids[:, MASK:] = NOTHING
        ids[:, FLAGS] = 0
        _fill(packets[:, ORIGIN], np.broadcast_to(origins, directions.shape), 0.0)
        _fill(packets[:, DIRECTION], directions, 0.0)
        # Rays that end before they begin fill up the last packet.
        _fill(packets[:, FAR : FAR + 1], limits[:, None], -np.inf)
        self._cast(packets)
        places = (INSTANCE, INSTANCE_PRIMITIVE, PRIMITIVE)
        found = np.stack([ids[:, place].ravel()[:count] for place in places])
        return packets[:, FAR].ravel()[:count], found

    def first(
        self, origins: FloatArray, directions: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """See `TriangleBvh.first`, of a structure of triangles."""
        distances, ids = self.nearest(origins, directions, np.full(len(directions), np.inf))
        return distances, ids[-1]

    def prepare(self) -> None:
        """See `TriangleBvh.prepare`; there is nothing left to do."""

    def _cast(self, packets: NDArray[np.float32]) -> None:
        """Fill in what rays meet; Embree has no call for many packets.

        Callers share their rays among threads: each call lets the others go on.
        """
        valid = _aligned((PACKET,), np.int32)
        valid[:] = -1
        start, size = packets.ctypes.data, packets.strides[0]
        addresses = range(start, start + packets.nbytes, size)
        # A loop without a line of Python in it.
        calls = map(
            self._library.rtcIntersect16,
            repeat(valid.ctypes.data),
            repeat(self.handle),
            addresses,
            repeat(None),
        )
        deque(calls, maxlen=0)


@cache
def blenders_embree() -> Embree | None:
    """Return the Embree of the library that Blender has loaded; None where it has another."""
    try:
        return Embree(CDLL(LIBRARY))
    except (OSError, AttributeError, RenderError):
        return None


def _packets(count: int) -> NDArray[np.float32]:
    """Return (count, FIELDS, PACKET) numbers without values."""
    return _aligned((count, FIELDS, PACKET), np.float32)


def _aligned(shape: tuple[int, ...], dtype: type[np.generic]) -> NDArray[Any]:
    """Return an array without values whose memory begins where Embree wants it."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = np.empty(size + ALIGNMENT, np.uint8)
    first = -memory.ctypes.data % ALIGNMENT
    return memory[first : first + size].view(dtype).reshape(shape)


def _fill(fields: NDArray[np.float32], values: FloatArray, rest: float) -> None:
    """Write (R, F) values of rays into (P, F, PACKET) fields, ``rest`` where there is no ray."""
    whole, width = len(values) // PACKET, values.shape[1]
    fields[:whole] = values[: whole * PACKET].reshape(whole, PACKET, width).transpose(0, 2, 1)
    if whole < len(fields):
        fields[whole] = rest
        fields[whole, :, : len(values) - whole * PACKET] = values[whole * PACKET :].T

"""The rig's motion about a sample: pieces of a trajectory's splines, which a record can hold."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_json
from oaisys_core.types import FloatArray, ShortRepr

TIME_TOLERANCE_S = 1e-6
"""Times that lie outside of a motion by at most this are moved to its end."""

MAX_PIECES = 100_000
"""Largest number of pieces that a record may have."""


@dataclass(frozen=True, repr=False)
class RigMotion(ShortRepr):
    """Poses of ``base_link`` in ``map`` at times about a sample's own.

    It consists of K pieces. Within one, position and rotation vector are cubic polynomials of the
    time since the piece began, coefficients of the highest power first.

    Attributes:
        knots_s: (K + 1,) increasing times since the sample at which pieces begin and end.
        positions: (4, K, 3) coefficients of the position in ``map``.
        quats_xyzw: (K, 4) orientations to which the rotation vectors are relative.
        turns: (4, K, 3) coefficients of the rotation vector, in the axes of these orientations.
    """

    knots_s: FloatArray
    positions: FloatArray
    quats_xyzw: FloatArray
    turns: FloatArray

    @property
    def first_s(self) -> float:
        """First time, since the sample."""
        return float(self.knots_s[0])

    @property
    def last_s(self) -> float:
        """Last time, since the sample."""
        return float(self.knots_s[-1])

    def __call__(self, times_s: FloatArray) -> FloatArray:
        """Return the (N, 4, 4) poses at (N,) times since the sample.

        Raises:
            InvalidInputError: A time is outside of the motion.
        """
        from scipy.interpolate import PPoly
        from scipy.spatial.transform import Rotation

        inside_s = np.clip(times_s, self.first_s, self.last_s)
        outside = ~(np.abs(inside_s - times_s) <= TIME_TOLERANCE_S)
        if outside.any():
            expected = f"a time of the motion, {self.first_s:.9g} s to {self.last_s:.9g} s"
            raise InvalidInputError("motion.time_s", float(times_s[outside][0]), expected)
        piece = np.searchsorted(self.knots_s, inside_s, side="right") - 1
        piece = np.clip(piece, 0, len(self.quats_xyzw) - 1)
        vectors = PPoly(self.turns, self.knots_s)(inside_s)
        rotations = Rotation.from_quat(self.quats_xyzw[piece]) * Rotation.from_rotvec(vectors)
        T = np.tile(np.eye(4), (len(times_s), 1, 1))
        T[:, :3, :3] = rotations.as_matrix()
        T[:, :3, 3] = PPoly(self.positions, self.knots_s)(inside_s)
        return T

    def with_earlier_start(self, duration_s: float) -> RigMotion:
        """Return the same motion after a piece with the velocity and angular rate of its start."""
        from scipy.spatial.transform import Rotation

        velocity_m_s, rate_rad_s = self.positions[2, 0], self.turns[2, 0]
        still = np.zeros(3)
        position_m = self.positions[3, 0] - duration_s * velocity_m_s
        turned = Rotation.from_rotvec(-duration_s * rate_rad_s)
        quat_xyzw = (Rotation.from_quat(self.quats_xyzw[0]) * turned).as_quat()
        before = np.array([still, still, velocity_m_s, position_m])[:, None]
        turn = np.array([still, still, rate_rad_s, still])[:, None]
        return RigMotion(
            knots_s=np.append(self.first_s - duration_s, self.knots_s),
            positions=np.concatenate((before, self.positions), axis=1),
            quats_xyzw=np.vstack((quat_xyzw, self.quats_xyzw)),
            turns=np.concatenate((turn, self.turns), axis=1),
        )

    def text(self) -> str:
        """Return it as JSON, from which `from_text` makes the same motion to the bit."""
        lists = {name: values.tolist() for name, values in asdict(self).items()}
        return json.dumps(lists, separators=(",", ":"))

    @classmethod
    def from_text(cls, text: str) -> RigMotion:
        """Return the motion of a record; inverse: `text`.

        Raises:
            InvalidInputError: The text is not that of a motion.
        """
        expected = "the JSON of a motion: knots_s, positions, quats_xyzw, turns"
        try:
            data = parse_json(text)
            arrays = {name: _array(data.pop(name)) for name in cls.__dataclass_fields__}
            count = len(arrays["quats_xyzw"])
            shapes = {"knots_s": (count + 1,), "quats_xyzw": (count, 4)}
            ordered = bool((np.diff(arrays["knots_s"]) > 0).all())
            fits = 0 < count <= MAX_PIECES and not data and ordered
            for name, array in arrays.items():
                fits = fits and array.shape == shapes.get(name, (4, count, 3))
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise InvalidInputError("provenance.motion_json", text[:80], expected) from error
        if not fits:
            raise InvalidInputError("provenance.motion_json", text[:80], expected)
        return cls(**arrays)


def _array(values: Any) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError("not finite")
    return array

"""Rigid transforms. Names read `a_from_b`: ``xyz_a = a_from_b @ xyz_b``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, overload

import numpy as np

from .arrays import Array, FrozenArrays, frozen
from .errors import ShapeError

_SMALL_ANGLE_RAD = 1e-8
_ROUNDING = 4 * np.finfo(np.float64).eps
# of a quaternion: the square of more could overflow
_LARGEST = 1e100


@dataclass(frozen=True, eq=False)
class SE3(FrozenArrays):
    """Rotation and translation, one or many.

    Attributes:
        wxyz: (..., 4) unit quaternions, scalar first; normalised at birth.
        xyz: (..., 3) translation in metres.

    Raises:
        ShapeError: shapes that do not fit, a quaternion of length zero, or values that are infinite.
            NaN is allowed: a missing pose is NaN.
    """

    wxyz: Array
    xyz: Array

    def __post_init__(self) -> None:
        wxyz = frozen(self.wxyz, np.float64, "SE3.wxyz")
        xyz = frozen(self.xyz, np.float64, "SE3.xyz")
        if wxyz.shape[-1:] != (4,) or xyz.shape[-1:] != (3,) or wxyz.shape[:-1] != xyz.shape[:-1]:
            raise ShapeError(f"SE3: expected wxyz (..., 4) and xyz (..., 3), got {wxyz.shape} and {xyz.shape}")
        # infinity, too; NaN is not larger
        if (np.abs(wxyz) > _LARGEST).any() or np.isinf(xyz).any():
            raise ShapeError("SE3: expected finite values (or NaN for missing), got infinity or a quaternion that is too large")
        # as `np.linalg.norm`, whose care for other cases costs more
        norm = np.sqrt(np.add.reduce(wxyz * wxyz, axis=-1, keepdims=True))
        # a quaternion of length 1 is unchanged, so that a transform is read back from a file to the last bit
        whole = np.abs(norm - 1) <= _ROUNDING
        if not whole.all():
            if (norm < 1e-12).any():
                raise ShapeError("SE3.wxyz: expected unit quaternions, got one of length 0")
            wxyz = np.where(whole, wxyz, wxyz / norm)
            wxyz.setflags(write=False)
        object.__setattr__(self, "wxyz", wxyz)
        object.__setattr__(self, "xyz", xyz)

    @property
    def batch(self) -> tuple[int, ...]:
        """Leading axes; () for a single transform."""
        return self.xyz.shape[:-1]

    @staticmethod
    def identity(batch: tuple[int, ...] = ()) -> SE3:
        """The transform that moves nothing."""
        return SE3(np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*batch, 4)), np.zeros((*batch, 3)))

    @staticmethod
    def from_matrix(rotation: Any, xyz: Any) -> SE3:
        """From (..., 3, 3) rotation matrices and (..., 3) translations; the matrices are taken as orthonormal."""
        return SE3(wxyz_from_matrix(np.asarray(rotation, np.float64)), xyz)

    @staticmethod
    def from_rotvec(rotvec_rad: Any, xyz: Any) -> SE3:
        """From (..., 3) rotation vectors (axis times angle, Rodrigues) and (..., 3) translations."""
        return SE3(wxyz_from_rotvec(np.asarray(rotvec_rad, np.float64)), xyz)

    def matrix(self) -> Array:
        """(..., 3, 3) rotation matrices; read-only."""
        return _matrices(self.wxyz) if self.batch else self._single_matrix

    @cached_property
    def _single_matrix(self) -> Array:
        # a camera's pose is applied to points some hundred times a second
        return _matrices(self.wxyz)

    def matrix4(self) -> Array:
        """(..., 4, 4) homogeneous matrices."""
        full = np.zeros((*self.batch, 4, 4))
        full[..., :3, :3] = self.matrix()
        full[..., :3, 3] = self.xyz
        full[..., 3, 3] = 1.0
        return full

    def rotvec(self) -> Array:
        """(..., 3) rotation vectors in radians, angle in [0, pi]."""
        wxyz = np.where(self.wxyz[..., :1] < 0, -self.wxyz, self.wxyz)
        sine = np.linalg.norm(wxyz[..., 1:], axis=-1, keepdims=True)
        angle = 2 * np.arctan2(sine, wxyz[..., :1])
        scale = np.where(sine > _SMALL_ANGLE_RAD, angle / np.where(sine > 0, sine, 1.0), 2.0)
        return np.asarray(wxyz[..., 1:] * scale)

    def inverse(self) -> SE3:
        """b_from_a of a_from_b."""
        wxyz = self.wxyz * np.array([1.0, -1.0, -1.0, -1.0])
        rotation_back = np.swapaxes(self.matrix(), -1, -2)
        return SE3(wxyz, -(rotation_back @ self.xyz[..., None])[..., 0])

    @overload
    def __matmul__(self, other: SE3) -> SE3: ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: SE3 | Array) -> SE3 | Array:
        """Compose with another transform, or move points (..., 3).

        A single transform moves points of any shape. A batch (B...) moves points (B..., 3), one each.
        """
        if isinstance(other, SE3):
            wxyz = quaternion_product(self.wxyz, other.wxyz)
            return SE3(wxyz, (self.matrix() @ other.xyz[..., None])[..., 0] + self.xyz)
        points = np.asarray(other, np.float64)
        if points.shape[-1:] != (3,):
            raise ShapeError(f"SE3 @ points: expected points (..., 3), got shape {points.shape}")
        if not self.batch:
            return np.asarray(points @ self.matrix().T + self.xyz)
        return np.asarray((self.matrix() @ points[..., None])[..., 0] + self.xyz)

    def __getitem__(self, index: Any) -> SE3:
        """Pick from the leading axes."""
        if not self.batch:
            raise ShapeError("SE3[...]: a single transform has no axis to pick from")
        keys = index if isinstance(index, tuple) else (index,)
        return SE3(self.wxyz[(*keys, ..., slice(None))], self.xyz[(*keys, ..., slice(None))])


def _matrices(wxyz: Array) -> Array:
    """(..., 3, 3) rotation matrices of unit quaternions (..., 4); read-only."""
    w, x, y, z = (wxyz[..., i] for i in range(4))
    out = np.empty((*wxyz.shape[:-1], 3, 3))
    out[..., 0, 0] = 1 - 2 * (y * y + z * z)
    out[..., 0, 1] = 2 * (x * y - w * z)
    out[..., 0, 2] = 2 * (x * z + w * y)
    out[..., 1, 0] = 2 * (x * y + w * z)
    out[..., 1, 1] = 1 - 2 * (x * x + z * z)
    out[..., 1, 2] = 2 * (y * z - w * x)
    out[..., 2, 0] = 2 * (x * z - w * y)
    out[..., 2, 1] = 2 * (y * z + w * x)
    out[..., 2, 2] = 1 - 2 * (x * x + y * y)
    out.setflags(write=False)
    return out


def quaternion_product(left: Array, right: Array) -> Array:
    """Hamilton product of wxyz quaternions (..., 4)."""
    w1, x1, y1, z1 = (left[..., i] for i in range(4))
    w2, x2, y2, z2 = (right[..., i] for i in range(4))
    parts = (
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
    )
    return np.stack(parts, axis=-1)


def wxyz_from_rotvec(rotvec_rad: Array) -> Array:
    """Unit quaternions (..., 4) of rotation vectors (..., 3)."""
    angle = np.linalg.norm(rotvec_rad, axis=-1, keepdims=True)
    # sin(a/2)/a, by its series where the quotient would lose digits
    safe = np.where(angle > _SMALL_ANGLE_RAD, angle, 1.0)
    scale = np.where(angle > _SMALL_ANGLE_RAD, np.sin(safe / 2) / safe, 0.5)
    return np.concatenate([np.cos(angle / 2), rotvec_rad * scale], axis=-1)


def wxyz_from_matrix(rotation: Array) -> Array:
    """Unit quaternions (..., 4) of rotation matrices (..., 3, 3), w >= 0.

    Shepperd's method: of the four ways to divide, the one with the largest divisor.
    """
    m = np.asarray(rotation, np.float64)
    if m.shape[-2:] != (3, 3):
        raise ShapeError(f"rotation: expected (..., 3, 3), got shape {m.shape}")
    d0, d1, d2 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    squares = np.stack([1 + d0 + d1 + d2, 1 + d0 - d1 - d2, 1 - d0 + d1 - d2, 1 - d0 - d1 + d2], axis=-1)
    yz, zx, xy = m[..., 2, 1], m[..., 0, 2], m[..., 1, 0]
    zy, xz, yx = m[..., 1, 2], m[..., 2, 0], m[..., 0, 1]
    rows = (
        (squares[..., 0], yz - zy, zx - xz, xy - yx),
        (yz - zy, squares[..., 1], xy + yx, zx + xz),
        (zx - xz, xy + yx, squares[..., 2], yz + zy),
        (xy - yx, zx + xz, yz + zy, squares[..., 3]),
    )
    table = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    best = np.argmax(np.where(np.isnan(squares), 0.0, squares), axis=-1)
    wxyz = np.take_along_axis(table, best[..., None, None], axis=-2)[..., 0, :]
    wxyz = wxyz / np.linalg.norm(wxyz, axis=-1, keepdims=True)
    return np.asarray(np.where(wxyz[..., :1] < 0, -wxyz, wxyz))

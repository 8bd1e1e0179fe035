"""The layout of binary messages: read back byte by byte as the page does."""

import json
import struct

import numpy as np
import pytest

from posefuse_studio.scene.messages import (
    HEADER,
    ellipsoid_factors,
    image_message,
    labels_message,
    poses_message,
    setup_message,
    values_message,
)


def start(message: bytes) -> tuple[int, float]:
    magic, version, kind, reserved, t_s = HEADER.unpack_from(message)
    assert (magic, version, reserved, HEADER.size) == (b"PF", 1, 0, 16)
    return kind, t_s


def test_poses_are_read_back() -> None:
    rng = np.random.default_rng(1)
    xyz = rng.normal(size=(2, 5, 3))
    xyz[1, 3] = np.nan
    root = rng.normal(size=(2, 5, 3, 3)) * 0.01
    cov = root @ np.swapaxes(root, -1, -2)
    message = poses_message(2.5, np.array([4, 9]), xyz, cov, rgba=[(1, 2, 3, 255), (0, 0, 0, 0)])
    assert start(message) == (2, 2.5)
    assert struct.unpack_from("<HHI", message, 16) == (2, 5, 1)
    assert struct.unpack_from("<I4BI4B", message, 24) == (4, 1, 2, 3, 255, 9, 0, 0, 0, 0)
    read = np.frombuffer(message, "<f4", 30, 40).reshape(2, 5, 3)
    np.testing.assert_allclose(read, xyz, rtol=1e-6)
    shape = np.frombuffer(message, "<f4", 90, 40 + 4 * 30).reshape(2, 5, 3, 3).astype(float)
    np.testing.assert_allclose(shape @ np.swapaxes(shape, -1, -2), 4 * cov, rtol=1e-4, atol=1e-9)
    assert len(message) == 40 + 4 * (30 + 90)
    assert struct.unpack_from("<HHI", poses_message(0.0, np.array([1, 2]), xyz), 16) == (2, 5, 0)


@pytest.mark.parametrize("bad", [np.full((3, 3), np.nan), np.eye(3) * 4.0, np.diag([1e-4, 1e-4, 0.0])])
def test_a_huge_covariance_is_not_drawn(bad: np.ndarray) -> None:
    shape = ellipsoid_factors(np.stack([bad, np.eye(3) * 1e-4]))
    assert np.isnan(shape[0]).all() and np.isfinite(shape[1]).all()


def test_a_covariance_with_a_flat_direction_is_drawn_all_the_same() -> None:
    flat = np.outer([0.01, 0.02, 0.03], [0.01, 0.02, 0.03])
    shape = ellipsoid_factors(flat)
    np.testing.assert_allclose(shape @ shape.T, 4 * flat, atol=1e-7)


def test_images_carry_what_is_drawn_over_them() -> None:
    seen, fused = np.arange(12.0).reshape(2, 3, 2), np.full((1, 3, 2), 7.0)
    message = image_message(1.0, 3, b"JPEG", (320, 240), detected_px=seen, projected_px=fused, rgba=[(9, 8, 7, 255)])
    assert start(message) == (3, 1.0)
    assert struct.unpack_from("<6HI", message, 16) == (3, 320, 240, 2, 1, 3, 0)
    assert message[32:36] == bytes([9, 8, 7, 255])
    np.testing.assert_array_equal(np.frombuffer(message, "<f4", 12, 36).reshape(2, 3, 2), seen)
    np.testing.assert_array_equal(np.frombuffer(message, "<f4", 6, 36 + 48).reshape(1, 3, 2), fused)
    assert message[36 + 48 + 24 :] == b"JPEG"
    assert image_message(1.0, 0, b"JPEG", (1, 1))[32:] == b"JPEG"
    nothing = np.zeros((0, 3, 2))
    assert image_message(1.0, 0, b"JPEG", (1, 1), detected_px=nothing, projected_px=nothing)[32:] == b"JPEG"


def test_values_setup_and_labels_are_read_back() -> None:
    message = values_message(3.0, np.array([1.0, np.nan]), np.array([0.5, np.nan]))
    assert start(message) == (4, 3.0) and struct.unpack_from("<I", message, 16) == (2,)
    np.testing.assert_array_equal(np.frombuffer(message, "<f4", 4, 20), [1.0, 0.5, np.nan, np.nan])
    assert json.loads(setup_message({"bones": [[0, 1]]})[16:]) == {"bones": [[0, 1]]}
    assert json.loads(labels_message({3: "Anna"})[16:]) == {"3": "Anna"}

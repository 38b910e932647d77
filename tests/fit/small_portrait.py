"""A head-shaped mask before a camera, for the fits."""

import numpy as np

from sira_assets.scene.camera import Camera
from sira_assets.scene.portrait import Portrait


def portrait(size=96, scale=1.1, shift=(0.2, -0.1, 0.3)) -> Portrait:
    """A camera one metre in front of a head that stands, turned and scaled, somewhere in a world."""
    rng = np.random.default_rng(5)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.linalg.det(q))
    canonical_from_world = np.eye(4)
    canonical_from_world[:3, :3] = scale * q
    canonical_from_world[:3, 3] = shift
    camera_in_canonical = np.eye(4)
    camera_in_canonical[:3, :3] = np.diag([1.0, -1.0, -1.0])
    camera_in_canonical[:3, 3] = (0.0, -0.05, 1.0)
    pose = np.linalg.inv(canonical_from_world) @ camera_in_canonical
    pose[:3, :3] /= np.cbrt(np.linalg.det(pose[:3, :3]))
    k = np.array([[2.0 * size, 0, size / 2], [0, 2.0 * size, size / 2], [0, 0, 1]])
    rows, columns = np.mgrid[:size, :size]
    mask = ((rows - 45) / 30.0) ** 2 + ((columns - 48) / 20.0) ** 2 < 1
    mask |= (rows > 60) & (abs(columns - 48) < 12)
    image = rng.uniform(0.0, 1.0, (size, size, 3)).astype(np.float32)
    return Portrait(image, mask, Camera(k, pose, size, size), canonical_from_world, np.zeros_like(mask))

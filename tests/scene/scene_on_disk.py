"""A small scene on disk, for tests to spoil."""

import json

import numpy as np

from sira_assets.scene.camera import OPENCV_FROM_OPENGL, Camera
from sira_assets.scene.image import write_png

WIDTH, HEIGHT = 48, 64


def make_camera(distance=1.2, yaw=0.2, focal=110.0, width=WIDTH, height=HEIGHT):
    """A camera that looks at the canonical origin from `distance` metres, turned by `yaw` radians about +Y."""
    c, s = np.cos(yaw), np.sin(yaw)
    backward = np.array([s, 0.0, c])
    right = np.array([c, 0.0, -s])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, [0.0, -1.0, 0.0], -backward], 1)  # OpenCV: x right, y down, z forward
    pose[:3, 3] = distance * backward + [0.0, -0.03, 0.0]
    return Camera(np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]), pose, width, height)


class SceneOnDisk:
    """A scene folder and its description; `save` writes the description after a test has changed it."""

    def __init__(self, folder):
        self.folder, self.camera = folder, make_camera()
        self.pixels = np.random.default_rng(0).integers(0, 250, (HEIGHT, WIDTH, 3)).astype(np.uint8)
        self.mask = np.zeros((HEIGHT, WIDTH), bool)
        self.mask[16:48, 12:36] = True
        write_png(folder / "image.png", self.pixels)
        write_png(folder / "mask.png", self.mask)
        k = self.camera.intrinsics
        self.data = {
            "fl_x": k[0, 0],
            "fl_y": k[1, 1],
            "cx": k[0, 2],
            "cy": k[1, 2],
            "w": WIDTH,
            "h": HEIGHT,
            "frames": [
                {
                    "file_path": "image.png",
                    "mask_path": "mask.png",
                    "transform_matrix": (self.camera.world_from_camera @ OPENCV_FROM_OPENGL).tolist(),
                }
            ],
            "canonical_from_world": np.eye(4).tolist(),
        }
        self.save()

    @property
    def frame(self):
        return self.data["frames"][0]

    def save(self):
        (self.folder / "transforms.json").write_text(json.dumps(self.data))

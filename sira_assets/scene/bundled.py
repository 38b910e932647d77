"""The real portrait that comes with the package: NASA's picture of astronaut Eileen Collins, public domain.

The picture ships inside scikit-image; its mask and landmarks are small files in `data/astronaut`, whose README says
how they were made. The focal length is an assumption.
"""

import math
from pathlib import Path

import numpy as np

from sira_assets.numerics.colour import linear_from_srgb
from sira_assets.scene.camera import Camera
from sira_assets.scene.image import read_mask
from sira_assets.scene.landmarks import read_landmarks
from sira_assets.scene.portrait import Portrait
from sira_assets.scene.pose import camera_from_canonical
from sira_assets.scene.read_scene import ASSUMED_FOCAL_35MM, FILM_DIAGONAL_MM

ASTRONAUT_FOLDER = Path(__file__).resolve().parents[1] / "data" / "astronaut"


def bundled_portrait() -> Portrait:
    """The astronaut as a `Portrait`, 512 x 512; its world is the canonical head frame, metres.

    No network is used: the picture is one of those inside scikit-image's own wheel.
    """
    from skimage.data import astronaut

    encoded = astronaut()
    height, width = encoded.shape[:2]
    focal = ASSUMED_FOCAL_35MM / FILM_DIAGONAL_MM * math.hypot(width, height)
    intrinsics = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    landmarks = read_landmarks(ASTRONAUT_FOLDER / "landmarks.json")
    pose = np.linalg.inv(camera_from_canonical(landmarks.pixels, intrinsics))
    return Portrait(
        image_linear=linear_from_srgb(encoded / 255.0).astype(np.float32),
        mask=read_mask(ASTRONAUT_FOLDER / "mask.png"),
        camera=Camera(intrinsics, pose, width, height),
        canonical_from_world=np.eye(4),
        saturated=(encoded == 255).any(-1),
        name="astronaut",
        warnings=(
            f"focal length {focal:.0f} px ({ASSUMED_FOCAL_35MM:.0f} mm equivalent) assumed",
            "head placed by its 2D landmarks, at the mean head's size; expect some degrees and 2 % of distance",
        ),
    )

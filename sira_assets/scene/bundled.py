"""The real portrait that comes with the package: NASA's picture of astronaut Eileen Collins, public domain.

The picture ships inside scikit-image; its mask and landmarks are small files in `data/astronaut`, whose README says
how they were made. The focal length is an assumption.
"""

from pathlib import Path

from sira_assets.scene.portrait import Portrait
from sira_assets.scene.read_scene import read_scene

ASTRONAUT_FOLDER = Path(__file__).resolve().parents[1] / "data" / "astronaut"


def bundled_portrait(
    *,
    mask: str | Path | None = None,
    landmarks: str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
) -> Portrait:
    """The astronaut as a `Portrait`, 512 x 512; its world is the canonical head frame, metres.

    The options override the bundled mask, landmarks and the assumed focal length, as in `read_scene`.

    No network is used: the picture is one of those inside scikit-image's own wheel.
    """
    import skimage.data

    return read_scene(
        Path(skimage.data.__file__).parent / "astronaut.png",
        mask=mask or ASTRONAUT_FOLDER / "mask.png",
        landmarks=landmarks or ASTRONAUT_FOLDER / "landmarks.json",
        focal_px=focal_px,
        fov_deg=fov_deg,
    )

"""Write one synthetic scene in the scene format, whole or not at all.

Notation: frame 0 is the portrait; the scene's folder has it again as `image.png`, `image.exr` and `mask.png`, so that
what reads one portrait reads a synthetic scene too. `gt/` is `data_synth.write_truth`'s.
"""

import os
import shutil
import tempfile
from pathlib import Path

import numpy as np

from data_synth.synth_scene import SynthScene
from data_synth.write_truth import write_json, write_light, write_picture, write_truth
from sira_assets.scene.camera import OPENCV_FROM_OPENGL
from sira_assets.scene.image import write_png


def is_whole(folder: Path) -> bool:
    """Whether a scene stands at `folder`."""
    return (folder / "transforms.json").is_file()


def remove_partials(folder: Path) -> None:
    """Remove what writers of `folder` have begun beside it, once the scene stands there.

    A living writer then has nothing to lose. Before, it would go on in a folder made anew, and half a scene would take
    the name.
    """
    if is_whole(folder):
        for partial in folder.parent.glob(f".{folder.name}.*.partial"):
            shutil.rmtree(partial, ignore_errors=True)


def write_scene(scene: SynthScene, folder: str | os.PathLike) -> None:
    """Write `scene` to `folder`: built beside it, then renamed, so that a folder of that name is a whole scene.

    Several may write one scene at a time, on one machine or many: the first to end gives its bytes, which all share.
    """
    folder = Path(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}.", suffix=".partial"))
    try:
        # mkdtemp makes folders private; give what the user's umask would have given.
        umask = os.umask(0)
        os.umask(umask)
        partial.chmod(0o777 & ~umask)
        write_frames(scene, partial)
        write_truth(scene, partial / "gt")
        if scene.relight is not None:
            light, rendering = scene.relight
            write_light(light, partial / "relight", envmap=True)
            write_picture(rendering.image, partial / "relight" / "image", exr=True)
        write_json(partial / "transforms.json", transforms(scene))
        os.replace(partial, folder)
    except OSError:
        if not is_whole(folder):
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def transforms(scene: SynthScene) -> dict:
    """`transforms.json` (nerfstudio's: OpenGL camera to world) with `canonical_from_world`."""
    camera = scene.cameras[0]
    k = camera.intrinsics
    frames = [
        {
            "file_path": f"images/{index:03d}.png",
            "mask_path": f"masks/{index:03d}.png",
            "transform_matrix": (camera.world_from_camera @ OPENCV_FROM_OPENGL).tolist(),
        }
        for index, camera in enumerate(scene.cameras)
    ]
    return {
        "camera_model": "OPENCV",
        "fl_x": k[0, 0],
        "fl_y": k[1, 1],
        "cx": k[0, 2],
        "cy": k[1, 2],
        "w": camera.width,
        "h": camera.height,
        "k1": 0.0,
        "k2": 0.0,
        "p1": 0.0,
        "p2": 0.0,
        "frames": frames,
        "canonical_from_world": np.asarray(scene.canonical_from_world).tolist(),
    }


def write_frames(scene: SynthScene, folder: Path) -> None:
    """Pictures and masks of all frames, and frame 0's again as the portrait; EXR only with the full truth."""
    for index, frame in enumerate(scene.frames):
        write_picture(frame.image, folder / "images" / f"{index:03d}", exr=scene.full is not None)
        write_png(folder / "masks" / f"{index:03d}.png", frame.mask)
    for suffix in (".png", ".exr") if scene.full is not None else (".png",):
        shutil.copyfile(folder / "images" / f"000{suffix}", folder / f"image{suffix}")
    shutil.copyfile(folder / "masks" / "000.png", folder / "mask.png")

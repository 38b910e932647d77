"""`cameras.npz`, as IDR, NeuS and H3DS write it.

Notation: P_i = (world_mat_i @ scale_mat_i)[:3, :4] projects points of the normalised world (the head inside the unit
sphere) to pixels; P = lambda K [R | t], decomposed by an RQ factorisation (Hartley and Zisserman, 2nd ed., 6.2.4).
The scene's world is that normalised one. The camera's pixel centres are at +0.5 here and at integers there; half a
pixel is added to the principal point.
"""

import zipfile
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.scene.camera import Camera
from sira_assets.scene.frame import IMAGE_SUFFIXES, Frame, path_inside
from sira_assets.scene.image import image_size

MAX_VIEWS = 10_000


def _small_matrices(path: Path) -> dict[str, np.ndarray]:
    """The world_mat_i and scale_mat_i of an .npz; every header is read before any array is."""
    matrices = {}
    try:
        with zipfile.ZipFile(path) as archive:
            names = [n for n in archive.namelist() if n.startswith(("world_mat_", "scale_mat_")) and "inv" not in n]
            if len(names) > 2 * MAX_VIEWS:
                raise InputError(
                    expected=f"at most {MAX_VIEWS} views in {path}", received=f"{len(names) // 2}", remedy="split it"
                )
            for name in names:
                with archive.open(name) as member:
                    version = np.lib.format.read_magic(member)
                    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else None
                    header = header or np.lib.format.read_array_header_2_0
                    shape, _, dtype = header(member)
                if shape not in ((4, 4), (3, 4)) or dtype.kind not in "fiu":
                    raise InputError(
                        expected=f"4x4 matrices of numbers in {path}",
                        received=f"{name} of shape {shape} and type {dtype}",
                        remedy="write it as IDR's preprocessing does",
                    )
                with archive.open(name) as member:
                    matrix = np.lib.format.read_array(member, allow_pickle=False).astype(np.float64)
                matrices[name.removesuffix(".npy")] = np.vstack([matrix[:3], [0.0, 0.0, 0.0, 1.0]])
    except (zipfile.BadZipFile, ValueError, OSError, EOFError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            expected=f"a whole .npz file at {path}", received=str(error)[:80], remedy="copy it again"
        ) from None
    return matrices


def decompose_projection(projection: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Intrinsics K (3, 3) and rigid world_from_camera (4, 4) of a projection matrix (3, 4), of any scale and sign.

    Raises
    ------
    InputError : its left 3x3 block is singular or not finite, or recomposing misses the input.
    """
    from scipy.linalg import rq

    projection = np.asarray(projection, np.float64)
    refused = InputError(
        expected="projection matrices with an invertible 3x3 block",
        received=np.array2string(projection.ravel(), precision=3, separator=", ", max_line_width=400),
        remedy="check world_mat and scale_mat",
    )
    if not np.isfinite(projection).all() or np.linalg.matrix_rank(projection[:, :3]) < 3:
        raise refused
    if np.linalg.det(projection[:, :3]) < 0:
        projection = -projection
    k, rotation = rq(projection[:, :3])
    signs = np.diag(np.where(np.diag(k) < 0, -1.0, 1.0))
    k, rotation = k @ signs, signs @ rotation
    t = np.linalg.solve(k, projection[:, 3])
    recomposed = k @ np.column_stack([rotation, t])
    if np.abs(recomposed - projection).max() > 1e-9 * np.abs(projection).max():
        raise refused
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.T, -rotation.T @ t
    intrinsics = k / k[2, 2]
    # The factorisation leaves rounding of 1e-16 below the diagonal.
    intrinsics[[1, 2, 2], [0, 0, 1]] = 0.0
    return intrinsics, pose


def _pictures(folder: Path, kinds: tuple[str, ...]) -> list[Path]:
    for kind in kinds:
        if (folder / kind).is_dir():
            return sorted(p for p in (folder / kind).iterdir() if p.suffix in IMAGE_SUFFIXES)
    return []


def read_cameras_npz(path: str | Path, *, only_first: bool = False) -> tuple[Frame, ...]:
    """Read a `cameras.npz` with its folders `image/` and `mask/` (pictures in the order of their names).

    Raises
    ------
    InputError : damaged, pickled or oversized arrays, another number of pictures than cameras, an unusable camera.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(expected=f"a file {path}", received="no such file", remedy="check the path")
    matrices = _small_matrices(path)
    images = _pictures(path.parent, ("image", "images"))
    masks = _pictures(path.parent, ("mask", "masks"))
    views = [i for i in range(len(matrices)) if f"world_mat_{i}" in matrices]
    if not views or len(images) != len(views) or len(masks) not in (0, len(views)):
        raise InputError(
            expected=f"as many pictures in image/ and mask/ as cameras in {path}",
            received=f"{len(views)} cameras, {len(images)} pictures, {len(masks)} masks",
            remedy="name them so that their order is that of the cameras",
        )
    frames = []
    for row, i in enumerate(views[:1] if only_first else views):
        scale = matrices.get(f"scale_mat_{i}", np.eye(4))
        intrinsics, pose = decompose_projection((matrices[f"world_mat_{i}"] @ scale)[:3])
        intrinsics[:2, 2] += 0.5
        image = path_inside(path.parent, str(images[row].relative_to(path.parent)))
        mask = path_inside(path.parent, str(masks[row].relative_to(path.parent))) if masks else None
        frames.append(Frame(Camera(intrinsics, pose, *image_size(image)), image, mask))
    return tuple(frames)

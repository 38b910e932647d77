"""The part of unwrapping that may hang or crash, run as a process of its own: python -m ... METHOD FOLDER NUMBER...

xatlas and UVAtlas hold the interpreter's lock, know no cancel, and end the process on some inputs; their caller
(`unwrap_parts`) kills this process when its time is up, and keeps what it has written until then. In: in-NUMBER.npz
with vertices (V, 3) and faces (F, 3). Out: out-NUMBER.npz with uv (T, 2) and faces_uv (F, 3); charts are not packed.
"""

import os
import sys
from pathlib import Path

import numpy as np

from sira_assets.mesh.open3d_core import open3d_core


def xatlas_charts(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """xatlas's charts."""
    import xatlas

    charts = xatlas.ChartOptions()
    charts.fix_winding = True
    packing = xatlas.PackOptions()
    packing.padding = 1
    packing.resolution = 1024
    # Its rotation by 90 degrees swaps u and v, which mirrors the chart: lettering and tangent frames would turn over.
    packing.rotate_charts = False
    atlas = xatlas.Atlas()
    atlas.add_mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    atlas.generate(charts, packing, False)
    _, faces_uv, uv = atlas.get_mesh(0)
    # It picks its own rectangle and normalises each axis by it: back to texels, which are square.
    return np.asarray(uv, np.float64) * (atlas.width, atlas.height), np.asarray(faces_uv, np.int64)


def uvatlas_charts(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Open3D's UVAtlas; the input must be manifold."""
    open3d = open3d_core()
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    mesh = open3d.t.geometry.TriangleMesh(
        open3d.core.Tensor(vertices.astype(np.float32)), open3d.core.Tensor(faces.astype(np.int64))
    )
    # One partition takes minutes on some heads (101 s against 6 s at 25 thousand triangles); four cut twice the charts.
    mesh.compute_uvatlas(size=1024, gutter=1.0, parallel_partitions=2, nthreads=1)
    corner_uv = mesh.triangle["texture_uvs"].numpy().astype(np.float64)
    # Corners of one vertex at one place are one atlas vertex.
    key = np.column_stack([faces.reshape(-1), corner_uv.reshape(-1, 2)])
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return corner_uv.reshape(-1, 2)[first], inverse.reshape(-1, 3)


METHODS = {"xatlas": xatlas_charts, "uvatlas": uvatlas_charts}


def main(arguments: list[str]) -> int:
    """Read, unwrap, write, one part after another."""
    method, folder, *numbers = arguments
    for number in numbers:
        with np.load(Path(folder, f"in-{number}.npz"), allow_pickle=False) as data:
            uv, faces_uv = METHODS[method](data["vertices"], data["faces"])
        whole = Path(folder, f"part-{number}.npz")
        np.savez(whole, uv=uv, faces_uv=faces_uv)
        os.replace(whole, Path(folder, f"out-{number}.npz"))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

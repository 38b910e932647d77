"""The part of unwrapping that may hang or crash, run as a process of its own: python -m ... METHOD IN.npz OUT.npz.

xatlas and UVAtlas hold the interpreter's lock, know no cancel, and end the process on some inputs; their caller
(`unwrap`) kills this process when its time is up. In: vertices (V, 3), faces (F, 3), size, padding. Out: uv (T, 2),
faces_uv (F, 3), and for xatlas the vertex behind each uv.
"""

import sys

import numpy as np


def xatlas_atlas(vertices: np.ndarray, faces: np.ndarray, size: int, padding: int) -> tuple[np.ndarray, np.ndarray]:
    """xatlas's charts and packing, scaled to a square of `size` texels with at least `padding` between charts."""
    import xatlas

    charts = xatlas.ChartOptions()
    charts.fix_winding = True
    packing = xatlas.PackOptions()
    packing.padding = padding
    packing.resolution = size
    packing.bilinear = True
    # Its rotation by 90 degrees swaps u and v, which mirrors the chart: lettering and tangent frames would turn over.
    packing.rotate_charts = False
    atlas = xatlas.Atlas()
    atlas.add_mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    atlas.generate(charts, packing, False)
    _, faces_uv, uv = atlas.get_mesh(0)
    # xatlas picks its own rectangle near `size` and normalises each axis by it: back to texels, then one scale.
    texels = np.asarray(uv, np.float64) * np.array([atlas.width, atlas.height])
    return texels / max(atlas.width, atlas.height), np.asarray(faces_uv, np.int64)


def uvatlas_atlas(vertices: np.ndarray, faces: np.ndarray, size: int, padding: int) -> tuple[np.ndarray, np.ndarray]:
    """Open3D's UVAtlas; the input must be manifold."""
    import open3d

    mesh = open3d.t.geometry.TriangleMesh(
        open3d.core.Tensor(vertices.astype(np.float32)), open3d.core.Tensor(faces.astype(np.int64))
    )
    # One partition takes minutes on some heads (101 s against 6 s at 25 thousand triangles); four cut twice the charts.
    mesh.compute_uvatlas(size=size, gutter=float(padding), parallel_partitions=2, nthreads=1)
    corner_uv = mesh.triangle["texture_uvs"].numpy().astype(np.float64)
    # Corners of one vertex at one place are one atlas vertex.
    key = np.column_stack([faces.reshape(-1), corner_uv.reshape(-1, 2)])
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return corner_uv.reshape(-1, 2)[first], inverse.reshape(-1, 3)


METHODS = {"xatlas": xatlas_atlas, "uvatlas": uvatlas_atlas}


def main(arguments: list[str]) -> int:
    """Read, unwrap, write."""
    method, source, target = arguments
    with np.load(source, allow_pickle=False) as data:
        uv, faces_uv = METHODS[method](data["vertices"], data["faces"], int(data["size"]), int(data["padding"]))
    np.savez(target, uv=uv, faces_uv=faces_uv)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Draw docs/conventions.png (canonical frame, camera, UV, lat-long map). Run: python docs/draw_conventions.py"""

from pathlib import Path

import numpy as np

OUT = Path(__file__).with_name("conventions.png")
RED, GREEN, BLUE, INK = "#c0392b", "#1e8449", "#1f5fbf", "#222222"


def draw_head(axes, vertices, faces, across, sign, depth):
    """Paint the triangles back to front, lit from the viewer; `across` is the canonical axis that runs rightwards."""
    from matplotlib.collections import PolyCollection

    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    facing = normal[:, depth] > 0
    order = np.argsort(corners[facing][:, :, depth].mean(1))
    corners, shade = corners[facing][order], normal[facing][order]
    light = 0.62 + 0.3 * np.clip(shade[:, depth] * 0.75 + shade[:, 1] * 0.4, 0, 1)
    polygons = np.stack([sign * corners[:, :, across], corners[:, :, 1]], -1)
    axes.add_collection(PolyCollection(polygons, facecolors=np.repeat(light[:, None], 3, 1), edgecolors="face", lw=0.2))


def arrow(axes, start, step, colour, text, offset=(0, 0), **style):
    end = np.add(start, step)
    axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2, **style})
    axes.text(*np.add(end, offset), text, color=colour, ha="center", va="center", fontsize=10, weight="bold")


def dot(axes, at, colour, text, offset):
    """An axis that points at the viewer."""
    axes.plot(*at, "o", ms=11, mfc="white", mec=colour, mew=2)
    axes.plot(*at, "o", ms=3.5, color=colour)
    axes.text(*np.add(at, offset), text, color=colour, ha="center", va="center", fontsize=10, weight="bold")


def canonical(axes, vertices, faces, side):
    from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M

    points = np.array(list(CANONICAL_LANDMARKS_M.values()))
    # From the front +X runs right; from the subject's left (+X towards the viewer) +Z runs left.
    across, sign, depth = (2, -1, 0) if side else (0, 1, 2)
    draw_head(axes, vertices, faces, across, sign, depth)
    axes.plot(sign * points[:, across], points[:, 1], "o", ms=4, color="#e67e22", mec="white", mew=0.6)
    arrow(axes, (0, 0), (0, 0.075), GREEN, "+Y up", (0, 0.012))
    if side:
        arrow(axes, (0, 0), (-0.085, 0), BLUE, "+Z out of the face", (-0.005, 0.016))
        dot(axes, (0, 0), RED, "+X", (0.022, -0.012))
        axes.set_title("from the subject's left", fontsize=10)
    else:
        arrow(axes, (0, 0), (0.1, 0), RED, "+X\nsubject's left", (0.034, 0.002))
        dot(axes, (0, 0), BLUE, "+Z", (-0.02, -0.014))
        axes.text(0.045, -0.098, "nine landmarks", color="#b85c00", fontsize=8)
        axes.set_title("canonical head frame (metres), from the front", fontsize=10)
    axes.set(xlim=(-0.12, 0.22) if side else (-0.17, 0.17), ylim=(-0.17, 0.12), aspect="equal")
    axes.axis("off")


def camera(axes):
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((0, -4), 6, 4, fc="#eef2f7", ec=INK))
    for i in range(1, 6):
        axes.plot([i, i], [-4, 0], color="#c5cfdb", lw=0.8)
    for i in range(1, 4):
        axes.plot([0, 6], [-i, -i], color="#c5cfdb", lw=0.8)
    axes.plot(0.5, -0.5, "o", color=INK, ms=4)
    axes.text(0.62, -0.34, "(0.5, 0.5): centre of pixel (row 0, column 0)", fontsize=7.5, va="center")
    axes.text(-0.1, 0.16, "(0, 0)", fontsize=8, ha="center")
    axes.text(6, -4.28, "(w, h)", fontsize=8, ha="center")
    arrow(axes, (3, -2), (1.6, 0), RED, "x", (0.22, 0))
    arrow(axes, (3, -2), (0, -1.4), GREEN, "y", (0, -0.24))
    axes.plot(3, -2, "o", ms=13, mfc="white", mec=BLUE, mew=2)
    axes.plot(3, -2, "x", ms=7, color=BLUE, mew=2)
    axes.text(2.45, -1.62, "z forward,\ninto the scene", color=BLUE, fontsize=8, ha="center", weight="bold")
    axes.set(xlim=(-0.6, 6.8), ylim=(-4.6, 0.5), aspect="equal")
    axes.set_title("camera: OpenCV axes, pixel edges at whole numbers", fontsize=10)
    axes.axis("off")


def uv(axes):
    from matplotlib.patches import Polygon, Rectangle

    axes.add_patch(Rectangle((0, 0), 1, 1, fc="#f7f3ea", ec=INK))
    axes.add_patch(Polygon([[0.2, 0.3], [0.75, 0.22], [0.6, 0.8], [0.3, 0.7]], fc="#d9c9a3", ec="#8a7440"))
    arrow(axes, (0, 0), (0.35, 0), RED, "u", (0.05, 0.06))
    arrow(axes, (0, 0), (0, 0.35), GREEN, "v", (0.06, 0.04))
    axes.text(-0.05, -0.08, "(0, 0)", fontsize=8)
    axes.text(0.9, 1.03, "(1, 1)", fontsize=8)
    axes.text(0.03, 0.94, "row 0 of the texture", fontsize=8, va="center")
    axes.set(xlim=(-0.1, 1.15), ylim=(-0.13, 1.12), aspect="equal")
    axes.set_title("UV: origin bottom left", fontsize=10)
    axes.axis("off")


def lat_long(axes):
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((0, 0), 4, 2, fc="#e9f1e6", ec=INK))
    axes.plot([0, 4], [1, 1], color="#b8ccb0", lw=0.8)
    for x, text, colour in [(0, "-Z", BLUE), (1, "+X", RED), (2, "+Z", BLUE), (3, "-X", RED), (4, "-Z", BLUE)]:
        axes.plot([x, x], [0, 2], color="#b8ccb0", lw=0.8)
        axes.plot(x, 1, "o", color=colour, ms=5)
        axes.text(x, 1.17, text, color=colour, ha="center", weight="bold", fontsize=10)
    axes.text(2, 1.85, "+Y (whole top edge)", color=GREEN, ha="center", va="center", weight="bold", fontsize=9)
    axes.text(2, 0.15, "-Y (whole bottom edge)", color=GREEN, ha="center", va="center", weight="bold", fontsize=9)
    axes.set(xlim=(-0.2, 4.2), ylim=(-0.1, 2.15), aspect="equal")
    axes.set_title("environment map: H x 2H, seen from inside", fontsize=10)
    axes.axis("off")


def main() -> None:
    """Draw and write the picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from data_synth.head.grid import extract, template_grid

    grid = template_grid()
    vertices, faces = extract(grid, grid.field)
    figure = plt.figure(figsize=(11, 7.4), dpi=110)
    top = figure.add_gridspec(1, 2, left=0.02, right=0.98, top=0.96, bottom=0.42, wspace=0.02)
    bottom = figure.add_gridspec(
        1, 3, left=0.02, right=0.98, top=0.36, bottom=0.01, wspace=0.06, width_ratios=[1.35, 0.9, 1.6]
    )
    canonical(figure.add_subplot(top[0]), vertices, faces, side=False)
    canonical(figure.add_subplot(top[1]), vertices, faces, side=True)
    camera(figure.add_subplot(bottom[0]))
    uv(figure.add_subplot(bottom[1]))
    lat_long(figure.add_subplot(bottom[2]))
    figure.savefig(OUT)


if __name__ == "__main__":
    main()

"""The 3D view as a piece of a page: everything it needs inside, nothing loaded, so that it opens by double click.

The script is built from `source/` and holds three.js; `source/README.md` says how, LICENSE-three.txt under what terms.
"""

import html
import string
from importlib.resources import files

import numpy as np

from sira_assets.viewer.form import form_json, packed_text
from sira_assets.viewer.scene import ViewerScene


def viewer_html(scene: ViewerScene, *, photo_id: str | None = None) -> str:
    """HTML of one view; at most one on a page.

    Parameters
    ----------
    photo_id : id of the page's img of the photo, of the camera's proportions; None shows none
    """
    room = files("sira_assets.viewer")
    camera, shadows = scene.camera, scene.shadows
    with_photo = photo_id is not None and scene.is_photos
    data = {"glb": scene.glb} | ({} if shadows is None else {"shadows-data": np.ascontiguousarray(shadows.packed)})
    scripts = "\n".join(
        f'<script type="text/plain" data-part="{name}">{packed_text(bytes(value))}</script>'
        for name, value in data.items()
    )
    return string.Template((room / "viewer.html").read_text(encoding="utf-8")).substitute(
        style=(room / "viewer.css").read_text(encoding="utf-8"),
        script=(room / "viewer.min.js").read_text(encoding="utf-8"),
        name=html.escape(scene.name),
        width=camera.width,
        height=camera.height,
        photo=html.escape(photo_id or ""),
        photo_hidden="" if with_photo else "hidden",
        home="Photo’s camera" if scene.is_photos else "First camera",
        form=form_json(scene),
        scripts=scripts,
    )

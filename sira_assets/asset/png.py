"""PNG bytes whose metadata says how the texels are to be read."""

import io
from collections.abc import Mapping

import numpy as np


def encode_png(texels: np.ndarray, text: Mapping[str, str] | None = None) -> bytes:
    """A PNG file in memory; the same texels and text give the same bytes.

    No colour chunk (sRGB, gAMA, iCCP) is written: glTF readers must ignore them and its validator warns of them.

    Parameters
    ----------
    texels : (H, W), (H, W, 3) or (H, W, 4) uint8, row 0 on top
    text : tEXt entries, Latin-1

    Raises
    ------
    TypeError : another dtype; ValueError : another shape.
    """
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    texels = np.ascontiguousarray(texels)
    if texels.dtype != np.uint8:
        raise TypeError(f"texels must be uint8, not {texels.dtype}")
    if texels.ndim not in (2, 3) or (texels.ndim == 3 and texels.shape[2] not in (3, 4)):
        raise ValueError(f"texels must be (H, W), (H, W, 3) or (H, W, 4), not {texels.shape}")
    info = PngInfo()
    for key, value in (text or {}).items():
        info.add_text(key, value)
    buffer = io.BytesIO()
    Image.fromarray(texels).save(buffer, format="PNG", pnginfo=info, compress_level=6)
    return buffer.getvalue()

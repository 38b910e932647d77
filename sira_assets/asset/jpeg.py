"""JPEG bytes for maps whose size matters more than their last code."""

import io

import numpy as np


def encode_jpeg(texels: np.ndarray, quality: int) -> bytes:
    """A JPEG file in memory, colours at full resolution (4:4:4); the same texels and quality give the same bytes.

    Full resolution, since charts meet background and other charts within a few texels.

    Parameters
    ----------
    texels : (H, W) or (H, W, 3) uint8, row 0 on top
    quality : 1 to 100, libjpeg's scale
    """
    from PIL import Image

    texels = np.ascontiguousarray(texels)
    if texels.dtype != np.uint8 or not (texels.ndim == 2 or (texels.ndim == 3 and texels.shape[2] == 3)):
        raise ValueError(f"texels must be (H, W) or (H, W, 3) uint8, not {texels.shape} {texels.dtype}")
    buffer = io.BytesIO()
    Image.fromarray(texels).save(buffer, format="JPEG", quality=quality, subsampling=0, optimize=True)
    return buffer.getvalue()

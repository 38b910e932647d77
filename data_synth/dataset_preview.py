"""A contact sheet of scenes on disk: one row a scene, one column a view."""

from pathlib import Path

import numpy as np

from sira_assets.scene.image import write_png


def write_contact_sheet(folders: list[Path], path: str | Path, *, rows: int = 12, columns: int = 8, tile: int = 160):
    """Write the first views of the first scenes as one PNG of `tile`-pixel pictures.

    Parameters
    ----------
    folders : scene folders, each with images/NNN.png
    rows, columns : at most so many scenes and views
    """
    from PIL import Image

    shown = [sorted((folder / "images").glob("*.png"))[:columns] for folder in folders[:rows]]
    width = max(map(len, shown))
    sheet = []
    for pictures in shown:
        line = np.zeros((tile, tile * width, 3), np.uint8)
        for k, picture in enumerate(pictures):
            with Image.open(picture) as image:
                small = image.convert("RGB").resize((tile, tile), Image.Resampling.LANCZOS)
            line[:, k * tile : (k + 1) * tile] = np.asarray(small)
        sheet.append(line)
    write_png(path, np.concatenate(sheet))

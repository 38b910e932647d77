"""What unwrapping will cost, before it is begun.

Notation: F faces; seconds = a (F / 10000)^b on one core of a two-core laptop-class machine. Measured on generated heads
(`tools/measure_unwrap.py`; docs/textures.md has the figures); a whole head costs up to twice as much as a part cut out.
"""

import numpy as np

# (a, b) of one part.
_CHARTS = {"uvatlas": (1.0, 1.1), "xatlas": (1.2, 1.45)}
_START_S = 1.0  # a process with its imports
_BOXES_S = 0.3  # for each ten thousand faces
# Overlap check, packing, report: what follows whatever the method.
_AFTER_S, _PACKING_S = 0.25, 3.0


def predicted_seconds(method: str, faces: np.ndarray | list[int], workers: int = 1) -> float:
    """Wall-clock seconds for parts of `faces` triangles each.

    Parameters
    ----------
    method : "uvatlas", "xatlas", "boxes", or "after" for what follows the charts
    workers : processes side by side, each on a core of its own
    """
    n = np.asarray(faces, np.float64) / 1e4
    if method in _CHARTS:
        a, b = _CHARTS[method]
        return float((a * n**b).sum() / workers + _START_S) if n.size else 0.0
    return float(_BOXES_S * n.sum()) if method == "boxes" else float(_PACKING_S + _AFTER_S * n.sum())

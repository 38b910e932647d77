"""Open3D without what its import brings along for others.

`import open3d` also imports its learning part, and with it scikit-learn and pandas: half of the two seconds it takes,
in every run and again in every process that cuts charts.
"""

import sys
from types import ModuleType

_LEARNING = "open3d.ml"


def open3d_core() -> ModuleType:
    """The module `open3d`; who wants `open3d.ml` of it has to import that by name."""
    fresh = "open3d" not in sys.modules
    if fresh:
        # A module that is there already is not looked for; taken away again, it will be when somebody imports it.
        sys.modules[_LEARNING] = ModuleType(_LEARNING)
    try:
        import open3d  # waits for another thread that is at it
    finally:
        if fresh:
            sys.modules.pop(_LEARNING, None)
    return open3d

"""The meshes and GLB files of known answers are the measure room's."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "measure"))

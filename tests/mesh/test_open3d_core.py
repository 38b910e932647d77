"""Open3D is imported without its learning part, which stays within reach."""

import subprocess
import sys

BEGIN = "import sys; from sira_assets.mesh.open3d_core import open3d_core; o = open3d_core();"


def python(code):
    return subprocess.run([sys.executable, "-c", BEGIN + code], timeout=120).returncode


def test_nothing_for_learning_is_imported():
    assert python("sys.exit('sklearn' in sys.modules or 'open3d.ml' in sys.modules or o is not open3d_core())") == 0


def test_who_asks_for_the_learning_part_gets_it():
    assert python("import open3d.ml.datasets; sys.exit(not hasattr(open3d.ml.datasets, 'SemanticKITTI'))") == 0

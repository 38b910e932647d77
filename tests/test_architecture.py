"""The house holds its shape: rooms import only rooms above them, `--help` is instant, modules stay small."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# In the order of the journey; a room imports only itself and rooms to its left. `errors` and `atomic` belong to all.
ROOMS = (
    "numerics",
    "scene",
    "fields",
    "mesh",
    "render",
    "train",
    "fit",
    "texture",
    "asset",
    "relight",
    "viewer",
    "measure",
    "pipeline",
    "plan",
    "delivery",
)
GROUND = {"errors", "atomic"}
# The generator judges the closed-form renderer, so it may not use it, nor anything that does.
SYNTH_MAY_USE = {"numerics", "scene", "mesh"} | GROUND
HEAVY = (
    "torch",
    "open3d",
    "trimesh",
    "pymeshlab",
    "xatlas",
    "igl",
    "matplotlib",
    "skimage",
    "mitsuba",
    "scipy",
    "dask",
)
TORCH_ROOMS = {"numerics", "fields", "render", "train", "fit", "relight", "pipeline"}
MAX_LINES = 400
TOOLS = sorted(p for p in (ROOT / "tools").glob("*.py") if not p.name.startswith("_"))


def python_files(*folders):
    return sorted(p for folder in folders for p in (ROOT / folder).rglob("*.py"))


def imported(path):
    """Full names of all modules a file imports, also inside functions; relative ones are resolved."""
    tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            # `from sira_assets import mesh` names a room in its list of names.
            yield from ((f"{module}.{alias.name}", node.lineno) for alias in node.names)


def room_of(name):
    parts = name.split(".")
    return parts[1] if parts[0] == "sira_assets" and len(parts) > 1 else None


def test_rooms_import_only_rooms_above_them():
    wrong = []
    for path in python_files("sira_assets"):
        room = path.relative_to(ROOT / "sira_assets").with_suffix("").parts[0]
        if room in GROUND or room == "__init__":
            allowed = GROUND
        else:
            assert room in ROOMS, f"{path}: a room that the plan does not have"
            allowed = {*ROOMS[: ROOMS.index(room) + 1], *GROUND}
        for name, line in imported(path):
            target = room_of(name)
            if target in (*ROOMS, *GROUND) and target not in allowed:
                wrong.append(f"{path.relative_to(ROOT)}:{line} imports {name}")
    assert not wrong, "\n".join(wrong)


def test_the_library_knows_neither_the_generator_nor_the_tools():
    for path in python_files("sira_assets"):
        for name, line in imported(path):
            assert name.split(".")[0] not in ("data_synth", "tools", "tests"), f"{path}:{line} imports {name}"


def test_the_generator_does_not_use_what_it_judges():
    for path in python_files("data_synth"):
        for name, line in imported(path):
            target = room_of(name)
            assert target is None or target in SYNTH_MAY_USE or target == "__version__", f"{path}:{line} imports {name}"


def test_torch_stays_in_its_rooms():
    """NumPy rooms cross into torch inside a function, where they must; importing them does not load it."""
    for path in python_files("sira_assets"):
        room = path.relative_to(ROOT / "sira_assets").with_suffix("").parts[0]
        if room in TORCH_ROOMS:
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.split(".")[0] == "torch" for name in names), f"{path}:{node.lineno} imports torch"


def test_modules_stay_small():
    for path in python_files("sira_assets", "data_synth", "tools"):
        lines = len(path.read_text(encoding="utf-8").splitlines())
        assert lines <= MAX_LINES, f"{path.relative_to(ROOT)} has {lines} lines; split it by concept"


def test_every_module_opens_with_a_docstring():
    for path in python_files("sira_assets", "data_synth", "tools"):
        text = path.read_text(encoding="utf-8")
        assert not text.strip() or ast.get_docstring(ast.parse(text)), (
            f"{path.relative_to(ROOT)} says nothing of itself"
        )


def test_nothing_is_left_for_later_or_tied_to_one_machine():
    words = ("TODO", "FIXME", "XXX", "NotImplementedError", "../shared")
    absolute = re.compile(r"""["'](/(?:home|root|tmp|work|Users)/[^"']*)""")
    for path in python_files("sira_assets", "data_synth", "tools"):
        text = path.read_text(encoding="utf-8")
        found = [word for word in words if word in text] + absolute.findall(text)
        assert not found, f"{path.relative_to(ROOT)} has {found}"


HELP = f"""
import runpy, sys
sys.argv = [sys.argv[1], "--help"]
sys.path.insert(0, {str(ROOT / "tools")!r})
try:
    runpy.run_path(sys.argv[0], run_name="__main__")
except SystemExit as end:
    code = end.code or 0
loaded = sorted(set(sys.modules) & set({HEAVY!r}))
assert not loaded, f"--help imported {{loaded}}"
sys.exit(code)
"""


@pytest.mark.parametrize("tool", TOOLS, ids=lambda p: p.stem)
def test_help_is_instant(tool):
    """Nothing heavy is imported before the command line is understood."""
    done = subprocess.run(
        [sys.executable, "-c", HELP, str(tool)], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "usage" in done.stdout.lower()


def test_test_modules_have_names_of_their_own():
    """pytest imports them by their bare names."""
    names = [path.name for path in python_files("tests") if path.name.startswith("test_")]
    assert sorted(names) == sorted(set(names))

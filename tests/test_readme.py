"""The first page is true: what it links to exists, what it shows compiles, the tools it should name are there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_relative_links_lead_somewhere(page):
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    missing = [link for link in links if not link.startswith("http") and not (page.parent / link).exists()]
    assert not missing, missing


def test_every_tool_is_named():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    tools = [path.name for path in (ROOT / "tools").glob("*.py") if not path.name.startswith("_")]
    assert tools
    assert [name for name in tools if name not in text] == []


def test_python_blocks_compile_and_import_what_exists():
    import importlib

    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
    assert blocks
    for block in blocks:
        compile(block, "README.md", "exec")
        for module, names in re.findall(r"^from ([\w.]+) import ([\w, ]+)$", block, re.M):
            for name in names.split(","):
                assert hasattr(importlib.import_module(module), name.strip())


def test_make_has_the_two_commands():
    rules = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    assert {"avatar", "test"} <= set(rules)
    assert "make test" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")

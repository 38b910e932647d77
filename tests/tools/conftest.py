"""A scan for the tools that make scenes."""

import json
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def egg(tmp_path_factory) -> Path:
    """A head-sized ellipsoid with landmarks beside it; a scan needs no template, so that starting anew costs little."""
    import trimesh

    from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M

    folder = tmp_path_factory.mktemp("egg")
    ball = trimesh.creation.icosphere(3)
    trimesh.Trimesh(ball.vertices * [0.075, 0.12, 0.095] + [0, -0.03, -0.06], ball.faces).export(folder / "egg.ply")
    points = {name: list(point) for name, point in CANONICAL_LANDMARKS_M.items()}
    (folder / "landmarks.json").write_text(json.dumps({"landmarks_m": points}))
    return folder / "egg.ply"

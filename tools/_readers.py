"""Exported files as other programs understand them, all brought to one form so that they can be compared.

Notation: a corner is a vertex of a face; UV origin bottom left; codes are the 8-bit texels of the base colour.
"""

import contextlib
import io
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError


@dataclass(frozen=True)
class ReadBack:
    """One file as one program reads it.

    Parameters
    ----------
    program, file : names
    corners : (F, 3, 3) in the file's world and unit
    uv : (F, 3, 2)
    base : (H, W, 3) uint8 codes of the base colour, row 0 on top; None where the program finds none
    pictures : one line for each picture the material uses
    render : (H, W, 4) linear with alpha, from the portrait's camera; None where none was asked for
    """

    program: str
    file: str
    corners: np.ndarray
    uv: np.ndarray
    base: np.ndarray | None
    pictures: tuple[str, ...] = ()
    render: np.ndarray | None = field(default=None, repr=False)


def by_us(path: Path) -> ReadBack:
    """The project's own reader, which knows nothing of the writer: what the others are compared with."""
    from sira_assets.relight.glb_model import read_glb

    model = read_glb(path)
    texture = model.materials[0].base_texture
    from sira_assets.asset.encoding import encode_srgb

    base = None if texture is None else encode_srgb(texture.texels[..., :3])
    uv = model.uv[model.faces]
    return ReadBack("sira_assets", path.name, model.vertices[model.faces], _flipped(uv), base)


def required_extensions(path: Path) -> list[str]:
    """What a GLB says its readers must know."""
    raw = path.read_bytes()
    (length,) = struct.unpack_from("<I", raw, 12)
    return json.loads(raw[20 : 20 + length]).get("extensionsRequired", [])


def by_trimesh(path: Path) -> ReadBack:
    import trimesh

    scene = trimesh.load(path, process=False)
    # A node may carry the transform that undoes quantisation.
    mesh = scene.to_geometry() if isinstance(scene, trimesh.Scene) else scene
    material = mesh.visual.material
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    base = None if picture is None else np.asarray(picture.convert("RGB"))
    names = ("baseColorTexture", "normalTexture", "occlusionTexture", "image")
    found = [n for n in names if getattr(material, n, None) is not None]
    return ReadBack(
        "trimesh",
        path.name,
        np.asarray(mesh.vertices, np.float64)[mesh.faces],
        np.asarray(mesh.visual.uv)[mesh.faces],
        base,
        tuple(found),
    )


def by_open3d(path: Path) -> ReadBack:
    import open3d

    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    model = open3d.io.read_triangle_model(str(path))
    mesh = model.meshes[0].mesh
    material = model.materials[model.meshes[0].material_idx]
    picture = np.asarray(material.albedo_img) if material.albedo_img else None
    names = ("albedo_img", "normal_img", "ao_img", "roughness_img", "metallic_img")
    return ReadBack(
        "open3d",
        path.name,
        np.asarray(mesh.vertices)[np.asarray(mesh.triangles)],
        np.asarray(mesh.triangle_uvs).reshape(-1, 3, 2),
        None if picture is None or not picture.size else picture[..., :3],
        tuple(n for n in names if getattr(material, n) and np.asarray(getattr(material, n)).size),
    )


def by_usd(path: Path) -> ReadBack:
    from PIL import Image
    from pxr import Ar, Usd, UsdGeom, UsdShade

    stage = Usd.Stage.Open(str(path))
    mesh = next(UsdGeom.Mesh(p) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    pose = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(mesh.GetPrim())).T
    points = np.array(mesh.GetPointsAttr().Get(), np.float64) @ pose[:3, :3].T + pose[:3, 3]
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    uv = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").ComputeFlattened()).reshape(-1, 3, 2)
    material = UsdShade.MaterialBindingAPI(mesh.GetPrim()).ComputeBoundMaterial()[0]
    surface = material.ComputeSurfaceSource()[0]
    base, pictures = None, []
    for slot in surface.GetInputs():
        for source in slot.GetConnectedSources()[0]:
            reader = UsdShade.Shader(source.source.GetPrim())
            where = reader.GetInput("file").Get().resolvedPath
            space = reader.GetInput("sourceColorSpace").Get()
            data = bytes(Ar.GetResolver().OpenAsset(Ar.ResolvedPath(where)).GetBuffer())
            with Image.open(io.BytesIO(data)) as picture:
                pictures.append(f"{slot.GetBaseName()} {picture.width}x{picture.height} {space}")
                if slot.GetBaseName() == "diffuseColor":
                    base = np.asarray(picture.convert("RGB"))
    return ReadBack("usd-core", path.name, points[faces], uv, base, tuple(pictures))


def by_blender(
    files: list[Path], blender: str, *, camera: dict | None, envmap: Path | None, samples: int, threads: int
) -> list[ReadBack]:
    """All files in one run of Blender.

    Parameters
    ----------
    blender : Blender's program, or a Python that has the module bpy
    camera : scene.extras.camera; with `envmap` the files are rendered

    Raises
    ------
    InputError : it does not run, or does not read a file.
    """
    script = Path(__file__).with_name("_blender_read.py")
    python = Path(blender).name.startswith("python")
    head = [blender, str(script)] if python else [blender, "--background", "--python", str(script), "--"]
    with tempfile.TemporaryDirectory() as out:
        job = Path(out) / "job.json"
        where = None if envmap is None else str(envmap.resolve())
        names = [str(path.resolve()) for path in files]
        job.write_text(
            json.dumps(
                {"files": names, "out": out, "envmap": where, "camera": camera, "samples": samples, "threads": threads}
            )
        )
        # Blender has its own packages; ours on its path would be another Python's.
        environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
        run = subprocess.run([*head, str(job)], capture_output=True, text=True, env=environment, cwd=out, check=False)
        made = [Path(out) / f"{k}.json" for k in range(len(files))]
        if run.returncode or not all(p.is_file() for p in made):
            said = (run.stderr or run.stdout).strip().splitlines()
            raise InputError(
                expected=f"Blender, or a Python with bpy, at {blender}",
                received=said[-1] if said else f"exit status {run.returncode}",
                remedy="give another --blender",
            )
        return [_from_blender(path, said) for path, said in zip(files, made, strict=True)]


def _from_blender(path: Path, said: Path) -> ReadBack:
    facts = json.loads(said.read_text())
    with np.load(said.with_suffix(".npz")) as arrays:
        corners, uv, base = arrays["corners"], arrays["uv"], arrays.get("base")
    picture = said.with_suffix(".exr")
    pictures = (f"{slot} {w}x{h} {space}" for slot, (_, w, h, space) in sorted(facts["pictures"].items()))
    render = _rgba(picture) if picture.is_file() else None
    return ReadBack(f"Blender {facts['version']}", path.name, corners, uv, base, tuple(pictures), render)


def _rgba(path: Path) -> np.ndarray:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        name = {c.rsplit(".", 1)[-1]: c for c in channels}
        return np.stack([np.array(channels[name[c]].pixels, np.float32) for c in "RGBA"], -1)


VALIDATE = """
const fs = require("fs");
require("gltf-validator").validateBytes(new Uint8Array(fs.readFileSync(process.argv[1]))).then(r =>
  console.log(JSON.stringify([r.issues.numErrors, r.issues.numWarnings, r.issues.messages.map(m => m.code)])));
"""


def by_khronos(path: Path, modules: Path) -> tuple[int, int, list[str]]:
    """Errors, warnings and all codes of Khronos's validator.

    Parameters
    ----------
    modules : a node_modules folder that has gltf-validator
    """
    node = shutil.which("node")
    if node is None or not (modules / "gltf-validator").is_dir():
        raise InputError(
            expected=f"node, and gltf-validator in {modules}",
            received="no node" if node is None else "no such folder",
            remedy="npm install gltf-validator, and give its node_modules",
        )
    run = subprocess.run(
        [node, "-e", VALIDATE, str(path)],
        env={**os.environ, "NODE_PATH": str(modules)},
        capture_output=True,
        text=True,
        check=False,
    )
    if run.returncode:
        raise InputError(expected="a run of gltf-validator", received=run.stderr[-200:], remedy="install it again")
    errors, warnings, codes = json.loads(run.stdout)
    return errors, warnings, codes


def _flipped(uv: np.ndarray) -> np.ndarray:
    return np.stack([uv[..., 0], 1.0 - uv[..., 1]], -1)


@contextlib.contextmanager
def quiet():
    """Some readers print to the process's own stdout and stderr."""
    sys.stdout.flush()
    kept = os.dup(1), os.dup(2)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            for target, source in zip((1, 2), kept, strict=True):
                os.dup2(source, target)
                os.close(source)

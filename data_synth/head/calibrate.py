"""Calibrate the template's parameters against one outer surface (a tool of the developer; not used at run time).

Notation: ``x`` sample (mm), ``d`` its signed distance to the target (mm, positive outside), ``f`` the template field.
The loss is ``mean w |f(x) - d|`` over samples within ``near_mm`` of the surface, which fixes position and normal at
once, plus a one-sided loss ``max(0, margin - sign(d) f(x))`` over samples farther away, which forbids spurious sheets.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from data_synth.head import anatomy
from data_synth.head.template import (
    Primitives,
    Template,
    masses_field,
    template_field,
    template_from_json,
    template_to_json,
)
from sira_assets.mesh.open3d_core import open3d_core


@dataclass(frozen=True)
class CalibrationConfig:
    """Options of `calibrate`: numbers of samples, steps and points a step, added strokes, learning rate, seed."""

    samples: int = 400_000
    steps: int = 1500
    batch: int = 4000
    added_strokes: int = 40
    added_at_once: int = 10
    rate: float = 0.03
    near_mm: float = 4.0
    seed: int = 0


@dataclass(frozen=True)
class Samples:
    """Points (N, 3) and signed distances (N,) in mm, with a weight (N,)."""

    x_mm: np.ndarray
    distance_mm: np.ndarray
    weight: np.ndarray


def initial_template() -> Template:
    """The template as `anatomy` describes it, before calibration."""

    def columns(rows: tuple, is_mass: bool) -> Primitives:
        weight = [math.log(r[5]) for r in rows] if is_mass else [0.0 for _ in rows]
        return Primitives(
            tuple(r[0] for r in rows),
            torch.tensor([r[1] for r in rows]),
            torch.tensor([r[2] for r in rows], dtype=torch.float32),
            torch.log(torch.tensor([r[3] for r in rows], dtype=torch.float32)),
            torch.deg2rad(torch.tensor([r[4] for r in rows], dtype=torch.float32)),
            torch.tensor(weight, dtype=torch.float32),
        )

    centre, radii = anatomy.EYEBALL
    return Template(
        columns(anatomy.MASSES, True),
        columns(anatomy.STROKES, False),
        torch.tensor([*centre, *(math.log(r) for r in radii)]),
        torch.tensor(anatomy.LIDS),
        anatomy.FLOOR_MM,
    )


def _capped(vertices: np.ndarray, faces: np.ndarray, below_m: float = -0.1) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with its open border below ``below_m`` closed by a fan, so that nobody looks in from underneath."""
    edge = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edge, count = np.unique(edge, axis=0, return_counts=True)
    rim = edge[(count == 1) & (vertices[edge, 1].max(1) < below_m)]
    if len(rim) == 0:
        return vertices, faces
    middle = vertices[rim].reshape(-1, 3).mean(0)
    fan = np.c_[rim, np.full(len(rim), len(vertices))]
    return np.vstack([vertices, middle]), np.vstack([faces, fan])


def outer_surface(vertices: np.ndarray, faces: np.ndarray, directions: int = 96, need: int = 3) -> np.ndarray:
    """Faces that see the outside in at least ``need`` of ``directions`` directions (either side tried)."""
    o3d = open3d_core()

    rng = np.random.default_rng(0)
    w = rng.normal(size=(directions, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    scene = o3d.t.geometry.RaycastingScene()
    v_closed, f_closed = _capped(vertices, faces)
    scene.add_triangles(o3d.core.Tensor(v_closed.astype(np.float32)), o3d.core.Tensor(f_closed.astype(np.uint32)))
    corner = vertices[faces]
    n = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    n /= np.linalg.norm(n, axis=1, keepdims=True) + 1e-30
    centre = corner.mean(1)
    free = np.zeros(len(faces), int)
    for d in w:
        start = centre + 2e-5 * np.where((n @ d)[:, None] > 0, n, -n)
        ray = np.c_[start, np.broadcast_to(d, start.shape)].astype(np.float32)
        free += ~scene.test_occlusions(o3d.core.Tensor(ray)).numpy()
    return faces[free >= need]


def draw_samples(vertices_m: np.ndarray, faces: np.ndarray, config: CalibrationConfig) -> Samples:
    """Signed-distance samples of an outer surface with outward faces, folded onto x >= 0.

    A sample is kept only where its closest point lies inside a face rather than on the open border, that is where
    the offset is along the closest normal; there the sign of the offset is the sign of the distance.
    """
    o3d = open3d_core()

    rng = np.random.default_rng(config.seed)
    v = vertices_m * 1000.0
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(v.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32)))
    corner = v[faces]
    n = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(n, axis=1) / 2
    n /= 2 * area[:, None] + 1e-30
    centre = corner.mean(1)
    density = 1.0 + 4.0 * (np.linalg.norm(centre - [0, -30, 45], axis=1) < 95)
    fine = (np.abs(centre[:, 0]) < 50) & (centre[:, 2] > -3) & (np.abs(centre[:, 1] + 35) < 50)
    ear = (np.abs(centre[:, 0]) > 70) & (np.abs(centre[:, 1] + 28) < 35) & (centre[:, 2] > -105)
    density = density + 5.0 * fine + 14.0 * ear
    p = area * density
    pick = rng.choice(len(faces), config.samples, p=p / p.sum())
    b = rng.dirichlet([1.0, 1.0, 1.0], config.samples)
    x = (corner[pick] * b[..., None]).sum(1)
    scale = rng.choice([0.0, 0.6, 2.0, 7.0, 20.0, 60.0], config.samples, p=[0.27, 0.19, 0.15, 0.21, 0.10, 0.08])
    x = x + n[pick] * (scale * rng.normal(size=config.samples))[:, None]
    closest = scene.compute_closest_points(o3d.core.Tensor(x.astype(np.float32)))
    foot = closest["points"].numpy().astype(np.float64)
    normal = n[closest["primitive_ids"].numpy().astype(np.int64)]
    offset = x - foot
    d = np.linalg.norm(offset, axis=1)
    along = (offset * normal).sum(1)
    keep = (d < 0.02) | (np.abs(along) > 0.9 * d)
    signed = np.where(d < 0.02, 0.0, np.sign(along) * d)
    x[:, 0] = np.abs(x[:, 0])
    far_below = (x[:, 1] < -170) & (d > 3)
    keep &= ~far_below & (x[:, 1] > -222)
    weight = np.where(np.abs(signed) < 0.3, 2.0, 1.0)
    x, signed, weight = x[keep], signed[keep], weight[keep]
    # below the open border nothing is measured: the uncalibrated shoulders stand in, away from the target
    low = rng.uniform([0, -224, -190], [190, -165, 30], (config.samples // 8, 3))
    with torch.no_grad():
        masses = initial_template()
        bust = torch.cat([masses_field(masses, c) for c in torch.tensor(low, dtype=torch.float32).split(8000)]).numpy()
    free = scene.compute_distance(o3d.core.Tensor(low.astype(np.float32))).numpy() > 12.0
    return Samples(np.vstack([x, low[free]]), np.r_[signed, bust[free]], np.r_[weight, np.full(int(free.sum()), 0.3)])


def _trainable(t: Template) -> tuple[Template, list[dict]]:
    """A copy whose tensors require gradients, with Adam's groups (rates relative to one millimetre)."""

    def leaf(x: torch.Tensor) -> torch.Tensor:
        return x.detach().clone().requires_grad_(True)

    def free(p: Primitives) -> Primitives:
        return replace(
            p,
            centre_mm=leaf(p.centre_mm),
            log_size=leaf(p.log_size),
            rotation=leaf(p.rotation),
            weight=leaf(p.weight),
        )

    t = replace(t, masses=free(t.masses), strokes=free(t.strokes), eyeball=leaf(t.eyeball), lids=leaf(t.lids))
    groups = [
        {"params": [t.masses.centre_mm, t.strokes.centre_mm], "scale": 4.0},
        {"params": [t.strokes.weight], "scale": 1.5},
        {"params": [t.masses.log_size, t.strokes.log_size], "scale": 0.5},
        {"params": [t.masses.rotation, t.strokes.rotation, t.masses.weight], "scale": 0.4},
        {"params": [t.eyeball, t.lids], "scale": 0.3},
    ]
    return t, groups


def _loss(t: Template, x: torch.Tensor, d: torch.Tensor, w: torch.Tensor, near_mm: float) -> torch.Tensor:
    f = template_field(t, x)
    near = d.abs() < near_mm
    fit = (w * (f - d).abs())[near].mean()
    sign = torch.clamp(torch.clamp(d.abs(), max=12.0) * 0.5 - torch.sign(d) * f, min=0.0)[~near].mean()
    smallest = math.log(0.8)
    sizes = torch.clamp(smallest - t.strokes.log_size, min=0).sum() + torch.clamp(t.strokes.log_size - 4.0, min=0).sum()
    tall = torch.clamp(t.strokes.weight.abs() - 25.0, min=0).sum()
    thin = torch.clamp(math.log(1.5) - t.masses.log_size, min=0).sum()
    # needles are what strays from the surface
    stretch = t.masses.log_size.max(-1).values - t.masses.log_size.min(-1).values
    thin = thin + torch.clamp(stretch - math.log(7.0), min=0).sum()
    blend = (
        torch.clamp(math.log(0.5) - t.masses.weight, min=0).sum() + torch.clamp(t.lids[11:].neg() - 1.6, min=0).sum()
    )
    return fit + 0.5 * sign + 0.1 * (sizes + tall + thin + blend)


def optimise(t: Template, samples: Samples, config: CalibrationConfig, steps: int, rate: float) -> Template:
    """Adam with a cosine-decaying rate on all parameters of the template."""
    t, groups = _trainable(t)
    optimiser = torch.optim.Adam([{"params": g["params"], "lr": rate * g["scale"]} for g in groups], betas=(0.9, 0.98))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps, eta_min=rate * 0.02)
    x, d, w = (torch.tensor(a, dtype=torch.float32) for a in (samples.x_mm, samples.distance_mm, samples.weight))
    generator = torch.Generator().manual_seed(config.seed)
    start, running = time.time(), 0.0
    for step in range(steps):
        i = torch.randint(len(x), (config.batch,), generator=generator)
        optimiser.zero_grad()
        loss = _loss(t, x[i], d[i], w[i], config.near_mm)
        loss.backward()
        optimiser.step()
        schedule.step()
        running = float(loss.detach()) if step == 0 else 0.98 * running + 0.02 * float(loss.detach())
        if step % 100 == 99:
            print(f"step {step + 1:5d}  loss {running:.3f}  {time.time() - start:.0f} s", flush=True)
    detach = lambda p: replace(  # noqa: E731
        p,
        centre_mm=p.centre_mm.detach(),
        log_size=p.log_size.detach(),
        rotation=p.rotation.detach(),
        weight=p.weight.detach(),
    )
    return replace(
        t, masses=detach(t.masses), strokes=detach(t.strokes), eyeball=t.eyeball.detach(), lids=t.lids.detach()
    )


def add_strokes(t: Template, samples: Samples, count: int, seed: int) -> Template:
    """New strokes where the surface residual is greatest, named after the nearest anatomical stroke."""
    rng = np.random.default_rng(seed)
    on = np.flatnonzero((np.abs(samples.distance_mm) < 0.3) & (samples.x_mm[:, 1] > -200))
    on = rng.choice(on, min(40_000, len(on)), replace=False)
    x = samples.x_mm[on]
    with torch.no_grad():
        field = torch.cat([template_field(t, c) for c in torch.tensor(x, dtype=torch.float32).split(8000)]).numpy()
    error = field - samples.distance_mm[on]
    centre, size, height, names = [], [], [], []
    left = np.abs(error)
    for _ in range(count):
        # the mean residual in small neighbourhoods: what one stroke can remove
        probe = rng.choice(len(x), 600, p=left / left.sum())
        best, best_gain, best_size = probe[0], -1.0, 4.0
        for s in (2.0, 4.0, 8.0):
            near = np.exp(-0.5 * ((x[probe][:, None] - x[None, ::4]) ** 2).sum(-1) / s**2)
            gain = np.abs(near @ (error[::4] * (left[::4] > 0))) / np.sqrt(near.sum(1) + 1e-9)
            if gain.max() > best_gain:
                best, best_gain, best_size = probe[int(gain.argmax())], gain.max(), s
        c = x[best]
        reach = np.linalg.norm(x - c, axis=1)
        height.append(float(np.mean(error[reach < best_size])) if (reach < best_size).any() else 0.0)
        left = np.where(reach < 2.5 * best_size, 0.0, left)
        anatomical = t.strokes.centre_mm.numpy()
        nearest = int(np.linalg.norm(anatomical - c, axis=1).argmin())
        base = t.strokes.name[nearest].split(".")[0]
        taken = [*t.strokes.name, *names]
        k = 1
        while f"{base}.{k}" in taken:
            k += 1
        names.append(f"{base}.{k}")
        centre.append(c)
        size.append(np.log(best_size) * np.ones(3))
    stack = lambda a, b: torch.cat([a, torch.tensor(np.array(b), dtype=torch.float32)])  # noqa: E731
    p = t.strokes
    return replace(
        t,
        strokes=Primitives(
            (*p.name, *names),
            torch.cat([p.paired, torch.tensor([True] * count)]),
            stack(p.centre_mm, centre),
            stack(p.log_size, size),
            stack(p.rotation, np.zeros((count, 3))),
            stack(p.weight, height),
        ),
    )


def hard_samples(t: Template, samples: Samples, copies: int = 12) -> Samples:
    """The samples with those repeated whose side of the surface the template gets wrong by more than a millimetre."""
    with torch.no_grad():
        x = torch.tensor(samples.x_mm, dtype=torch.float32)
        f = torch.cat([template_field(t, c) for c in x.split(8000)]).numpy()
    d = samples.distance_mm
    wrong = np.flatnonzero((np.sign(f) != np.sign(d)) & (np.abs(d) > 1.0) | (np.abs(f - d) > 2.0) & (np.abs(d) < 1.0))
    print(len(wrong), "samples on the wrong side or off by 2 mm", flush=True)
    again = np.repeat(wrong, copies)[: len(d) // 2]
    return Samples(
        np.vstack([samples.x_mm, samples.x_mm[again]]),
        np.r_[d, d[again]],
        np.r_[samples.weight, samples.weight[again]],
    )


def residual(t: Template, samples: Samples) -> str:
    """One line: mean |f| on the surface, by region, in millimetres."""
    on = np.flatnonzero(np.abs(samples.distance_mm) < 0.01)[:30_000]
    x = samples.x_mm[on]
    with torch.no_grad():
        f = torch.cat([template_field(t, c) for c in torch.tensor(x, dtype=torch.float32).split(8000)]).abs().numpy()
    face = np.linalg.norm(x - [0, -31.6, 45.6], axis=1) < 95
    ear = (x[:, 0] > 72) & (np.abs(x[:, 1] + 28) < 32)
    rest = ~face & ~ear
    return f"mean |f| mm: face {f[face].mean():.3f}  ear {f[ear].mean():.3f}  rest {f[rest].mean():.3f}"


def main(argv: list[str] | None = None) -> int:
    """Command line: calibrate against TARGET (an open or closed mesh in the canonical frame, metres)."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("target", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--start", type=Path, help="continue from this template")
    parser.add_argument("--steps", type=int, default=CalibrationConfig.steps)
    parser.add_argument("--added-strokes", type=int, default=CalibrationConfig.added_strokes)
    parser.add_argument("--rate", type=float, default=CalibrationConfig.rate)
    options = parser.parse_args(argv)
    import trimesh

    torch.set_flush_denormal(True)
    config = CalibrationConfig(steps=options.steps, added_strokes=options.added_strokes, rate=options.rate)
    mesh = trimesh.load(options.target, process=False)
    vertices = np.asarray(mesh.vertices, np.float64)
    faces = outer_surface(vertices, np.asarray(mesh.faces))
    samples = draw_samples(vertices, faces, config)
    start = template_from_json(json.loads(options.start.read_text())) if options.start else initial_template()
    t = optimise(start, samples, config, config.steps, config.rate)
    print(residual(t, samples), flush=True)
    options.out.write_text(json.dumps(template_to_json(t)))
    for done in range(0, config.added_strokes, config.added_at_once):
        t = add_strokes(t, samples, config.added_at_once, config.seed + done)
        harder = hard_samples(t, samples)
        t = optimise(t, harder, config, max(config.steps // 3, 1), config.rate * 0.7)
        print(len(t.strokes.name), "strokes", residual(t, samples), flush=True)
        options.out.write_text(json.dumps(template_to_json(t)))
    options.out.write_text(json.dumps(template_to_json(t)))
    print(residual(t, samples))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

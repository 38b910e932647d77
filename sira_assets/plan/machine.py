"""How fast this machine is: three fixed pieces of work that stand for the stages of a run.

Plain arrays are what the stages between the fits do with a mesh: sort its edges, gather its corners, look for nearest
points. No one of these stands for the others: between two machines with equal networks and rays, sorting alone differed
2.5 times and whole stages hardly.

Notation: each piece is done several times and the lower quarter of its times counts, so that hiccups do not (they last
for several repeats of a short piece), and a machine that others use as well counts as it is now.
"""

import time
from collections.abc import Callable

import numpy as np

from sira_assets.fields.prior import Prior
from sira_assets.plan.figures import Benchmark

# A step's points in a fit, and rays, that take some tens of milliseconds.
POINTS, RAYS, NEAREST = 2000, 40_000, 2500
# Stages by what their time goes with; the others go with plain arrays.
NETWORK_STAGES = ("fit geometry", "fit appearance", "extract", "bake", "render")
RAY_STAGES = ("shadows",)


def benchmark(
    prior: Prior,
    *,
    repeats: int = 5,
    device: str = "cpu",
    clock: Callable[[], float] = time.perf_counter,
) -> Benchmark:
    """Measure this machine, in about a second.

    Parameters
    ----------
    prior : whose shape network is timed, forward and backward through its gradient as a fit does
    repeats : of each piece; of plain arrays three times as many
    clock : seconds; `time.process_time` leaves out what other programs take
    """
    import torch
    from scipy.spatial import cKDTree

    from sira_assets.fields.prior import freeze
    from sira_assets.fields.sa_sm import sdf_and_gradient
    from sira_assets.mesh.raycast import Raycaster
    from sira_assets.mesh.topology import topology
    from sira_assets.mesh.triangle_mesh import vertex_normals

    generator = torch.Generator(device).manual_seed(0)
    x = torch.rand(POINTS, 3, generator=generator, device=device) - 0.5
    z = prior.z_sdf.mean.to(device)
    model = prior.shape.to(device).requires_grad_(True)

    def network() -> None:
        f, gradient, _, _ = sdf_and_gradient(model, x, z, differentiable=True)
        (f.abs().mean() + (gradient.norm(dim=-1) - 1.0).square().mean()).backward()
        model.zero_grad(set_to_none=True)
        if torch.device(device).type == "cuda":
            torch.cuda.synchronize()

    caster, ball = Raycaster(_ball()), _ball(50, 100)
    rng = np.random.default_rng(0)
    origins = rng.normal(size=(RAYS, 3))
    origins *= 2.0 / np.linalg.norm(origins, axis=1, keepdims=True)
    aims = rng.normal(size=(RAYS, 3)) * 0.6 - origins
    aims /= np.linalg.norm(aims, axis=1, keepdims=True)

    def arrays() -> None:
        topology(ball)
        vertex_normals(ball.vertices, ball.faces)
        cKDTree(ball.vertices).query(aims[:NEAREST])

    try:
        return Benchmark(
            _usual(network, repeats, clock),
            _usual(lambda: caster.cast(origins, aims), repeats, clock),
            # Of a hundredth of a second each, so that the machine's hiccups weigh more.
            _usual(arrays, 3 * repeats, clock),
        )
    finally:
        freeze(model)


def speed(stage: str, here: Benchmark, there: Benchmark) -> float:
    """How many times as long as there a stage takes here."""
    kind = "network_s" if stage in NETWORK_STAGES else "rays_s" if stage in RAY_STAGES else "arrays_s"
    return getattr(here, kind) / max(getattr(there, kind), 1e-12)


def _usual(work: Callable[[], object], repeats: int, clock: Callable[[], float]) -> float:
    work()  # the first time allocates
    seconds = []
    for _ in range(repeats):
        began = clock()
        work()
        seconds.append(clock() - began)
    return float(np.quantile(seconds, 0.25))


def _ball(rows: int = 100, columns: int = 200):
    """A sphere of 2 rows columns triangles."""
    from sira_assets.mesh.triangle_mesh import TriangleMesh

    height, around = np.meshgrid(
        np.linspace(0, np.pi, rows + 1), np.arange(columns) * 2 * np.pi / columns, indexing="ij"
    )
    points = np.stack([np.sin(height) * np.cos(around), np.cos(height), np.sin(height) * np.sin(around)], -1)
    at = np.arange((rows + 1) * columns).reshape(rows + 1, columns)
    a, b, c, d = at[:-1], at[1:], np.roll(at, -1, 1)[1:], np.roll(at, -1, 1)[:-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return TriangleMesh(points.reshape(-1, 3), faces)

"""Reports as JSON and as tables for a terminal.

JSON has no infinity and no NaN: the PSNR of equal pictures is null beside an `mse` of 0.
"""

import dataclasses
import json
import math

import numpy as np

from sira_assets.measure.avatar_metrics import AvatarReport
from sira_assets.measure.protocols import Measured, SurfaceReport


def surface_json(report: SurfaceReport, *, region: str | None = None) -> str:
    """A surface report as JSON text: choices by name, alignment, and one entry per set of distances."""
    return json.dumps(_surface_dict(report, region), indent=1, allow_nan=False)


def avatar_json(report: AvatarReport) -> str:
    """An avatar report as JSON text."""
    data = _plain(dataclasses.replace(report, placed=None, after_icp=None))
    for name in ("placed", "after_icp"):
        surface = getattr(report, name)
        data[name] = None if surface is None else _surface_dict(surface, None)
    return json.dumps(data, indent=1, allow_nan=False)


def surface_table(report: SurfaceReport, *, region: str | None = None):
    """A rich renderable: the distances, the alignment and every choice."""
    from rich.console import Group
    from rich.text import Text

    a = report.alignment
    lines = [f"[bold]{choice.name}[/bold]: {choice.value}" for choice in report.choices]
    if a.kind != "none":
        motion = f"scale {a.scale:.4f}, turned {a.rotation_deg:.2f} degrees, moved {a.shift_mm:.2f} mm"
        fit = f"trimmed rms {a.rms_given_mm:.3f} -> {a.rms_mm:.3f} mm in {a.iterations} steps; {a.inliers:.1%} inliers"
        lines.append(f"[bold]alignment result[/bold]: {motion}; {fit}")
    lines += [f"[bold red]alignment failed[/bold red]: {problem}" for problem in a.problems]
    return Group(
        _distances_table(f"Surface distance, {report.protocol}", report, region), *map(Text.from_markup, lines)
    )


def avatar_tables(report: AvatarReport) -> list:
    """Rich tables of an avatar report: surfaces, pictures, and the rest."""
    from rich.table import Table

    out = []
    for title, surface in (("Surface, as placed", report.placed), ("Surface, after rigid ICP", report.after_icp)):
        if surface is not None:
            out.append(_distances_table(title, surface, None))
    if report.pictures:
        table = Table(title="Pictures, inside the mask")
        for heading in ("picture", "values", "gain", "PSNR dB", "SSIM", "flat colour dB"):
            table.add_column(heading, justify="left" if heading in ("picture", "values") else "right")
        for p in report.pictures:
            gain = f"{p.score.gain:.3f}" if p.scale_invariant else "raw"
            ssim = "-" if p.score.ssim is None else f"{p.score.ssim:.4f}"
            table.add_row(p.what, p.score.encoding, gain, f"{p.score.psnr_db:.2f}", ssim, f"{p.flat_psnr_db:.2f}")
        out.append(table)
    table = Table(title="Asset")
    table.add_column("what")
    table.add_column("value", justify="right")
    rows = (
        ("triangles", report.triangles, "d"),
        ("roughness", report.roughness, ".3f"),
        ("metallic", report.metallic, ".3f"),
        ("mask IoU", report.mask_iou, ".4f"),
        ("normals, degrees", report.normal_deg, ".2f"),
        ("normals with the normal map, degrees", report.mapped_normal_deg, ".2f"),
        ("specular correlation", report.specular_correlation, ".3f"),
    )
    for name, value, form in rows:
        table.add_row(name, "-" if value is None else format(value, form))
    return [*out, table]


def _distances_table(title: str, report: SurfaceReport, region: str | None):
    from rich import box
    from rich.table import Table

    # Narrow enough for 80 columns; JSON has the rest.
    table = Table(title=f"{title}, mm", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in ("region", "direction", "seen"):
        table.add_column(heading, no_wrap=True)
    for heading in ("mean", "median", "rms", "p95", "max", "samples"):
        table.add_column(heading, justify="right", no_wrap=True)
    for m in _wanted(report, region):
        d = m.distances
        row = ["-"] * 6
        if d is not None:
            row = [*(f"{v:.3f}" for v in (d.mean_mm, d.median_mm, d.rms_mm, d.p95_mm, d.max_mm)), str(d.samples)]
        table.add_row(m.region, m.direction, m.seen, *row)
    return table


def _wanted(report: SurfaceReport, region: str | None) -> list[Measured]:
    return [m for m in report.measured if region is None or m.region in (region, "now disc")]


def _surface_dict(report: SurfaceReport, region: str | None) -> dict:
    return {
        "protocol": report.protocol,
        "choices": {choice.name: choice.value for choice in report.choices},
        "alignment": {**_plain(report.alignment), "ok": report.alignment.ok},
        "measured": [_plain(m) for m in _wanted(report, region)],
    }


def _plain(value):
    """Dataclasses, arrays and tuples as what JSON knows."""
    if dataclasses.is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

"""Handles on surfaces whose genus is known: taken away when small, left when large, everything else as it was."""

import numpy as np
import pytest
import torch
import trimesh

from sira_assets.measure.surface import Surface
from sira_assets.mesh.clean import CleanConfig, clean_mesh, clean_with_report
from sira_assets.mesh.extract import ExtractConfig, extract_mesh
from sira_assets.mesh.handles import close_handles
from sira_assets.mesh.self_intersection import self_intersecting_faces
from sira_assets.mesh.topology import topology
from sira_assets.mesh.triangle_mesh import TriangleMesh


def thin_torus(radius=0.01, tube=0.001):
    ring = trimesh.creation.torus(radius, tube, major_sections=64, minor_sections=16)
    return TriangleMesh(np.array(ring.vertices), np.array(ring.faces))


class Handled:
    """A ball of 60 mm with `bridges` rings standing off it and `tunnels` bored through a lug at its side."""

    def __init__(self, bridges: int, tunnels: int):
        self.bridges, self.tunnels = bridges, tunnels

    def sdf(self, x):
        out = x.norm(dim=-1) - 0.06
        for number in range(self.bridges):
            ring = self._ring(x, number, self.bridges, height=0.02)
            out = torch.minimum(out, ring - 0.0025)
        lug = (x - x.new_tensor([0.06, 0.0, -0.02])).norm(dim=-1) - 0.015 if self.tunnels else None
        if lug is not None:
            out = torch.minimum(out, lug)
            for number in range(self.tunnels):
                bore = (x - x.new_tensor([0.068, -0.005 + 0.01 * number, 0.0]))[..., :2].norm(dim=-1) - 0.0018
                out = torch.maximum(out, -bore)
        return out

    @staticmethod
    def _ring(x, number, count, *, height):
        angle = torch.tensor(2 * np.pi * number / count + 0.3, dtype=x.dtype)
        out = torch.stack([angle.cos(), angle.sin(), torch.zeros_like(angle)])
        across = torch.stack([-angle.sin(), angle.cos(), torch.zeros_like(angle)])
        away = x - 0.06 * out - x.new_tensor([0.0, 0.0, height])
        plane = torch.stack([away @ out, away @ across, away[..., 2]], -1)
        return torch.hypot(torch.hypot(plane[..., 0], plane[..., 2]) - 0.008, plane[..., 1])


def lying_off(mesh, surface):
    """How far a mesh's vertices are from another's surface, metres."""
    return Surface(surface).distance(mesh.vertices)


def test_a_thin_ring_is_cut_once_and_hardly_changed():
    ring = thin_torus()
    out, closed = close_handles(ring, 0.007)
    shape = topology(out)
    assert (closed, shape.genus, shape.pieces, shape.watertight) == (1, 0, 1, True)
    assert shape.nonmanifold_vertices == shape.zero_area_faces == 0
    # Around the tube 2 pi mm, through the ring 56 mm: the short way is cut. Only the cut's 16 vertices have moved, by
    # less than an edge (1 mm), and their twins and two middles came.
    assert len(out.vertices) == len(ring.vertices) + 16 + 2
    still = (out.vertices[: len(ring.vertices)] == ring.vertices).all(1)
    assert (~still).sum() == 16
    assert np.array_equal(out.normals[: len(ring.normals)][still], ring.normals[still])
    assert lying_off(out, ring).max() < 0.001
    solid = [trimesh.Trimesh(m.vertices, m.faces, process=False).volume for m in (out, ring)]
    # Each side draws back by less than one of the 64 sections.
    assert solid[0] == pytest.approx(solid[1], rel=2 / 64)


@pytest.mark.parametrize("longest", [0.0, 0.005, 0.0062])
def test_a_longer_way_around_is_left(longest):
    # 16 sides of a circle of 1 mm: 32 sin(pi / 16) = 6.243 mm.
    ring = thin_torus()
    out, closed = close_handles(ring, longest)
    assert closed == 0
    assert out is ring
    assert close_handles(ring, 0.00625)[1] == 1


@pytest.mark.parametrize(("bridges", "tunnels"), [(1, 0), (3, 0), (0, 1), (2, 2)])
def test_bridges_and_tunnels_of_a_field_are_closed(bridges, tunnels):
    rough = extract_mesh(Handled(bridges, tunnels), ExtractConfig(cell_m=0.0012))
    assert topology(rough).genus == bridges + tunnels
    out, report = clean_with_report(rough, CleanConfig(close_handles_of_m=0.02))
    assert report.closed_handles == bridges + tunnels
    assert (report.result.genus, report.result.pieces, report.result.watertight) == (0, 1, True)
    assert report.result.nonmanifold_vertices == report.result.zero_area_faces == 0
    assert report.self_intersecting_faces == int(self_intersecting_faces(rough).sum())
    # Caps span at most the widest tunnel or bridge, 2.5 mm in radius.
    assert lying_off(out, rough).max() < 0.0025
    again = clean_mesh(out, CleanConfig(close_handles_of_m=0.02))
    assert np.array_equal(again.vertices, out.vertices)
    assert np.array_equal(again.faces, out.faces)


def test_large_handles_stay_when_small_ones_go():
    rough = extract_mesh(Handled(1, 1), ExtractConfig(cell_m=0.0012))
    # The bore is 11 mm around, the ring's tube 16 mm.
    out, report = clean_with_report(rough, CleanConfig(close_handles_of_m=0.0135))
    assert (report.closed_handles, topology(out).genus) == (1, 1)


def test_without_a_handle_or_closed_surface_nothing_happens():
    ball = extract_mesh(Handled(0, 0), ExtractConfig(cell_m=0.004))
    assert close_handles(ball, 1.0)[0] is ball
    ring = thin_torus()
    holed = TriangleMesh(ring.vertices, ring.faces[1:])
    assert close_handles(holed, 1.0)[0] is holed


@pytest.mark.slow
def test_the_generators_bald_head_has_no_handle_once_cleaned():
    from data_synth.head.template import load_template, template_field

    template = load_template()

    class Bald:
        def sdf(self, x):
            return 1e-3 * template_field(template, 1e3 * x)

    # 512^3 cells in the head's box; one strip of a lid's corner, five edges long, is a bridge at that size.
    _, report = clean_with_report(extract_mesh(Bald(), ExtractConfig(cell_m=0.00093)))
    assert (report.result.genus, report.result.pieces, report.result.watertight) == (0, 1, True)
    assert report.closed_handles <= 2

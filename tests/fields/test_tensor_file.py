"""Tensors on disk: what is read back by the library, and the same bytes each time."""

import itertools

import pytest
import torch
from safetensors import safe_open

from sira_assets.fields.tensor_file import write_tensors

ENTRIES = {"shape": '{"depth": 4}', "header": "", "light": "Sonne, größer", "a": "/"}


def test_the_library_reads_back_what_was_written(tmp_path):
    generator = torch.Generator().manual_seed(0)
    tensors = {
        "b": torch.randn(3, 5, generator=generator),
        "a/x": torch.randn(4, 2, generator=generator, dtype=torch.float64).T,  # not contiguous
        "count": torch.arange(3),
        "one": torch.tensor(2.5, requires_grad=True),
        "none": torch.zeros(0, 3),
    }
    tensors["alias"] = tensors["b"]
    write_tensors(tmp_path / "t.safetensors", tensors, ENTRIES)
    with safe_open(tmp_path / "t.safetensors", "pt") as file:
        assert file.metadata() == ENTRIES
        assert set(file.keys()) == set(tensors)
        for name, tensor in tensors.items():
            torch.testing.assert_close(file.get_tensor(name), tensor.detach(), rtol=0, atol=0)
    assert [p.name for p in tmp_path.iterdir()] == ["t.safetensors"]


@pytest.mark.parametrize("size", range(1, 5))
def test_the_order_of_entries_makes_no_difference(tmp_path, size):
    path, tensors = tmp_path / "t.safetensors", {"b": torch.ones(size), "a": torch.zeros(2, dtype=torch.int16)}
    seen = set()
    for order in itertools.permutations(ENTRIES):
        write_tensors(path, dict(reversed(tensors.items())), {name: ENTRIES[name] for name in order})
        seen.add(path.read_bytes())
    assert len(seen) == 1

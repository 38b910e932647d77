"""Named tensors in a safetensors file, the same bytes for the same content.

Notation: a file is the header's length (8 bytes, little-endian), the header in JSON, the tensors. The library writes
the header's text entries in the order of a hash that is new in every process; here they are sorted.
"""

import json
import os
from collections.abc import Mapping

import torch
from safetensors.torch import save

from sira_assets.atomic import write_bytes

_LENGTH = 8


def write_tensors(path: str | os.PathLike, tensors: Mapping[str, torch.Tensor], entries: Mapping[str, str]) -> None:
    """Write `tensors`, of any device, and text `entries` to `path`, whole or not at all."""
    # Tensors that share memory are refused by the library: each is a copy.
    data = save({name: t.detach().cpu().clone().contiguous() for name, t in tensors.items()}, dict(entries))
    end = _LENGTH + int.from_bytes(data[:_LENGTH], "little")
    header = json.dumps(json.loads(data[_LENGTH:end]), sort_keys=True, separators=(",", ":")).encode()
    header = header.ljust(-(-len(header) // _LENGTH) * _LENGTH)  # tensors begin at a multiple of eight
    write_bytes(path, b"".join([len(header).to_bytes(_LENGTH, "little"), header, memoryview(data)[end:]]))

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sira_assets.asset.split import split_at_seams


@st.composite
def corner_indices(draw):
    count = draw(st.integers(1, 30))
    top = draw(st.integers(0, 12))
    index = hnp.arrays(np.int64, (count, 3), elements=st.integers(0, top))
    return draw(index), draw(index)


@given(corner_indices())
def test_split_gives_each_corner_its_own_position_and_uv_and_no_pair_twice(indices):
    faces, faces_uv = indices
    split = split_at_seams(faces, faces_uv)
    assert (split.position_index[split.faces] == faces).all()
    assert (split.uv_index[split.faces] == faces_uv).all()
    pairs = np.stack([split.position_index, split.uv_index], 1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    assert set(split.faces.reshape(-1).tolist()) == set(range(len(pairs)))


def test_a_mesh_without_seams_keeps_its_vertices():
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    split = split_at_seams(faces, faces)
    assert (split.faces == faces).all()
    assert len(split.position_index) == 4

"""Torch threads for a while."""

import pytest
import torch as th

from ogmp_sb3.sb3.threads import torch_threads


def test_the_number_of_threads_is_as_before_also_after_a_mistake() -> None:
    before = th.get_num_threads()
    with pytest.raises(KeyError), torch_threads(before + 1):
        assert th.get_num_threads() == before + 1
        raise KeyError
    assert th.get_num_threads() == before

"""Copies of arrays and the way back."""

from __future__ import annotations

import numpy as np
import pytest

from ogmp_sb3.env import snapshots


def test_what_was_taken_comes_back_into_the_same_arrays() -> None:
    arrays = {"a": np.arange(3.0), "b": np.ones((3, 2), dtype=bool)}
    a = arrays["a"]
    saved = snapshots.take(arrays, "of.")
    a += 1.0
    arrays["b"][:] = False
    assert set(saved) == {"of.a", "of.b"}
    snapshots.put_back(arrays, saved, "of.")
    assert arrays["a"] is a
    np.testing.assert_array_equal(a, [0.0, 1.0, 2.0])
    assert arrays["b"].all()


@pytest.mark.parametrize("saved", [{}, {"a": np.zeros(2)}, {"x.a": np.zeros(3)}])
def test_what_is_missing_or_of_another_size_is_named(saved: dict[str, np.ndarray]) -> None:
    with pytest.raises(ValueError, match=r"does not fit this task and 3 environments \(a\)"):
        snapshots.put_back({"a": np.arange(3.0)}, saved)


def test_rows_that_were_packed_come_back_into_other_rows_bit_for_bit() -> None:
    arrays = [np.arange(3.0), np.arange(12.0).reshape(3, 2, 2), np.array([1, 2, 3])]
    packed = snapshots.pack(arrays, np.array([0, 2]))
    np.testing.assert_array_equal(packed, [[0, 0, 1, 2, 3, 1], [2, 8, 9, 10, 11, 3]])
    snapshots.unpack(arrays, np.array([1, 0]), packed)
    np.testing.assert_array_equal(arrays[0], [2, 0, 2])
    np.testing.assert_array_equal(arrays[1][0], arrays[1][2])
    np.testing.assert_array_equal(arrays[1][1], [[0, 1], [2, 3]])
    np.testing.assert_array_equal(arrays[2], [3, 1, 3])

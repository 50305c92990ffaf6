"""The record of one episode."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from helpers.records import STEPS, record


def test_steps_do_not_count_the_start() -> None:
    assert record().steps == STEPS
    assert record(reward=np.zeros(1)).steps == 0


def test_a_record_cannot_be_changed() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        record().termination = "fall"  # type: ignore[misc]

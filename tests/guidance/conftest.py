"""A small encoder and the references that it is trained on."""

from __future__ import annotations

import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.guidance import encoder_training as encoder


@pytest.fixture(scope="module")
def data() -> encoder.ReferenceData:
    return encoder.reference_data(load_task("parkour"), per_mode=30, seed=0)


@pytest.fixture(scope="module")
def model(data) -> encoder.AutoEncoder:
    return encoder.fit(data, updates=150, seed=0)

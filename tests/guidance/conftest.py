"""A small encoder and the references that it is trained on."""

from __future__ import annotations

import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.guidance.encoder_training import AutoEncoder, fit
from ogmp_sb3.guidance.reference_data import ReferenceData, reference_data


@pytest.fixture(scope="module")
def data() -> ReferenceData:
    return reference_data(load_task("parkour"), 90, np.random.SeedSequence(0))


@pytest.fixture(scope="module")
def model(data: ReferenceData) -> AutoEncoder:
    return fit(data, updates=100, seed=0)

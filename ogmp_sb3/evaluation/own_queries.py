"""How much the latent keeps of the references that a policy itself asks for."""

from __future__ import annotations

import numpy as np

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.guidance.encoder_training import LatentQuality, latent_quality, load_auto_encoder
from ogmp_sb3.guidance.reference_data import collect, reference_data

NEIGHBOURS = 1000  # references of random courses, in whose modes a query is to find itself
SEEDS = 20_240  # of these courses: of the test tracks none


def own_queries(task: TaskConfig, records: list[EpisodeRecord]) -> LatentQuality | None:
    """How much the task's encoder keeps of all that episodes asked its oracle for.

    :param task: the task they were played on
    :return: None if the latent is not observed, or the encoder came without its decoder
    """
    queries = [query for record in records for query in record.queries]
    model = load_auto_encoder(task.encoder) if task.uses_latent and task.encoder and queries else None
    if model is None:
        return None
    return latent_quality(model, reference_data(task, NEIGHBOURS, np.random.SeedSequence(SEEDS)), collect(queries))

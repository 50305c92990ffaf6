"""What a learner goes on from: complete, exact, and refused with a sentence where it is another one's."""

from __future__ import annotations

import copy
import random

import numpy as np
import pytest
import torch as th

from helpers.learners import learner, update
from ogmp_sb3.runs.learner_state import set_state, state


@pytest.fixture(scope="module")
def taken():
    model, callback = learner()
    update(model, callback, 2)
    tensors, plain = state(model)
    return model, callback, copied(tensors), copy.deepcopy(plain)


@pytest.fixture(scope="module")
def fresh_model():
    return learner(seed=9)[0]


def copied(tensors: dict[str, th.Tensor]) -> dict[str, th.Tensor]:
    return {name: tensor.clone() for name, tensor in tensors.items()}


@pytest.mark.parametrize("critic", [{}, {"reference_error": {}}])
def test_a_fresh_learner_goes_on_as_the_one_that_was_saved(critic: dict[str, dict[str, float]]) -> None:
    model, callback = learner(critic_observations=critic)
    update(model, callback, 2)
    tensors, plain = copied(state(model)[0]), copy.deepcopy(state(model)[1])
    other, other_callback = learner(seed=5, critic_observations=critic)
    weights = copy.deepcopy(model.policy.state_dict())
    set_state(model, copied(tensors), plain)  # both from the same moment: the generators are the process's own
    update(model, callback)
    drawn = np.random.random(), random.random(), th.rand(1).item()
    other.policy.load_state_dict(weights)
    set_state(other, copied(tensors), plain)
    update(other, other_callback)
    assert (np.random.random(), random.random(), th.rand(1).item()) == drawn
    for one, two in zip(model.policy.state_dict().values(), other.policy.state_dict().values(), strict=True):
        assert th.equal(one, two)
    assert other.num_timesteps == model.num_timesteps
    assert [e["r"] for e in other.ep_info_buffer] == [e["r"] for e in model.ep_info_buffer]


def test_every_tensor_is_needed_and_has_its_shape(taken, fresh_model) -> None:
    _, _, tensors, plain = taken
    for name, tensor in tensors.items():
        if name.startswith("optimiser.") and name.endswith(".step"):
            continue  # without it, the optimiser has yet to make its first step of this weight
        rest = {key: value for key, value in tensors.items() if key != name}
        older = name.endswith("_action")  # older checkpoints do not have it
        for changed in (*([] if older else [rest]), {**rest, name: th.zeros((*tensor.shape, 3), dtype=tensor.dtype)}):
            with pytest.raises(ValueError) as caught:
                set_state(fresh_model, changed, plain)
            assert "\n" not in str(caught.value) and len(str(caught.value)) > 3, name


def test_every_entry_is_needed_and_of_its_kind(taken, fresh_model) -> None:
    _, _, tensors, plain = taken
    for key in plain:
        for value in ("nonsense", None, [], {}, [["a"]], {"generators": 3, "modes": 3}, -1.5):
            changed = {**plain, key: value}
            if key == "episodes" and value == []:
                continue  # no episode has ended
            with pytest.raises(ValueError) as caught:
                set_state(fresh_model, tensors, changed)
            assert "\n" not in str(caught.value), key
        if key != "undone_updates":  # which older checkpoints do not have
            with pytest.raises(ValueError, match=key):
                set_state(fresh_model, tensors, {k: v for k, v in plain.items() if k != key})


def test_generators_that_are_none_are_a_sentence(taken, fresh_model) -> None:
    _, _, tensors, plain = taken
    for generators in (
        [],
        [{}],
        [{"bit_generator": "PCG64"}] * 2,
        [{"bit_generator": "MT19937", "state": {}}] * 2,
        [3, 4],
    ):
        changed = {**plain, "environment": {**plain["environment"], "generators": generators}}
        with pytest.raises(ValueError):
            set_state(fresh_model, tensors, changed)


@pytest.mark.parametrize("other", [{"envs": 3}, {"hidden": 4}])
def test_a_learner_of_another_size_is_a_sentence(other, taken) -> None:
    _, _, tensors, plain = taken
    with pytest.raises(ValueError, match="has the shape"):
        set_state(learner(**other)[0], tensors, plain)

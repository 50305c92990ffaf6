"""Task variants: how often modes come, how their parameters spread, and what the curriculum does to both."""

from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from helpers.mistakes import SHIPPED, put, write
from ogmp_sb3.config.answers import FunctionFailed
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.registry import modes
from ogmp_sb3.guidance.modes import Segment, Span, jump
from ogmp_sb3.guidance.sampling import ModeCall, ModeSampler, corner_segments

DRAWS = 4000
PARKOUR = load_task("parkour", {"curriculum": None, "sampling.weights": {"pace": 1.0, "jump": 2.0, "leap": 5.0}})
CURRICULUM = load_task(
    "parkour",
    {
        "sampling.weights": {"pace": 1.0, "jump": 3.0, "leap": 2.0},
        "curriculum.weights": {"pace": 2.0, "jump": 1.0, "leap": 0.0},
        "modes.jump.h": [0.2, 0.4],
        "curriculum.modes": {"jump": {"h": [0.0, 0.1]}},
    },
)


def draw(task, seed: int = 0, draws: int = DRAWS, level: float = 1.0) -> list[ModeCall]:
    rng = np.random.default_rng(seed)
    sampler = ModeSampler(task)
    return [sampler.draw(rng, index, level) for index in range(draws)]


def test_a_mode_call_asks_what_its_mode_asks():
    assert ModeCall("jump", {"w": 0.4, "h": 0.2}).segment() == jump(w=0.4, h=0.2)


def test_modes_come_as_often_as_their_weights_say():
    counts = Counter(call.name for call in draw(PARKOUR))
    for name, weight in {"pace": 1.0, "jump": 2.0, "leap": 5.0}.items():
        share = weight / 8.0
        assert counts[name] / DRAWS == pytest.approx(share, abs=5 * np.sqrt(share * (1 - share) / DRAWS))


def test_a_mode_of_weight_zero_never_comes_wherever_it_is_listed():
    for absent in ("pace", "jump", "leap"):
        task = load_task("parkour", {"curriculum": None, f"sampling.weights.{absent}": 0.0})
        assert {call.name for call in draw(task, draws=300)} == {"pace", "jump", "leap"} - {absent}


def test_modes_follow_each_other_independently():
    names = [call.name for call in draw(PARKOUR)]
    after_leap = [b for a, b in pairwise(names) if a == "leap"]
    assert Counter(after_leap)["leap"] / len(after_leap) == pytest.approx(5 / 8, abs=0.05)


def test_parameters_fill_their_ranges_evenly_and_fixed_ones_stay():
    calls = [call for call in draw(PARKOUR) if call.name == "leap"]
    w = np.array([call.parameters["w"] for call in calls])
    low, high = PARKOUR.mode_ranges["leap"]["w"].corners()
    assert (w >= low).all() and (w <= high).all()
    counts, _ = np.histogram(w, bins=5, range=(low, high))
    np.testing.assert_allclose(counts / len(w), 0.2, atol=0.05)
    assert {call.parameters["d"] for call in calls} == {0.5}
    run_up = np.array([call.parameters["run_up"] for call in calls])
    assert abs(np.corrcoef(w, run_up)[0, 1]) < 0.1  # parameters do not move together


def test_words_come_equally_often():
    task = load_task("dive", {"sampling.repeat": "all", "sampling.sequence": ["flip"]})
    counts = Counter(call.parameters["r"] for call in draw(task, draws=2000))
    assert set(counts) == {"front", "back", "left", "right"}
    np.testing.assert_allclose([n / 2000 for n in counts.values()], 0.25, atol=0.05)


@pytest.mark.parametrize(
    ("repeat", "expected"),
    [("all", ["flip", "settle", "settle"] * 3), ("last", ["flip", "settle", "settle"] + ["settle"] * 6)],
)
def test_a_sequence_is_followed_in_order_and_repeats_as_asked(repeat, expected):
    task = load_task("dive", {"sampling.repeat": repeat, "sampling.sequence": ["flip", "settle", "settle"]})
    assert [call.name for call in draw(task, draws=9)] == expected


def test_the_same_seed_draws_the_same_variant_and_another_seed_another():
    assert draw(PARKOUR, seed=7, draws=50) == draw(PARKOUR, seed=7, draws=50)
    assert draw(PARKOUR, seed=7, draws=50) != draw(PARKOUR, seed=8, draws=50)


@pytest.mark.parametrize(("level", "weights"), [(0.0, (2.0, 1.0, 0.0)), (0.25, (1.75, 1.5, 0.5)), (1.0, (1, 3, 2))])
def test_curriculum_level_moves_weights_from_its_own_to_the_tasks(level, weights):
    counts = Counter(call.name for call in draw(CURRICULUM, level=level))
    for name, weight in zip(("pace", "jump", "leap"), weights, strict=True):
        share = weight / sum(weights)
        assert counts[name] / DRAWS == pytest.approx(share, abs=5 * np.sqrt(share * (1 - share) / DRAWS))


@pytest.mark.parametrize(("level", "expected"), [(0.0, (0.0, 0.1)), (0.5, (0.1, 0.25)), (1.0, (0.2, 0.4))])
def test_curriculum_level_moves_ranges_from_its_own_to_the_tasks(level, expected):
    jumps = [call.parameters for call in draw(CURRICULUM, level=level) if call.name == "jump"]
    heights, widths = ([parameters[key] for parameters in jumps] for key in ("h", "w"))
    assert (min(heights), max(heights)) == pytest.approx(expected, abs=0.01)
    assert expected[0] <= min(heights) and max(heights) <= expected[1]
    assert (min(widths), max(widths)) == pytest.approx(CURRICULUM.mode_ranges["jump"]["w"].corners(), abs=0.01)


def test_a_place_in_a_sequence_with_a_parameter_of_its_own_follows_the_curriculum_in_the_others():
    overrides = {
        "sampling": {"order": "sequence", "sequence": [{"jump": {"w": 0.4}}], "repeat": "all"},
        "curriculum.modes": {"jump": {"h": [0.02, 0.05]}},
    }
    calls = draw(load_task("parkour", overrides), level=0.0, draws=50)
    assert all(call.parameters["w"] == 0.4 and 0.02 <= call.parameters["h"] <= 0.05 for call in calls)


def test_a_place_in_a_sequence_can_have_a_parameter_that_the_tasks_mode_leaves_to_its_default(tmp_path):
    data = put(put(SHIPPED["parkour"], "curriculum", None), "modes.pace", {"v": 1.0})
    sequence = {"order": "sequence", "sequence": [{"pace": {"length": 3.0}}, "pace"]}
    task = load_task(write(tmp_path, put(data, "sampling", sequence)))
    assert [call.parameters for call in draw(task, draws=2)] == [{"v": 1.0, "length": 3.0}, {"v": 1.0}]


def test_modes_drawn_at_level_zero_are_the_curriculums():
    calls = draw(CURRICULUM, level=0.0, draws=600)
    assert {call.name for call in calls} == {"pace", "jump"}
    heights = [call.parameters["h"] for call in calls if call.name == "jump"]
    assert 0.0 <= min(heights) and max(heights) <= 0.1


def test_without_a_curriculum_the_level_does_not_matter():
    assert draw(PARKOUR, level=0.0, draws=50) == draw(PARKOUR, level=1.0, draws=50)


def test_corners_are_every_combination_of_extreme_parameters():
    only_jump = load_task("parkour", {"modes.pace": None, "modes.leap": None, "curriculum": None})
    corners = {(s.plateaus[1].end - s.plateaus[1].start, s.plateaus[1].top) for s in corner_segments(only_jump)}
    low, high = only_jump.mode_ranges["jump"]["h"].corners()
    assert {(round(w, 9), h) for w, h in corners} == {(w, h) for w in (0.3, 0.5) for h in (low, high)}


def test_a_place_in_a_sequence_can_have_parameters_of_its_own():
    sequence = [{"pace": {"v": 2.5, "length": 2.0}}, "jump", {"jump": {"h": [0.01, 0.02]}}]
    overrides = {"curriculum": None, "sampling": {"order": "sequence", "sequence": sequence, "repeat": "last"}}
    task = load_task("parkour", overrides)
    for seed in range(20):
        pace, jump, low, again = draw(task, seed=seed, draws=4)
        assert (pace.name, pace.parameters) == ("pace", {"v": 2.5, "length": 2.0})
        assert 0.2 <= jump.parameters["h"] <= 0.35
        assert all(0.01 <= call.parameters["h"] <= 0.02 and 0.3 <= call.parameters["w"] <= 0.5 for call in (low, again))
    assert max(span.velocity[0] for s in corner_segments(task) for span in s.spans) == 2.5


GROUND = Segment(length=1.0, spans=(Span(end=1.0, velocity=(0.8, 0.0)),))
WRONG_MODES = {
    "nothing": (None, "what mode 'mine' returns must be a Segment; it is nothing"),
    "numbers for spans": (
        replace(GROUND, spans=(1.0,)),
        "'modes.mine' is made of a Span that is the number 1.0",
    ),
    "no spans": (replace(GROUND, spans=()), r"'modes.mine' has no set-points, not one Span \(v 1"),
    "NaN": (replace(GROUND, spans=(Span(end=np.nan),)), r"'modes.mine' asks for a number that is not finite \(v 1"),
    "negative length": (replace(GROUND, length=-1.0), r"'modes.mine' takes no length of the track \(v 1"),
    "backwards": (replace(GROUND, spans=(Span(end=1.0, velocity=(-1.0, 0.0)),)), r"'modes.mine' runs backwards"),
}


@pytest.mark.parametrize("case", [*WRONG_MODES, "exception"])
def test_a_mode_that_cannot_be_laid_is_named_with_its_parameters(case, monkeypatch):
    answer, message = WRONG_MODES.get(case, (None, r"^mode 'mine' failed in line \d+ of .*/test_sampling.py: Zero"))

    def mine(v: float):
        return 1 / 0 if case == "exception" else answer

    monkeypatch.setitem(modes._functions, "mine", mine)
    task = load_task("parkour", {"curriculum": None, "sampling.weights": {}, "modes": {"mine": {"v": [1.0, 2.0]}}})
    kind = FunctionFailed if case == "exception" else (TypeError, ValueError)
    with pytest.raises(kind, match=message):
        list(corner_segments(task))

"""What a search is over, in Hydra's grammar."""

from __future__ import annotations

from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from ogmp_sb3.commands.train.space import Space, check_space, read_space

distributions = pytest.importorskip("optuna.distributions", reason="needs the extra 'optuna'")


def space(*words: str) -> Space:
    return read_space(OverridesParser.create().parse_overrides(list(words)))


Float, Int, Choice = (
    getattr(distributions, f"{kind}Distribution") for kind in ("Float", "Int", "Categorical")
)  # fmt: skip


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("rho=interval(0.2,0.8)", Float(0.2, 0.8)),
        ("rho=interval(1,5)", Float(1.0, 5.0)),
        ("horizon=int(interval(7,30))", Int(7, 30)),
        ("ppo.learning_rate=tag(log,interval(1e-4,1e-3))", Float(1e-4, 1e-3, log=True)),
        ("horizon=range(7,31,8)", Int(7, 23, step=8)),  # Hydra's ranges do not hold their end
        ("horizon=range(30,7,-8)", Int(14, 30, step=8)),
        ("rho=range(0.1,0.5,0.2)", Float(0.1, 0.3, step=0.2)),
        ("horizon=tag(log,range(1,9))", Int(1, 8, log=True)),
        ("oracle=lqr,preview", Choice(["lqr", "preview"])),
        ("oracle=choice(lqr,preview)", Choice(["lqr", "preview"])),
        ("rho=0.1,null,0.1", Choice(["0.1", "null"])),
        ("modes.jump.h=[0.1,0.2],[0.2,0.3]", Choice(["[0.1,0.2]", "[0.2,0.3]"])),
        ("rho=range(3,4)", Choice(["3"])),
    ],
)
def test_hydra_s_words_for_several_values_are_optuna_s_distributions(word: str, expected: Any) -> None:
    assert dict(space(word).searched) == {word.partition("=")[0]: expected}


def test_the_jobs_of_some_values_have_what_was_typed_and_a_seed_each() -> None:
    found = space("task=dive", "rho=interval(0.2,0.8)", "+experiment=a", "seed=0,1", "oracle=lqr,preview", "num_envs=8")
    values = {"rho": 0.123456789, "oracle": "lqr"}
    given = ["task=dive", "+experiment=a", "num_envs=8"]
    expected = [[*given, "rho=0.123457", "oracle=lqr", f"seed={seed}"] for seed in (0, 1)]
    assert found.command_lines(values) == expected
    assert found.name(values) == "rho=0.123457,oracle=lqr"
    assert space("task=dive", "rho=0.1,0.2", "total_timesteps=64").command_lines({"rho": "0.1"}) == [
        ["task=dive", "rho=0.1"]
    ]


def test_all_combinations_are_listed_where_they_can_be_counted() -> None:
    found = space("rho=range(0.1,0.35,0.1)", "horizon=range(7,9)", "oracle=lqr,preview").combinations()
    assert found is not None
    assert len(found) == 3 * 2 * 2
    assert {values["rho"] for values in found} == {0.1, 0.2, 0.3}
    assert space("rho=0.1,0.2", "horizon=interval(1,2)").combinations() is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["task=dive", "rho=0.3"], r"a search needs a key whose values it chooses: give an interval, rho=interval"),
        (["rho=interval(0.8,0.2)"], r"'rho=interval\(0.8,0.2\)': the interval ends at 0.2, which is not above 0.8"),
        (["rho=tag(log,interval(0,1))"], "on a logarithmic scale numbers must be above 0, found 0"),
        (["rho=tag(lgo,interval(0.1,1))"], r"unknown tag 'lgo' \(allowed: log\)\. Did you mean 'log'"),
        (["oracle=tag(log,choice(lqr,preview))"], r"the tag 'log' is for numbers"),
        (["horizon=tag(log,range(1,9,2))"], "a range with the tag 'log' has steps of 1, found 2"),
        (["rho=tag(log,range(1.5,9))"], "is of whole numbers"),
        (["horizon=range(3,3)"], "names no value to choose from"),
        (["total_timesteps=1,2"], "a search takes one value of 'total_timesteps'"),
        (["task=dive,stairs"], "a search takes one value of 'task'"),
        (["rho=0.1,0.2", "task.rho=interval(0,1)"], "'rho' is given twice"),
    ],
)
def test_what_cannot_be_searched_is_told_in_a_sentence(words: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        space(*words)


def test_jobs_are_tried_inside_and_at_the_ends_of_intervals_before_any_is_trained() -> None:
    tried: list[str] = []
    found = space("rho=interval(0,1)", "oracle=lqr,preview")

    def mistake(job: list[str]) -> Exception | None:
        tried.append(",".join(job))
        values = dict(word.partition("=")[::2] for word in job)
        return ValueError("rho") if float(values["rho"]) <= 0 else TypeError("word") if "lqr" in job[1] else None

    with pytest.raises(ValueError, match="rho"):
        check_space(found, mistake)
    assert tried == ["rho=0.382,oracle=lqr", "rho=0.382,oracle=preview", "rho=0,oracle=preview"]
    with pytest.raises(TypeError, match="word"):
        check_space(space("rho=interval(0.1,1)", "oracle=lqr,lqr"), mistake)
    check_space(space("rho=interval(0.1,1)", "oracle=lqr,preview"), mistake)  # what fails alone is told at the end

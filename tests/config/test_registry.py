"""Tests of the registry: names, signatures as schemas, and messages that say what is allowed."""

import re

import pytest

from helpers.paths import ROOT
from ogmp_sb3.config import registry
from ogmp_sb3.config.registry import NameTaken, Registry

DOCS = ROOT / "docs"
ALL = {
    "mode": registry.modes,
    "oracle": registry.oracles,
    "observation": registry.observations,
    "reward": registry.rewards,
    "termination": registry.terminations,
    "metric": registry.metrics,
    "objective": registry.objectives,
}


@pytest.fixture
def terms() -> Registry:
    terms = Registry("term", arguments=1)

    @terms.register()
    def gap(view: object, length: float, depth: float = 0.5) -> float:
        return length * depth

    @terms.register("return")
    def undiscounted(view: object) -> float:
        return 0.0

    return terms


# ---- register, get, names ----


def test_a_function_is_found_by_its_own_or_a_given_name(terms: Registry) -> None:
    assert terms.names() == ["gap", "return"]
    assert terms.get("gap")(None, 2.0) == 1.0
    assert terms.get("return").__name__ == "undiscounted"


def test_register_hands_the_function_back_unchanged(terms: Registry) -> None:
    def step(view: object) -> None: ...

    assert terms.register()(step) is step


def test_a_name_cannot_be_registered_twice(terms: Registry) -> None:
    def step(view: object) -> None: ...

    step.__module__ = "elsewhere"
    with pytest.raises(
        NameTaken, match=rf"^term 'gap' of elsewhere is registered already, by {re.escape(__name__)}\.$"
    ):
        terms.register("gap")(step)
    assert terms.get("gap")(None, 2.0) == 1.0


def test_a_parameter_without_an_annotation_is_an_error_at_once(terms: Registry) -> None:
    with pytest.raises(TypeError, match=r"^term 'step': the parameter 'weight' needs an annotation\.$"):

        @terms.register()
        def step(view, weight): ...

    assert "step" not in terms.names()


def test_an_unknown_name_is_an_error_with_the_closest_match(terms: Registry) -> None:
    with pytest.raises(KeyError, match=r"unknown term 'gab' \(allowed: gap, return\)\. Did you mean 'gap'\?"):
        terms.get("gab")


def test_a_name_with_a_line_break_does_not_break_the_message(terms: Registry) -> None:
    with pytest.raises(KeyError) as caught:
        terms.get("ga\np")
    assert "\n" not in caught.value.args[0]


# ---- parameters ----


def test_yaml_parameters_are_the_signature_without_what_the_library_passes(terms: Registry) -> None:
    parameters = terms.parameters("gap")
    assert list(parameters) == ["length", "depth"]
    assert parameters["length"].annotation is float
    assert terms.parameters("return") == {}


@pytest.mark.parametrize("kind", ALL)
def test_every_registered_function_has_annotated_parameters(kind: str) -> None:
    assert ALL[kind].kind == kind
    assert ALL[kind].names()
    for name in ALL[kind].names():
        for parameter in ALL[kind].parameters(name).values():
            assert parameter.annotation is not parameter.empty
            assert not isinstance(parameter.annotation, str)
            assert parameter.kind is parameter.POSITIONAL_OR_KEYWORD


# ---- check ----


def test_required_parameters_suffice_and_optional_ones_are_accepted(terms: Registry) -> None:
    terms.check("gap", ["length"])
    terms.check("gap", {"depth": 1.0, "length": 2.0})
    terms.check("return", iter([]))


def test_an_unknown_parameter_is_an_error_with_the_closest_match(terms: Registry) -> None:
    message = r"term 'gap' has no parameter 'lenght' \(allowed: depth, length\)\. Did you mean 'length'\?"
    with pytest.raises(KeyError, match=message):
        terms.check("gap", ["lenght", "length"])


def test_what_the_library_passes_itself_cannot_be_given(terms: Registry) -> None:
    with pytest.raises(KeyError, match=r"term 'return' has no parameter 'view' \(allowed: none\)\."):
        terms.check("return", ["view"])


def test_a_missing_parameter_is_an_error(terms: Registry) -> None:
    with pytest.raises(KeyError, match="term 'gap' needs the parameter 'length'"):
        terms.check("gap", ["depth"])


def test_checking_an_unknown_name_is_an_error(terms: Registry) -> None:
    with pytest.raises(KeyError, match="unknown term 'pag'"):
        terms.check("pag", [])


@pytest.mark.parametrize("kind", ALL.values(), ids=ALL)
def test_the_documentation_tells_of_everything_that_ships(kind: Registry) -> None:
    pages = [(DOCS / name).read_text(encoding="utf-8") for name in ("task-file.md", "evaluate.md")]
    rows = [line for page in pages for line in page.splitlines() if line.startswith("|")]
    ours = [name for name in kind.names() if kind.get(name).__module__.startswith("ogmp_sb3.")]
    assert ours
    for name in ours:
        words = [f"`{word}`" for word in (name, *kind.parameters(name))]
        assert any(all(word in row for word in words) for row in rows), f"no row names {', '.join(words)}"

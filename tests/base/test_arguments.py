"""Errors about arguments: Python's words, a caller's words, and what messages may hold."""

import pickle

import pytest

from cyclofeat._base.arguments import ArgumentError, different_names


def option(name, rest):
    return f"--{name}" + rest.replace("=", " ").rstrip()


def test_a_caller_names_arguments_in_its_own_words():
    error = ArgumentError("{file}: give {sampling_rate:=} (Hz), or {angle:=False}", file="a.csv")
    assert isinstance(error, ValueError)
    assert str(error) == "a.csv: give sampling_rate= (Hz), or angle=False"
    assert error.format_message(option) == "a.csv: give --sampling_rate (Hz), or --angle False"


def test_values_may_hold_braces_and_the_names_of_arguments():
    error = ArgumentError("{file}: {argument: = {value!r}}", file="{scale}.csv", argument="unit", value="{x}")
    assert str(error) == "{scale}.csv: unit = '{x}'"
    assert error.format_message(option) == "{scale}.csv: --unit   '{x}'"


def test_an_error_within_an_error_is_translated_too():
    inner = ArgumentError("{argument} must be positive, got {value}", argument="speed", value=-1)
    outer = ArgumentError("a.csv: {error}", error=inner)
    assert str(outer) == "a.csv: speed must be positive, got -1"
    assert outer.format_message(option) == "a.csv: --speed must be positive, got -1"
    again = pickle.loads(pickle.dumps(outer))
    assert (str(again), again.format_message(option)) == (str(outer), outer.format_message(option))


@pytest.mark.parametrize(("names", "got"), [([], "none"), (["a", "a"], "a, a"), (["x"], "x")])
def test_names_must_be_known_and_different(names, got):
    assert different_names(iter(["b", "a"]), iter(["a", "b"]), "library") == ("b", "a")
    with pytest.raises(ArgumentError, match=f"library must name different effects of a, b, got {got}$"):
        different_names(names, ["a", "b"], "library")

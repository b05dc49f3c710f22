"""Checks of arguments: what they return, and the errors that they raise."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat._base import checks


@pytest.mark.parametrize(
    ("check", "value", "result"),
    [
        (checks.number, np.float32(0.5), 0.5),
        (checks.positive, 2, 2.0),
        (checks.not_negative, 0, 0.0),
        (checks.whole, np.int64(3), 3),
        (checks.number_pair, [1, 2.5], (1.0, 2.5)),
        (checks.truth_value, np.True_, True),
    ],
)
def test_values_come_back_in_plain_types(check, value, result):
    returned = check("x", value)
    assert returned == result
    assert type(returned) is type(result)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: checks.number("x", True), TypeError, "x must be a number, got True"),
        (lambda: checks.number("x", "1", "a number of Hz"), TypeError, "x must be a number of Hz, got '1'"),
        (lambda: checks.number("x", np.nan), ValueError, "x must be finite, got nan"),
        (lambda: checks.number("x", 10**400), ValueError, "x must be finite, got 1000.*"),
        (lambda: checks.positive("x", 0), ValueError, "x must be positive and finite, got 0"),
        (lambda: checks.positive("x", np.inf), ValueError, "x must be positive and finite, got inf"),
        (lambda: checks.not_negative("x", -1), ValueError, "x must be finite and not negative, got -1"),
        (lambda: checks.whole("x", True), TypeError, "x must be a whole number, got True"),
        (lambda: checks.whole("x", 1.0), TypeError, "x must be a whole number, got 1.0"),
        (lambda: checks.whole("x", 0, 1), ValueError, "x must be at least 1, got 0"),
        (lambda: checks.whole("x", 3, 1, 2), ValueError, "x must be at most 2, got 3"),
        (lambda: checks.n_jobs(0), ValueError, "n_jobs must be a whole number of workers, .* got 0"),
        (lambda: checks.number_pair("x", [1, 2, 3]), ValueError, "x must be a pair .* got 3 values"),
        (lambda: checks.truth_value("x", 1), TypeError, "x must be True or False, got 1"),
        (lambda: checks.one_of("x", "c", ("a", "b")), ValueError, "x must be 'a' or 'b', got 'c'"),
        (lambda: checks.one_of("x", ["a"], ("a",)), ValueError, "x must be 'a', got .'a'."),
        (lambda: checks.check_type("x", 1, str), TypeError, "x must be of type str, got 1"),
    ],
)
def test_errors_name_the_argument_and_the_value(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_long_values_are_shortened():
    assert checks.repr_of(list(range(100))) == "[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16..."

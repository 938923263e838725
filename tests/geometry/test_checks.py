from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from spatula_env.geometry.checks import (
    as_floats,
    as_pair,
    as_seed,
    as_tuple_of,
    check_boolean,
    check_count,
    check_finite,
    check_kind,
    check_not_negative,
    check_positive,
)

NO_NUMBERS = ["fast", "1", b"1", None, True, np.True_, [1.0], (1.0,), np.ones(1), {}, 1j, np.inf, np.nan, 10**400]


@pytest.mark.parametrize("check", [check_finite, check_positive, check_not_negative])
@pytest.mark.parametrize("value", NO_NUMBERS, ids=repr)
def test_what_is_no_number_is_named(check: Callable[[Any, str], None], value: Any) -> None:
    with pytest.raises(ValueError, match=r"^speed must be .*finite.*, got "):
        check(value, "speed")


@pytest.mark.parametrize("check", [check_finite, check_positive, check_not_negative])
@pytest.mark.parametrize("value", [1, 0.5, np.float32(2.0), np.int8(3), np.array(4.0)], ids=repr)
def test_numbers_of_all_kinds_are_taken(check: Callable[[Any, str], None], value: Any) -> None:
    check(value, "speed")


@pytest.mark.parametrize("check", [check_positive, check_not_negative])
def test_none_is_taken_where_it_is_told(check: Callable[..., None]) -> None:
    check(None, "speed", or_none=True)
    with pytest.raises(ValueError, match=r"^speed must be .*None.*, got 'a'"):
        check("a", "speed", or_none=True)


@pytest.mark.parametrize("value", ["5", None, True, 5.0, [5], 1, 10], ids=repr)
def test_counts_have_both_bounds(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^size must be an integer of at least 2 and at most 9, got "):
        check_count(value, "size", 2, 9)
    check_count(np.int64(9), "size", 2, 9)


@pytest.mark.parametrize("value", ["yes", "false", "", [], 0, 1, 2, 0.5, None, np.array([True])], ids=repr)
def test_what_is_no_boolean_is_named(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^flag must be True or False, got "):
        check_boolean(value, "flag")


@pytest.mark.parametrize(
    "value", ["12", 1.0, (1.0,), (1.0, 2.0, 3.0), ("1", "2"), (True, 2.0), (0.0, np.inf), {1: 0, 2: 0}], ids=repr
)
def test_what_is_no_pair_is_named(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^range must be two numbers \(least, greatest\), both finite, got "):
        as_pair(value, "range", "(least, greatest)")
    assert as_pair(np.array([1, 2]), "range", "(least, greatest)") == (1.0, 2.0)


@pytest.mark.parametrize("value", [["1"], [True], [1j], np.ones(2, dtype=complex), "a", [[1.0], [1.0, 2.0]]], ids=repr)
def test_arrays_of_other_kinds_are_no_numbers(value: Any) -> None:
    with pytest.raises(ValueError, match="must be real numbers"):
        as_floats(value)


@pytest.mark.parametrize("value", ["x", 1.5, (1,), np.ones(2), -1])
def test_what_is_no_seed_is_named(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^seed must .*, got "):
        as_seed(value)


def test_seeds_become_integers_of_python() -> None:
    assert as_seed(None) is None
    for value in (3, np.int8(3), np.array(3)):
        assert type(as_seed(value)) is int and as_seed(value) == 3


def test_objects_of_another_class_are_named() -> None:
    check_kind(1.0, "length", float)
    check_kind(None, "length", float, or_none=True)
    with pytest.raises(TypeError, match=r"^length must be a float, got None"):
        check_kind(None, "length", float)
    with pytest.raises(TypeError, match=r"^length must be an Exception or None, got 1"):
        check_kind(1, "length", Exception, or_none=True)
    assert as_tuple_of([1.0, 2.0], "lengths", float) == (1.0, 2.0)
    with pytest.raises(TypeError, match=r"^lengths\[1\] must be a float, got 2"):
        as_tuple_of([1.0, 2], "lengths", float)
    for value in (1.0, None, "12", {1.0}):
        with pytest.raises(TypeError, match=r"^lengths must be a sequence of float, got"):
            as_tuple_of(value, "lengths", float)

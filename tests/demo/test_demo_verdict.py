from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.demo.verdict import CRITERIA, GREATEST_RESIDUAL, GREATEST_RIPPLE, judge

GOOD: dict[str, Any] = {
    "residual": 0.0,
    "force_mean": 5.0,
    "force_deviation": 0.01,
    "pairs_steps": 0,
    "inside_share": 0.0,
}


def judged(**changes: Any) -> str:
    return judge(**{**GOOD, **changes})


def test_a_held_contact() -> None:
    assert judged() == "contact"
    assert judged(residual=-0.1) == "contact"
    assert judged(residual=GREATEST_RESIDUAL, force_deviation=5.0 * GREATEST_RIPPLE) == "contact"


@pytest.mark.parametrize(
    "changes",
    [
        {"residual": 0.011},
        {"residual": None},
        {"force_deviation": 0.26},
        {"force_mean": 0.0, "force_deviation": 0.0},
        {"force_mean": -5.0},
        {"pairs_steps": 1},
        {"diverged": True},
        {"diverged": True, "inside_share": 1.0},
    ],
)
def test_what_spoils_a_contact(changes: dict[str, Any]) -> None:
    assert judged(**changes) == "unstable"


def test_inside_is_where_the_centre_was_for_most_of_the_time() -> None:
    assert judged(residual=1.4, force_mean=0.0, inside_share=1.0) == "inside"
    assert judged(residual=None, force_mean=0.0, inside_share=0.51) == "inside"
    assert judged(residual=1.4, force_mean=0.0, inside_share=0.5) == "unstable"


@given(
    residual=st.none() | st.floats(-10.0, 10.0),
    force_mean=st.floats(-100.0, 100.0),
    force_deviation=st.floats(0.0, 100.0),
    pairs_steps=st.integers(0, 1000),
    inside_share=st.floats(0.0, 1.0),
    scale=st.floats(0.1, 10.0),
)
def test_the_unit_of_force_does_not_matter(
    residual: float | None,
    force_mean: float,
    force_deviation: float,
    pairs_steps: int,
    inside_share: float,
    scale: float,
) -> None:
    rest: dict[str, Any] = {"residual": residual, "pairs_steps": pairs_steps, "inside_share": inside_share}
    verdict = judge(force_mean=force_mean, force_deviation=force_deviation, **rest)
    assert verdict in CRITERIA
    # Rounding may move a ratio across the limit only if it is at the limit.
    if abs(force_deviation - GREATEST_RIPPLE * force_mean) > 1e-9:
        assert judge(force_mean=scale * force_mean, force_deviation=scale * force_deviation, **rest) == verdict

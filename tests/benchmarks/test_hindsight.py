"""Successes by hindsight relabelling agree with those of the environment."""

from __future__ import annotations

import pytest

from benchmarks import hindsight
from spatula_env import TASKS

OFFERED = ["Press", "Retract", "Clamp"]


def test_hindsight_is_offered_where_what_is_achieved_depends_on_no_goal() -> None:
    assert sorted(hindsight.tasks_with_hindsight()) == sorted(OFFERED)
    assert set(OFFERED) < set(TASKS)


@pytest.mark.parametrize("task", OFFERED)
def test_no_relabelled_success_is_denied(task: str) -> None:
    found = hindsight.measure(task, "batch", 4, seed=1)
    assert found["claimed"] > 0
    assert (found["denied"], found["missed"]) == (0, 0)

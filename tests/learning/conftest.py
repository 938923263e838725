from __future__ import annotations

import pytest


@pytest.fixture
def short_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluations of ten steps, unless they say how long they are."""
    from spatula_env.learning.evaluation import Plan

    make = Plan.make

    def make_short(self, count, **more):
        return make(self, count, **{"max_episode_steps": self.kwargs.get("max_episode_steps", 10), **more})

    monkeypatch.setattr(Plan, "make", make_short)

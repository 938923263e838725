"""The benchmark of the bounds of observations."""

from __future__ import annotations

import copy
import json
from typing import Any

import numpy as np
import pytest

from benchmarks import observations


def test_drivers_by_chance_keep_to_their_kind() -> None:
    generator = np.random.default_rng(0)
    kept = observations.chance("kept", (200, 3), generator)
    violent = observations.chance("violent", (200, 3), generator)
    assert kept.dtype == violent.dtype == np.float32
    assert np.abs(kept).max() < 1.0
    assert set(np.unique(violent)) == {-1.0, 0.0, 1.0}


def test_errors_of_measurement_are_not_among_what_is_drawn() -> None:
    ranges = observations.ranges_without_noise("Spatula/Press-v0")
    assert "stiffness" in ranges
    assert "sensor_noise" not in ranges


def test_what_is_at_a_bound_is_counted() -> None:
    """A contact depth of zero is no clipped one; a velocity at its bound is."""
    seen, builder = observations.drive("Press", "violent", worlds=4, steps=6, seed=0)
    assert seen.steps == 24
    assert 0 < seen.any_clipped["tool_velocity"] <= 24
    assert seen.any_clipped["contact_depth"] == seen.any_clipped["contact_share"] == 0
    assert (seen.low <= seen.high).all()
    velocity = builder.slices["tool_velocity"]
    assert seen.clipped[velocity].sum() >= seen.any_clipped["tool_velocity"]


def test_what_passes() -> None:
    part = {"used": 0.3, "clipped": {"expert": 0.0, "hasty": 0.0, "kept": 0.0, "violent": 0.004}}
    good: dict[str, Any] = {"Press": {"parts": {"contact_force": part, "landmarks": part}, "constant": []}}
    good["Press"]["parts"]["landmarks"] = {**part, "clipped": {**part["clipped"], "violent": 0.5}}
    assert observations.passed(good)
    for change in (
        {"used": 0.04},
        {"clipped": {**part["clipped"], "hasty": 0.001}},
        {"clipped": {**part["clipped"], "kept": 0.006}},
    ):
        bad = copy.deepcopy(good)
        bad["Press"]["parts"]["contact_force"] = {**part, **change}
        assert not observations.passed(bad), change
    assert not observations.passed({"Press": {**good["Press"], "constant": ["contact_share[1]"]}})


def test_the_command_prints_a_table_and_its_result(capsys: pytest.CaptureFixture[str]) -> None:
    observations.main(["--tasks", "Press", "--episodes", "2", "--steps", "3"])
    *table, last = capsys.readouterr().out.splitlines()
    result = json.loads(last)
    assert result["benchmark"] == "observations"
    assert set(result["tasks"]["Press"]["parts"]) == {
        "contact_force", "contact_torque", "contact_depth", "contact_pressure", "landmarks",
    }  # fmt: skip
    # In three steps nothing is touched.
    assert not result["passed"]
    assert any(line.startswith("Press    constant: ") for line in table)
    with pytest.raises(SystemExit):
        observations.main(["--steps", "0"])

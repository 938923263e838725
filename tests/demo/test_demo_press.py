from __future__ import annotations

import numpy as np
import pytest

from spatula_env import scenes
from spatula_env.demo.press import FINAL_HEIGHT, WINDOW, PressCase, PressResult, film_press, run_press
from spatula_env.engines import is_installed


@pytest.fixture(scope="module")
def result() -> PressResult:
    return run_press(PressCase("flags", 60.0, hold_time=1.0))


def test_the_tool_ends_where_it_is_to_be_held(result: PressResult) -> None:
    np.testing.assert_allclose(result.snapshot.tool_position, [0.0, 0.0, FINAL_HEIGHT], atol=1e-9)
    # 60 u/s is 0.25 u in a step: six steps for about 1.4 u, the last one shorter.
    assert result.steps == 6 + 240
    assert result.case.expected_steps == pytest.approx(result.steps, abs=1)


def test_the_flags_method_holds_the_organ_under_the_spatula(result: PressResult) -> None:
    assert result.verdict == "contact"
    assert result.covered_share == 1.0
    assert result.residual_mean is not None and result.residual_max is not None
    assert result.residual_mean <= result.residual_max <= 0.01
    assert result.lower_nodes > 10 and result.upper_nodes == 0
    assert result.pairs_steps == 0 and result.inside_share == 0.0
    # The organ weighs 0.03 N; pressing it 1.4 u down takes much more.
    assert result.force_mean > 0.3
    assert result.force_peak_of_run >= result.force_peak >= result.force_mean


@pytest.mark.parametrize("engine", ["batch", "tissue", "mujoco"])
@pytest.mark.filterwarnings("ignore:organ 'sphere' has not come to rest:spatula_env.sim.SceneWarning")
def test_the_flags_method_does_so_in_every_engine(engine: str) -> None:
    if not is_installed(engine):
        pytest.skip(f"the extra {engine} is not installed")
    result = run_press(PressCase("flags", 60.0, WINDOW / 240.0, engine))
    assert result.verdict in ("contact", "unstable")
    assert result.residual_max is not None and result.residual_max <= 0.01
    assert result.pairs_steps == 0 and result.inside_share == 0.0


def test_forces_in_both_units(result: PressResult) -> None:
    record = result.as_record()
    scale = scenes.seed().scale.force
    assert record["contact"] == "flags" and record["speed"] == 60.0
    assert set(record["force_newtons"]) == {"mean", "deviation", "peak", "peak_of_run"}
    for name, newtons in record["force_newtons"].items():
        assert record["force_scene_units"][name] * scale == pytest.approx(newtons)


@pytest.mark.bullet
def test_bullet_alone_lets_the_spatula_in() -> None:
    result = run_press(PressCase("bullet", 400.0, hold_time=WINDOW / 240.0))
    assert result.verdict == "inside"
    assert result.residual_max is not None and result.residual_max > 1.0
    assert abs(result.force_mean) < 0.1


def test_without_the_first_step_both_faces_push() -> None:
    result = run_press(PressCase("second_step", 60.0, hold_time=WINDOW / 240.0))
    assert result.verdict == "unstable"
    assert result.pairs_steps > 10


def test_a_film_presses_and_lets_go() -> None:
    film = film_press(hold_time=0.1, rest_time=0.2, stride=12)
    heights = [snapshot.tool_position[2] for snapshot in film.snapshots]
    assert len(film.snapshots) == -(-len(film.forces) // 12)
    assert min(heights) == pytest.approx(FINAL_HEIGHT, abs=1e-6)
    assert heights[-1] == pytest.approx(heights[0], abs=0.1)
    assert film.forces.max() > 0.5
    assert film.forces[-10:].max() < 0.02
    assert np.all(np.diff([snapshot.time for snapshot in film.snapshots]) > 0.0)

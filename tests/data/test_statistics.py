from __future__ import annotations

import json
import re
import sys

import numpy as np
import pytest
from demonstration_helpers import FORCES, ID, LAYOUT, LENGTHS, write_dataset
from hypothesis import given
from hypothesis import strategies as st
from recording_helpers import do_episode, make_pictures
from scipy.stats import binomtest

from spatula_env.data import DatasetWriter
from spatula_env.data.layout import Layout
from spatula_env.data.plots import plot_statistics
from spatula_env.data.statistics import CELLS, Curve, coverage, statistics, wilson_interval
from spatula_env.installing import install_hint

pytest.importorskip("minari")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("datasets")
    write_dataset(folder)
    return folder


@pytest.fixture(scope="module")
def found(root):
    return statistics(ID, root)


def test_episode_by_episode(found) -> None:
    assert found.returns.tolist() == [4.0, 12.0, 9.0]
    assert found.lengths.tolist() == list(LENGTHS)
    np.testing.assert_allclose(found.durations, np.array(LENGTHS) / 20.0)
    assert found.successes.tolist() == [True, False, True]
    assert found.operators == ("scripted", "human", "scripted")
    assert found.peak_forces.tolist() == list(FORCES)
    assert found.doses.tolist() == [40.0, 60.0, 30.0]
    assert found.violations.tolist() == [False, False, True]


def test_forces_over_time(found) -> None:
    np.testing.assert_allclose(found.force.times, 0.05 * np.arange(7))
    assert found.force.episodes.tolist() == [3, 3, 3, 3, 2, 1, 1]
    assert found.force.median.tolist() == [0.0, 0.0, 2.0, 2.0, 1.5, 2.0, 2.0]
    assert found.force.greatest.tolist() == [0.0, 0.0, 4.0, 4.0, 2.0, 2.0, 2.0]
    np.testing.assert_allclose(found.pressure.median, 1000.0 * found.force.median)


def test_where_the_tool_was(found) -> None:
    assert found.positions.shape == (sum(LENGTHS) + 3, 3)
    # Three heights, and along x as far as each episode lasts.
    assert found.coverage == pytest.approx((5 + 7 + 4) / CELLS**3)
    np.testing.assert_array_equal(found.workspace, [LAYOUT.workspace_low, LAYOUT.workspace_high])


def test_the_record_is_json(found) -> None:
    record = json.loads(json.dumps(found.as_record(), allow_nan=False))
    assert record["success_rate"] == pytest.approx(2 / 3)
    assert record["operators"] == {"scripted": 2, "human": 1}
    assert record["return"] == {"mean": pytest.approx(25 / 3), "least": 4.0, "median": 9.0, "greatest": 12.0}
    assert record["violation_rate"] == pytest.approx(1 / 3)


def test_what_was_not_recorded_is_not_made_up(tmp_path) -> None:
    env = make_pictures()
    writer = DatasetWriter("spatula/test/bare-v0", env, root=tmp_path)
    writer.add(do_episode(env, 0))
    env.close()
    bare = statistics("spatula/test/bare-v0", tmp_path)
    assert (bare.force, bare.positions, bare.durations, bare.doses, bare.coverage) == (None,) * 5
    plot_statistics(bare, tmp_path / "bare.png")
    assert (tmp_path / "bare.png").stat().st_size > 10_000


def test_an_empty_dataset(tmp_path) -> None:
    write_dataset(tmp_path, episodes=0)
    empty = statistics(ID, tmp_path)
    assert empty.as_record()["success_rate"] is None
    with pytest.raises(ValueError, match="no episodes"):
        plot_statistics(empty, tmp_path / "empty.png")


@pytest.mark.parametrize(("successes", "count"), [(0, 10), (10, 10), (8, 10), (1, 3), (97, 100), (500, 1000)])
def test_the_interval_is_wilsons(successes, count):
    expected = binomtest(successes, count).proportion_ci(0.95, method="wilson")
    np.testing.assert_allclose(wilson_interval(successes, count), expected, atol=1e-9)


@pytest.mark.parametrize(("successes", "count"), [(1, 0), (-1, 3), (4, 3)])
def test_impossible_counts_are_refused(successes, count):
    with pytest.raises(ValueError, match="successes must be"):
        wilson_interval(successes, count)


@given(st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 3), min_size=1, max_size=30))
def test_coverage_counts_cells(points) -> None:
    box = np.array([[-1.0] * 3, [1.0] * 3])
    share = coverage(np.array(points), box)
    assert 1 / CELLS**3 <= share <= len(points) / CELLS**3
    assert coverage(np.array(points + points), box) == share


@given(st.lists(st.lists(st.floats(0.0, 100.0), min_size=1, max_size=8), min_size=1, max_size=6))
def test_a_curve_lies_between_its_episodes(values) -> None:
    curve = Curve.of([np.arange(len(each)) * 0.05 for each in values], [np.array(each) for each in values])
    assert len(curve.times) == max(map(len, values))
    assert (curve.low <= curve.median + 1e-9).all()
    assert (curve.median <= curve.high + 1e-9).all()
    assert (curve.high <= curve.greatest + 1e-9).all()
    assert curve.episodes[0] == len(values)


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_it_is_drawn(found, tmp_path, ending) -> None:
    file = tmp_path / "new" / f"statistics.{ending}"
    plot_statistics(found, file)
    assert file.stat().st_size > 10_000
    if ending == "svg":
        text = file.read_text()
        assert "<svg" in text


def test_the_picture_shows_both_kinds_of_episodes(found, tmp_path) -> None:
    from PIL import Image

    plot_statistics(found, tmp_path / "a.png")
    pixels = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).reshape(-1, 3)
    for color in ((0x2F, 0x7F, 0x86), (0xD0, 0x78, 0x2F)):
        assert (pixels == color).all(axis=1).sum() > 500


def test_a_picture_of_an_unknown_kind(found, tmp_path) -> None:
    with pytest.raises(ValueError, match=r"\.png, \.svg or \.pdf"):
        plot_statistics(found, tmp_path / "picture.bmp")


def test_matplotlib_is_named_if_it_is_missing(found, tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=re.escape(install_hint("viz"))):
        plot_statistics(found, tmp_path / "picture.png")


def test_positions_need_names(tmp_path) -> None:
    write_dataset(tmp_path, layout=Layout())
    assert statistics(ID, tmp_path).positions is None

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks import detector as benchmark
from benchmarks.rivals import BruteForce, BruteForceByLanes, BruteForceByLines
from spatula_env.geometry import Tool, box_surface, seed_sphere

EACH = pytest.mark.parametrize("kind", [BruteForce, BruteForceByLines, BruteForceByLanes])


def sphere_question(nodes_per_edge=4, depth=benchmark.SPHERE_DEPTH):
    organ = seed_sphere(node_count=120)
    position = np.array([0.031, 0.017, 3.0 - depth + 0.0625])
    return benchmark.make_question(Tool.box(nodes_per_edge=nodes_per_edge), position, organ.vertices, organ.triangles)


class Deaf(BruteForce):
    """A rival that always answers for the first shape."""

    name = "deaf"

    def query(self, index):
        super().query(0)


class Vague(BruteForce):
    """A rival that reports distances only."""

    name = "vague"

    def answer(self):
        return None, super().answer()[1]


class Wrong(BruteForce):
    """A rival that reports the right distances, but the wrong triangles."""

    name = "wrong"

    def answer(self):
        hits, distances = super().answer()
        return np.where(hits >= 0, (hits + 1) % 236, hits), distances


class Absent(BruteForce):
    name = "absent"

    def __init__(self, question):
        raise ImportError("No module named 'absent'")


@EACH
def test_brute_force_finds_the_walls_of_a_box(kind):
    """A tool inside a box of 4 u, near its lower wall: every distance is known."""
    box = box_surface((4.0, 4.0, 4.0), 0.9)
    question = benchmark.make_question(Tool.box(), np.array([0.1, 0.05, -1.6]), box.vertices, box.triangles)
    question.shapes[1][:] = box.vertices
    rival = kind(question)
    rival.query(1)
    hits, distances = rival.answer()
    target = np.where(question.directions[:, 2] > 0.0, 2.0, -2.0)
    expected = (target - question.origins[:, 2]) / question.directions[:, 2]
    np.testing.assert_allclose(distances, expected, rtol=3e-6)
    assert (hits >= 0).all()
    places = box.vertices[box.triangles[hits], 2]
    np.testing.assert_allclose(places, np.repeat(target[:, None], 3, axis=1))


@EACH
def test_brute_force_says_where_there_is_nothing(kind):
    question = sphere_question(depth=-1.0)
    rival = kind(question)
    rival.query(0)
    hits, distances = rival.answer()
    up = question.directions[:, 2] > 0.0
    assert (hits[up] == -1).all() and np.isinf(distances[up]).all()
    assert (hits[~up] >= 0).all() and np.isfinite(distances[~up]).all()


def test_the_press_sets_flags_on_most_of_the_lower_face():
    (question,) = benchmark.pressed_sphere()
    side = benchmark.DetectorSide(question)
    side.query(0)
    lower = question.normals[:, 2] < 0.0
    assert len(question.nodes) == 72 and len(question.triangles) == 652
    assert side.contacts.flags[lower].mean() > 0.6
    assert not side.contacts.flags[~lower].any()


def test_flags_follow_from_rays():
    question = sphere_question(nodes_per_edge=8, depth=0.3)
    rival, side = BruteForce(question), benchmark.DetectorSide(question)
    for index in (0, benchmark.TIMED_SHAPES):
        rival.query(index)
        side.query(index)
        flags = benchmark.flags_from_rays(question, index, rival.answer()[0])
        # So deep that both nodes of most pairs are inside; the lower face leads and owns the contact.
        np.testing.assert_array_equal(flags, question.normals[:, 2] < 0.0)
        np.testing.assert_array_equal(flags, side.contacts.flags)


def test_only_those_who_answer_the_same_are_compared():
    kinds = (BruteForce, BruteForceByLanes, Deaf, Vague, Wrong, Absent)
    result = benchmark.compare(sphere_question(), 1, kinds)
    rows = result["rivals"]
    assert {name for name, row in rows.items() if row["comparable"]} == {"brute_force", "brute_force_by_lanes"}
    assert rows["deaf"]["us"] > 0.0 and rows["deaf"]["rays_agree"] < 0.5
    assert rows["vague"]["rays_agree"] == 1.0 and rows["vague"]["nodes_agree"] is None
    assert rows["wrong"]["nodes_agree"] < 0.9
    assert rows["absent"]["us"] is None and "No module named 'absent'" in rows["absent"]["reason"]
    assert result["best_rival"] in ("brute_force", "brute_force_by_lanes")
    assert result["best_library"] is None
    assert result["ratio_to_brute_force"] == rows["brute_force"]["us"] / result["detect_us"]
    json.dumps(result)


def test_all_sides_are_asked_about_the_same_shapes_and_about_another_every_time():
    asked = {"first": [], "second": []}
    medians = benchmark.interleaved({name: calls.append for name, calls in asked.items()}, 2 * benchmark.BLOCK)
    assert asked["first"] == asked["second"] and medians.keys() == asked.keys()
    assert len(asked["first"]) == 2 * (benchmark.BLOCK + benchmark.WARM_UP)
    assert set(asked["first"]) == set(range(benchmark.TIMED_SHAPES))
    assert (np.diff(asked["first"][: benchmark.BLOCK]) != 0).all()


def test_sides_of_the_scaling_take_turns_across_sizes():
    turns = []
    queries = {(name, size): lambda index, key=(name, size): turns.append(key) for name in "ab" for size in (0, 1)}
    benchmark.interleaved(queries, 2, block=1)
    each = 1 + benchmark.WARM_UP
    assert turns[::each] == 2 * list(queries) and len(turns) == 8 * each


def test_exponent_of_a_power():
    sizes = [10.0, 100.0, 1000.0]
    assert benchmark.exponent(sizes, [3.0 * size**0.7 for size in sizes]) == pytest.approx(0.7)


def test_scaling_has_a_time_for_every_size_and_a_picture(tmp_path):
    questions = [sphere_question(nodes_per_edge=count) for count in (2, 4)]
    curve = benchmark.scaling(questions, "nodes", 1, (BruteForce, Absent))
    assert curve["sizes"] == [8, 32] and len(curve["flags"]) == 2
    assert curve["us"].keys() == curve["exponent"].keys() == {"detector", "brute_force"}
    assert all(len(times) == 2 for times in curve["us"].values())
    pytest.importorskip("matplotlib")
    file = tmp_path / "curves.png"
    benchmark.draw({"triangles": curve, "nodes": curve}, file)
    assert file.read_bytes().startswith(b"\x89PNG")


def test_labels_are_spread_and_keep_their_order():
    moved = benchmark.spread(np.array([1.0, 0.0, 1.05, 5.0]), 0.5)
    assert np.diff(np.sort(moved)).min() >= 0.5 - 1e-12
    assert list(np.argsort(moved)) == [1, 0, 2, 3]
    assert moved[1] == 0.0 and moved[3] == 5.0


def test_last_line_is_json(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["detector", "--json", "--no-scaling", "--repeats", "20"])
    monkeypatch.setattr(benchmark, "pressed_sphere", lambda: [sphere_question()])
    benchmark.main()
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["benchmark"] == "detector" and result["detect_us"] > 0.0
    assert result["rivals"]["brute_force"]["comparable"]
    assert not result["rivals"]["pybullet"]["comparable"]

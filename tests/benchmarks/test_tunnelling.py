"""The tools that measure tunnelling: are faults detected and counted?"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import parallel, pictures, plunges, tunnelling
from benchmarks.depths import find_inside, measure_depths, see
from benchmarks.inspection import APART, Inspector
from benchmarks.probes import RIM, arrange_points
from spatula_env import Simulation, scenes
from spatula_env.geometry import Tool, box_surface, icosphere, seed_sphere, torus
from spatula_env.geometry.surface import triangle_normals, winding_numbers
from spatula_env.geometry.transforms import quaternion_from_two_vectors, random_quaternion, rotate

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
FAST = 38
"""A case of the default seed that takes only 20 steps, and in which Bullet's own contact fails."""


def locate(points, organ):
    places, vertices, triangles = np.array(points, dtype=float), np.array(organ.vertices), np.array(organ.triangles)
    inside, depths, seen = np.zeros(len(places), dtype=bool), np.full(len(places), np.nan), np.empty_like(vertices)
    see(vertices, seen)
    assert find_inside(arrange_points(places), vertices, seen, triangles, inside) == inside.any()
    measure_depths(places, vertices, triangles, np.zeros(0, dtype=np.int64), inside, depths)
    return inside, depths


# Depths ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("depth", [1e-6, 0.004, 0.03])
def test_a_box_pressed_into_a_facet_is_as_deep_as_it_was_put(depth):
    # A plate much smaller than the facet, parallel to it: all its lower nodes and corners are equally deep.
    organ = icosphere(3.0, 1)
    tool = Tool.box((0.1, 0.08, 0.05), faces="all")
    normal = triangle_normals(organ.vertices, organ.triangles)[7]
    middle = organ.vertices[organ.triangles[7]].mean(axis=0)
    orientation = quaternion_from_two_vectors((0.0, 0.0, 1.0), normal)
    seen = Inspector(tool, organ.triangles).inspect(middle + (0.025 - depth) * normal, orientation, organ.vertices)
    assert seen.node_depth == pytest.approx(depth, abs=1e-9)
    assert seen.corner_depth == pytest.approx(depth, abs=1e-9)
    # The facet goes right through the plate; the face that is nearer counts.
    assert seen.surface_depth == pytest.approx(min(depth, 0.05 - depth), abs=1e-9)
    assert seen.residual == pytest.approx(depth, abs=1e-9)
    assert seen.centre_inside == (depth > 0.025)
    above = Inspector(tool, organ.triangles).inspect(middle + (0.025 + depth) * normal, orientation, organ.vertices)
    assert above == APART


@given(st.integers(0, 2**32))
@settings(max_examples=40)
def test_depths_in_a_convex_organ_are_those_of_its_planes(number):
    generator = np.random.default_rng(number)
    organ = icosphere(3.0, 2)
    normals = triangle_normals(organ.vertices, organ.triangles)
    offsets = (normals * organ.vertices[organ.triangles[:, 0]]).sum(axis=1)
    tool = Tool.box((1.0, 0.7, generator.uniform(0.02, 0.5)), faces="all")
    position, orientation = generator.uniform(-3.0, 3.0, 3), random_quaternion(generator)
    seen = Inspector(tool, organ.triangles).inspect(position, orientation, organ.vertices)

    def greatest(points):
        return max((offsets - (rotate(orientation, points) + position) @ normals.T).min(axis=1).max(), 0.0)

    assert seen.node_depth == pytest.approx(greatest(tool.nodes), abs=1e-9)
    assert seen.corner_depth == pytest.approx(greatest(tool.vertices), abs=1e-9)
    assert seen.centre_inside == bool((offsets - normals @ position).min() > 0.0)


@given(st.integers(0, 2**32))
@settings(max_examples=15)
def test_points_are_inside_where_the_winding_number_says_so(number):
    # A torus and a crumpled sphere, whose surface crosses itself.
    generator = np.random.default_rng(number)
    sphere = seed_sphere()
    crumpled = replace(sphere, vertices=sphere.vertices + generator.normal(scale=0.05, size=sphere.vertices.shape))
    for organ in (torus(2.0, 0.7), crumpled):
        points = generator.uniform(-3.0, 3.0, (40, 3))
        inside, depths = locate(points, organ)
        np.testing.assert_array_equal(inside, winding_numbers(points, organ.vertices, organ.triangles) > 0.5)
        assert (depths[inside] > 0.0).all()
        assert (depths[~inside] == 0.0).all()


def test_a_line_through_edges_and_vertices_is_not_lost():
    # All points see a vertex or an edge of the box in the direction of the lines.
    organ = box_surface((2.0, 2.0, 2.0))
    corner = np.array([1.0, 1.0, 1.0])
    direction = np.array([2.0, 3.0, 6.0]) / 7.0
    inside, depths = locate([corner - 0.5 * direction, corner + 0.5 * direction, (0.0, 0.0, 0.0)], organ)
    np.testing.assert_array_equal(inside, [True, False, True])
    assert depths[0] == pytest.approx(1.0 / 7.0, abs=1e-9)
    assert depths[2] == pytest.approx(1.0, abs=1e-9)


def test_the_depth_beyond_a_sharp_edge_is_the_distance_from_the_edge():
    # In the hole of a torus the nearest point is on the inner rim; outside there is no depth.
    organ = torus(2.0, 0.7)
    inside, depths = locate([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)], organ)
    np.testing.assert_array_equal(inside, [False, True])
    nearest = np.linalg.norm(organ.vertices - [2.0, 0.0, 0.0], axis=1).min()
    assert 0.5 < depths[1] <= nearest


def test_a_corner_of_the_organ_in_the_tool_is_measured_too():
    # The organ's corner comes up through the middle of the plate's lower face, between contact nodes.
    organ = box_surface((1.0, 1.0, 1.0))
    turned = rotate(quaternion_from_two_vectors((1.0, 1.0, 1.0), (0.0, 0.0, 1.0)), organ.vertices)
    tool = Tool.box((1.0, 1.0, 0.04))
    top = turned[:, 2].max()
    inspector = Inspector(tool, organ.triangles)
    seen = inspector.inspect((0.0, 0.0, top + 0.02 - 0.01), UPRIGHT, turned)
    assert seen.surface_depth == pytest.approx(0.01, abs=1e-9)
    assert seen.node_depth == 0.0
    assert seen.residual == seen.surface_depth
    # Where the other face is nearer to it, what is below it is deeper: in the middle between both.
    seen = inspector.inspect((0.0, 0.0, top - 0.02 + 0.005), UPRIGHT, turned)
    assert seen.surface_depth == pytest.approx(0.02, abs=1e-9)


# Sides -------------------------------------------------------------------------------------------------------------


def test_a_swallowed_tool_is_enclosed():
    organ, tool = icosphere(3.0, 2), Tool.box((1.0, 1.0, 0.1))
    seen = Inspector(tool, organ.triangles).inspect((0.5, 0.0, 1.0), UPRIGHT, organ.vertices)
    assert seen.centre_inside
    # The columns of a lattice of 6 x 6 nodes that are not on the rim.
    assert seen.enclosed == 16
    assert seen.wrong_side


def test_a_tool_whose_one_end_is_swallowed_is_enclosed_there():
    organ, tool = box_surface((2.0, 2.0, 2.0)), Tool.box((1.0, 1.0, 0.1))
    # The plate lies across the side x = 1: of its inner columns, at -0.3, -0.1, 0.1 and 0.3 along x, one row is inside.
    seen = Inspector(tool, organ.triangles).inspect((1.2, 0.0, 0.0), UPRIGHT, organ.vertices)
    assert not seen.centre_inside
    assert seen.enclosed == 4
    # Half sunken into the top it is deep, but the organ is on one side of it.
    seen = Inspector(tool, organ.triangles).inspect((0.0, 0.0, 1.01), UPRIGHT, organ.vertices)
    assert seen.node_depth == pytest.approx(0.04)
    assert not seen.wrong_side


def test_a_blade_that_two_walls_squeeze_is_deep_but_on_no_wrong_side():
    block, tool = box_surface((2.0, 2.0, 2.0)), Tool.box((1.0, 1.0, 0.1))
    walls = np.concatenate([block.vertices + np.array([0.0, 0.0, side]) for side in (1.049, -1.049)])
    triangles = np.concatenate([block.triangles, block.triangles + len(block.vertices)])
    seen = Inspector(tool, triangles).inspect((0.0, 0.0, 0.0), UPRIGHT, walls)
    assert seen.residual == pytest.approx(0.001)
    assert not seen.wrong_side


def pebble(radius=0.2):
    """A ball without vertices whose normals are horizontal."""
    ball = icosphere(radius, 1)
    return replace(ball, vertices=rotate(random_quaternion(np.random.default_rng(0)), ball.vertices))


def visit(tool, *heights, offset=(0.0, 0.0), organ=None, inverted=False):
    """Inspections of a pebble at several heights over a tool at the origin."""
    organ = pebble() if organ is None else organ
    triangles = organ.triangles[:, ::-1] if inverted else organ.triangles
    inspector = Inspector(tool, triangles)
    return [
        inspector.inspect((0.0, 0.0, 0.0), UPRIGHT, organ.vertices + np.array([*offset, height])) for height in heights
    ]


def test_an_organ_that_goes_through_in_one_step_is_seen():
    count = len(pebble().vertices)
    before, after = visit(Tool.box((1.0, 1.0, 0.1)), 0.5, -0.5)
    assert before == APART
    # Neither state alone shows a fault, but the path does. The lower half of the pebble has its outside ahead.
    assert after.residual == 0.0
    assert after.enclosed == 0
    assert after.passages + after.turned == count
    assert 0 < after.passages < count
    assert after.wrong_side


def test_an_organ_that_goes_through_in_small_steps_is_seen():
    thick = Tool.box((1.0, 1.0, 0.2))
    seen = visit(thick, *np.linspace(0.5, -0.5, 41))
    assert sum(each.passages + each.turned for each in seen) == len(pebble().vertices)


def test_an_organ_that_comes_from_afar_and_goes_far_is_seen():
    _, after = visit(Tool.box((1.0, 1.0, 0.1)), 50.0, -50.0)
    assert after.passages > 0
    assert after.residual == 0.0


def test_what_turns_back_does_not_go_through():
    seen = visit(Tool.box((1.0, 1.0, 0.2)), 0.5, 0.2, 0.15, 0.2, 0.5)
    assert max(each.surface_depth for each in seen) > 0.01
    assert not any(each.passages or each.turned for each in seen)


def test_what_comes_back_the_way_it_went_counts_once():
    once, back, again = visit(Tool.box((1.0, 1.0, 0.1)), 0.5, -0.5, 0.5, -0.5)[1:]
    assert once.passages > 0
    assert back.passages == back.turned == 0
    assert again.passages == once.passages


def test_inside_ahead_is_no_passage():
    _, after = visit(Tool.box((1.0, 1.0, 0.1)), 0.5, -0.5)
    _, inverted = visit(Tool.box((1.0, 1.0, 0.1)), 0.5, -0.5, inverted=True)
    assert (inverted.passages, inverted.turned) == (after.turned, after.passages)


def test_slipping_by_and_round_the_rim_is_no_passage():
    tool, small = Tool.box((1.0, 1.0, 0.1)), pebble(0.3 * RIM)
    for x in (0.5 + RIM, 0.5 - 0.5 * RIM):
        assert not any(each.wrong_side for each in visit(tool, 0.5, -0.5, offset=(x, 0.0), organ=small))
    assert visit(tool, 0.5, -0.5, offset=(0.5 - 1.5 * RIM, 0.0), organ=small)[1].wrong_side


def test_passages_are_seen_when_the_tool_moves_and_forgotten_on_reset():
    organ, tool = pebble(), Tool.box((1.0, 1.0, 0.1))
    generator = np.random.default_rng(3)
    orientation = random_quaternion(generator)
    up = rotate(orientation, (0.0, 0.0, 1.0))
    inspector = Inspector(tool, organ.triangles)
    inspector.inspect(up, orientation, organ.vertices)
    assert inspector.inspect(-up, orientation, organ.vertices).passages > 0
    inspector.inspect(up, orientation, organ.vertices)
    inspector.reset()
    assert inspector.inspect(-up, orientation, organ.vertices) == APART


# Cases -------------------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**31), st.integers(0, 10**6))
def test_a_case_is_made_from_its_number_alone(seed, number):
    plunge = plunges.draw(seed, number)
    assert plunges.draw(seed, number) == plunge
    assert plunges.draw(seed, number + 1) != plunge
    assert plunges.draw(seed + 1, number) != plunge
    for value, (low, high) in (
        (plunge.speed, plunges.SPEEDS),
        (plunge.thickness, plunges.THICKNESSES),
        (plunge.dt, plunges.STEPS),
        (plunge.depth, plunges.DEPTHS),
    ):
        assert low * (1.0 - 1e-12) <= value <= high * (1.0 + 1e-12)
    assert np.linalg.norm(plunge.direction) == pytest.approx(1.0)
    # The chosen face or edge goes first, up to the tilt.
    entry = np.array(plunge.entry) / np.linalg.norm(plunge.entry)
    ahead = rotate(np.array(plunge.orientation), entry)
    assert -ahead @ plunge.direction >= math.cos(plunges.TILT) - 1e-9
    assert (plunge.moving_steps - 1) * plunge.speed * plunge.dt < plunge.depth + plunges.GAP


def test_every_face_and_edge_and_all_directions_are_drawn():
    drawn = [plunges.draw(5, number) for number in range(600)]
    assert len({plunge.entry for plunge in drawn}) == len(plunges.ENTRIES) == 18
    directions = np.array([plunge.direction for plunge in drawn])
    assert np.abs(directions.mean(axis=0)).max() < 0.1
    np.testing.assert_allclose(directions.T @ directions / len(drawn), np.eye(3) / 3.0, atol=0.06)


@pytest.mark.filterwarnings("ignore:organ 'sphere' has not come to rest")
def test_a_run_is_reproducible_and_watched_in_every_step():
    plunge = plunges.draw(tunnelling.SEED, FAST)
    steps = []

    def watch(step, simulation, report, seen):
        steps.append((step, simulation.tool_position, seen))

    outcome = plunges.run(plunge, watch=watch)
    assert plunges.run(plunge) == outcome
    assert outcome.steps == len(steps) == plunge.moving_steps + plunge.held_steps
    assert outcome.residual == max(seen.residual for _, _, seen in steps)
    assert outcome.final_residual == steps[-1][2].residual
    assert outcome.enclosed == sum(seen.centre_inside or seen.enclosed > 0 for _, _, seen in steps)
    # Its foremost point ends at the planned depth under the undeformed surface, on the line through the middle.
    simulation = Simulation(scenes.seed(dt=plunge.dt), precision="double")
    about_middle = simulation.nodes - simulation.nodes.mean(axis=0)
    position = steps[-1][1] - simulation.nodes.mean(axis=0)
    simulation.close()
    direction = np.array(plunge.direction)
    tool = Tool.box((1.0, 1.0, plunge.thickness), faces="all")
    foremost = (rotate(np.array(plunge.orientation), tool.vertices) @ direction).min()
    assert position @ direction + foremost == pytest.approx((about_middle @ direction).max() - plunge.depth, abs=1e-9)
    np.testing.assert_allclose(position, (position @ direction) * direction, atol=1e-9)
    np.testing.assert_array_equal(steps[plunge.moving_steps - 1][1], steps[-1][1])


@pytest.mark.bullet
def test_bullets_own_contact_fails_a_plunge():
    outcome = plunges.run(plunges.draw(tunnelling.SEED, FAST), "bullet")
    assert outcome.failed
    assert outcome.wrong_side
    assert outcome.enclosed > 10
    assert outcome.residual > 1.0
    assert not outcome.non_finite


# Counting ----------------------------------------------------------------------------------------------------------


def test_a_tally_counts():
    tally = plunges.Tally(np.array([1, 0, 3, 2], dtype=np.int32))

    def add(flags, **seen):
        tally.add(np.array(flags, dtype=bool), replace(APART, **seen))

    add([0, 0, 0, 0], node_depth=0.008)
    assert (tally.missed, tally.pairs, tally.enclosed) == (0, 0, 0)
    add([0, 0, 0, 0], node_depth=0.04)
    add([0, 0, 0, 0], centre_inside=True)
    assert tally.missed == 2
    add([1, 0, 1, 0], node_depth=0.05)
    assert (tally.missed, tally.pairs) == (2, 0)
    add([1, 1, 1, 1], corner_depth=0.01)
    assert tally.pairs == 1
    add([0, 0, 0, 0], surface_depth=0.3, passages=7)
    add([0, 0, 0, 0], enclosed=3, turned=1)
    assert (tally.enclosed, tally.passages, tally.turned) == (2, 1, 1)
    assert (tally.residual, tally.final_residual) == (0.3, 0.0)


def outcome(number=0, contact="flags", **changes):
    good = plunges.Outcome(
        plunge=plunges.draw(1, number),
        contact=contact,
        missed=0,
        enclosed=0,
        passages=0,
        turned=0,
        pairs=0,
        trailing=0,
        residual=0.01,
        final_residual=0.0,
        shaking=1.0,
        non_finite=False,
        steps=10,
    )
    return replace(good, **changes)


FAILURES = [
    {"missed": 1},
    {"enclosed": 2},
    {"passages": 3},
    {"pairs": 4},
    {"residual": 0.011},
    {"non_finite": True, "shaking": math.nan},
]


@pytest.mark.parametrize("changes", FAILURES)
def test_each_failure_is_one(changes):
    assert not outcome(turned=5, trailing=5, residual=0.01).failed
    assert outcome(**changes).failed
    assert outcome(**changes).wrong_side == ("enclosed" in changes or "passages" in changes)


def test_a_summary_counts_cases():
    good = [outcome(number, residual=0.001 * number) for number in range(10)]
    bad = [outcome(10 + number, **changes) for number, changes in enumerate(FAILURES)]
    summary = tunnelling.summarise(good + bad)
    assert (summary["cases"], summary["failed"]) == (16, 6)
    assert summary["failure_rate"] == pytest.approx(6 / 16)
    for key in ("missed", "enclosed", "passages", "pairs", "residual_too_large", "non_finite"):
        assert summary[key] == 1
    assert (summary["wrong_side"], summary["pair_steps"], summary["steps"]) == (2, 4, 160)
    assert summary["residual"]["max"] == 0.011
    assert summary["failed_cases"] == list(range(10, 16))
    # The worst first: divergence, then missed contact, then the deepest of the cases that passed.
    numbers = [case["plunge"]["number"] for case in summary["worst"]]
    assert numbers[0] == 15
    assert set(numbers[:6]) == set(range(10, 16))
    assert numbers[6:] == [9, 8, 7, 6]
    # Strict JSON, also with a diverged case.
    assert json.loads(json.dumps(summary, allow_nan=False))["worst"][0]["shaking"] is None
    text = tunnelling.describe("flags", summary)
    assert "6 of 16" in text
    assert "diverged" in text


def test_a_summary_of_diverged_cases_alone():
    summary = tunnelling.summarise([outcome(non_finite=True, shaking=math.nan)])
    assert summary["residual"] == {"p50": None, "p95": None, "max": None}
    assert "1 of 1" in tunnelling.describe("flags", summary)


def test_a_plan_runs_every_contact_model_on_the_first_cases():
    jobs = tunnelling.plan(4, range(10, 15), 2)
    assert [job.number for job in jobs if job.contact == "flags"] == [10, 11, 12, 13, 14]
    for contact in ("bullet", "second_step"):
        assert [job.number for job in jobs if job.contact == contact] == [10, 11]
    assert {job.seed for job in jobs} == {4}


# Running -----------------------------------------------------------------------------------------------------------


def test_results_come_with_their_items():
    assert list(parallel.results(abs, [3, -1, 2], 1, "numbers")) == [(3, 3), (-1, 1), (2, 2)]
    assert sorted(parallel.results(abs, [3, -1, 2, -5], 2, "numbers")) == [(-5, 5), (-1, 1), (2, 2), (3, 3)]
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        next(parallel.results(abs, [1], 0, "numbers"))


def test_a_crashed_process_is_told():
    # A crash of the engine ends the process in the same way: without an exception.
    with pytest.raises(parallel.WorkerDied, match=r"while it worked on [12]"):
        list(parallel.results(_crash, [1, 2], 2, "numbers"))


def _crash(number):
    import os

    os._exit(number)


def test_an_error_names_the_case(monkeypatch):
    def fail(*arguments):
        raise ZeroDivisionError("no reason")

    monkeypatch.setattr(plunges, "run", fail)
    with pytest.raises(RuntimeError, match=r"case 7 of seed 3 with contact 'bullet': no reason"):
        tunnelling.run_job(tunnelling.Job(3, 7, "bullet"))


def run_main(monkeypatch, capsys, *options):
    monkeypatch.setattr(sys, "argv", ["tunnelling", *options])
    tunnelling.main()
    output = capsys.readouterr().out.splitlines()
    return output, json.loads(output[-1])


def test_the_command_prints_one_line_of_json(monkeypatch, capsys):
    options = ("--cases", "2", "--first", str(FAST - 1), "--subset", "0", "--workers", "1")
    output, result = run_main(monkeypatch, capsys, *options, "--json")
    assert len(output) == 1
    assert (result["benchmark"], result["first"], result["complete"]) == ("tunnelling", FAST - 1, True)
    assert result["contact"]["flags"]["cases"] == 2
    assert result["passed"] == (result["contact"]["flags"]["failed"] == 0)


@pytest.mark.bullet
def test_an_interrupted_run_prints_what_it_has(monkeypatch, capsys):
    def interrupted(job):
        if job.number == 3:
            raise KeyboardInterrupt
        return outcome(job.number, job.contact)

    monkeypatch.setattr(tunnelling, "run_job", interrupted)
    output, result = run_main(monkeypatch, capsys, "--cases", "9", "--subset", "2", "--workers", "1")
    assert not result["complete"]
    assert not result["passed"]
    assert {contact: summary["cases"] for contact, summary in result["contact"].items()} == {
        "flags": 3,
        "second_step": 2,
        "bullet": 2,
    }
    assert output[0] == "flags: 0 of 3 plunges failed (0.0 %)"


def test_a_single_case_is_printed_step_by_step(monkeypatch, capsys):
    output, result = run_main(monkeypatch, capsys, "--case", str(FAST))
    plunge = plunges.draw(tunnelling.SEED, FAST)
    assert result["plunge"]["number"] == FAST
    assert sum("held" in line for line in output) == plunge.held_steps


@pytest.mark.parametrize("option", ["--cases", "--workers"])
def test_the_command_refuses_senseless_numbers(monkeypatch, capsys, option):
    with pytest.raises(SystemExit):
        run_main(monkeypatch, capsys, option, "0")
    assert f"{option} must be at least 1, got 0" in capsys.readouterr().err


def test_failures_are_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    outcomes = {
        "flags": [outcome(number) for number in range(30)] + [outcome(31, non_finite=True)],
        "bullet": [outcome(number, "bullet", residual=1.7) for number in range(5)],
    }
    path = tmp_path / "failures.png"
    pictures.draw_failures(outcomes, path)
    assert path.read_bytes().startswith(b"\x89PNG")

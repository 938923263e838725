"""Does the inspection measure how deep a tool and an organ are in each other, and where an organ crosses itself?"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_inspection import ReferenceInspector

from benchmarks import inspection, motions
from benchmarks.crossings import UNKNOWN, CrossingCounter, Crossings, count_crossings
from benchmarks.depths import depth_of_surface
from benchmarks.inspection import (
    APART,
    Inspector,
    Tally,
    WorldInspection,
    WorldInspector,
    WorldsInspector,
)
from spatula_env import Simulation, scenes
from spatula_env.geometry import Tool, box_surface, icosphere, seed_sphere
from spatula_env.geometry.transforms import random_quaternion, rotate

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
CUBE = Tool.box((2.0, 2.0, 2.0))
ONE = np.array([[0, 1, 2]], dtype=np.int32)


def depth_of(points, tool=CUBE, triangles=ONE):
    every = np.arange(len(triangles))
    return depth_of_surface(np.array(points, dtype=float), triangles, every, *map(np.array, tool.planes))


# The surface in the tool --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("points", "depth"),
    [
        # Corners far outside, the triangle right through the middle.
        ([(-9.0, -9.0, 0.0), (9.0, -9.0, 0.0), (0.0, 9.0, 0.0)], 1.0),
        ([(-9.0, -9.0, 0.75), (9.0, -9.0, 0.75), (0.0, 9.0, 0.75)], 0.25),
        # Across an edge of the cube, whose plane is x + y = 1.8: deepest at x = y = 0.9.
        ([(5.0, -3.2, -9.0), (-3.2, 5.0, -9.0), (0.9, 0.9, 20.0)], 0.1),
        # Across a corner: x + y + z = 2.7.
        ([(12.7, -5.0, -5.0), (-5.0, 12.7, -5.0), (-5.0, -5.0, 12.7)], 0.1),
        # One side comes in, at x = 0.6, between corners that are outside.
        ([(0.6, -3.0, 0.0), (0.6, 3.0, 0.0), (4.0, 0.0, 0.0)], 0.4),
        # A corner comes in.
        ([(0.3, 0.0, 0.0), (4.0, 1.0, 0.0), (4.0, -1.0, 0.0)], 0.7),
        # Beside it, though the boxes overlap.
        ([(1.5, 0.9, -3.0), (0.9, 1.5, -3.0), (1.3, 1.3, 3.0)], 0.0),
        # Flat as a needle.
        ([(-3.0, 0.0, 0.5), (3.0, 0.0, 0.5), (0.0, 0.0, 0.5)], 0.5),
    ],
)
def test_the_depth_of_a_triangle_is_that_of_its_deepest_point(points, depth):
    for order in ((0, 1, 2), (1, 2, 0), (2, 1, 0)):
        assert depth_of([points[k] for k in order]) == pytest.approx(depth, abs=1e-12)


def needle():
    angles = np.linspace(0.0, 2.0 * np.pi, 7, endpoint=False)
    ring = np.column_stack([0.2 * np.cos(angles), 0.2 * np.sin(angles), np.zeros(7)])
    return Tool.convex([*ring, *(ring + np.array([0.0, 0.0, 2.0])), (0.0, 0.0, -0.8)], node_spacing=0.2)


@given(st.integers(0, 2**32), st.sampled_from([Tool.box((1.0, 0.7, 0.125)), needle()]))
@settings(max_examples=60)
def test_the_depth_is_the_greatest_of_all_points_of_the_surface(number, tool):
    generator = np.random.default_rng(number)
    triangles = np.arange(9, dtype=np.int32).reshape(3, 3)
    points = generator.normal(scale=generator.choice([0.2, 1.0]), size=(9, 3))
    depth = depth_of(points, tool, triangles)
    normals, offsets = tool.planes
    # All points of a lattice of weights, refined around the deepest.
    lattice = np.array([(i, j, 40 - i - j) for i, j in product(range(41), repeat=2) if i + j <= 40]) / 40.0
    best = 0.0
    for corners in points[triangles]:
        middle, size, found = np.full(3, 1.0 / 3.0), 1.0, -np.inf
        for _ in range(30):
            weights = np.clip(middle + size * (lattice - 1.0 / 3.0), 0.0, 1.0)
            weights /= weights.sum(axis=1, keepdims=True)
            depths = (offsets - weights @ corners @ normals.T).min(axis=1)
            found = max(found, depths.max())
            middle, size = weights[np.argmax(depths)], 0.7 * size
        best = max(best, found)
    assert depth >= best - 1e-12
    assert depth == pytest.approx(best, abs=2e-4)


def test_a_wall_between_the_contact_nodes_is_seen():
    # A thin ridge of the organ stands in the plate between its nodes; no vertex of it is inside.
    organ = box_surface((4.0, 0.02, 2.0))
    tool = Tool.box((1.0, 1.0, 0.125))
    seen = Inspector(tool, organ.triangles).inspect((0.0, 0.0, 0.97), UPRIGHT, organ.vertices)
    assert seen.node_depth == seen.corner_depth == 0.0
    # The plate reaches from 0.9075 to 1.0325; the ridge's top is at 1.
    assert seen.surface_depth == pytest.approx(0.0625, abs=1e-9)
    assert seen.residual == seen.surface_depth


def test_an_edge_of_the_tool_that_cuts_in_between_its_corners_is_seen():
    # A ridge across the plate's rim: only the middle of an edge is in the organ.
    organ = box_surface((0.3, 4.0, 2.0))
    tool = Tool.box((1.0, 1.0, 0.125))
    seen = Inspector(tool, organ.triangles).inspect((0.05, -2.4, 0.5), UPRIGHT, organ.vertices)
    assert seen.corner_depth == 0.0
    # Its far edges are at y = -1.9, 0.1 behind the organ's side; points of them are 0.1 apart.
    assert seen.edge_depth == pytest.approx(0.1, abs=1e-9)


# Crossings ----------------------------------------------------------------------------------------------------------


def joined(*organs):
    starts = np.cumsum([0, *(len(organ.vertices) for organ in organs)])
    vertices = np.concatenate([organ.vertices for organ in organs])
    triangles = np.concatenate([organ.triangles + start for organ, start in zip(organs, starts, strict=False)])
    return vertices, triangles, np.repeat(np.arange(len(organs)), [len(organ.vertices) for organ in organs])


def shifted(organ, way):
    return replace(organ, vertices=organ.vertices + np.array(way))


def brute_force(vertices, triangles):
    """Each edge against all triangles, by linear equations."""
    edges = {tuple(sorted((t[k], t[(k + 1) % 3]))) for t in triangles.tolist() for k in range(3)}
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    count = 0
    for p, q in edges:
        along = np.broadcast_to(vertices[q] - vertices[p], a.shape)
        matrices = np.stack([along, a - b, a - c], axis=2)
        candidates = ~np.isin(triangles, (p, q)).any(axis=1) & (np.abs(np.linalg.det(matrices)) >= 1e-14)
        right = (a - vertices[p])[candidates, :, None]
        s, u, v = np.linalg.solve(matrices[candidates], right)[:, :, 0].T
        count += ((s > 0.0) & (s < 1.0) & (u > 0.0) & (v > 0.0) & (u + v < 1.0)).sum()
    return count


def test_an_organ_at_rest_does_not_cross_itself():
    for name in motions.SCENES:
        scene = getattr(scenes, name)()
        vertices, triangles, organs = joined(*(placed.organ for placed in scene.organs))
        assert CrossingCounter(vertices, triangles, organs).count(vertices) == Crossings(0, 0)


def test_two_boxes_through_each_other_cross_at_known_edges():
    # A bar through a slab: each of the bar's four long edges goes through the slab's top and bottom.
    slab, bar = box_surface((4.0, 3.0, 1.0)), box_surface((0.5, 0.4, 3.0))
    organs = slab, shifted(bar, (0.3137, 0.1729, 0.0))
    vertices, triangles, which = joined(*organs)
    crossings = CrossingCounter(vertices, triangles, which).count(vertices)
    # And diagonals of the bar's sides, and of the slab's faces: as many as brute force finds.
    assert crossings == Crossings(0, brute_force(vertices, triangles))
    assert crossings.between >= 8
    assert CrossingCounter(vertices, triangles).count(vertices) == Crossings(crossings.between, 0)
    apart = np.concatenate([slab.vertices, bar.vertices + np.array([9.0, 0.0, 0.0])])
    assert CrossingCounter(vertices, triangles, which).count(apart) == Crossings(0, 0)


@given(st.integers(0, 2**32))
@settings(max_examples=10)
def test_crossings_of_a_crumpled_organ_are_those_that_brute_force_finds(number):
    generator = np.random.default_rng(number)
    organ = icosphere(1.0, 1)
    counter = CrossingCounter(organ.vertices, organ.triangles)
    crumpled = organ.vertices + generator.normal(scale=generator.choice([0.1, 0.3]), size=organ.vertices.shape)
    assert counter.count(crumpled).own == brute_force(crumpled, organ.triangles)


def test_crossings_do_not_depend_on_where_and_how_an_organ_lies():
    generator = np.random.default_rng(5)
    organ = seed_sphere()
    counter = CrossingCounter(organ.vertices, organ.triangles)
    crumpled = organ.vertices + generator.normal(scale=0.3, size=organ.vertices.shape)
    count = counter.count(crumpled)
    assert count.own > 10
    assert counter.count(rotate(random_quaternion(generator), crumpled) + np.array([3.0, -7.0, 2.0])) == count


def test_crossings_are_the_same_however_an_organ_got_there():
    # It turns, goes away and is crumpled, slowly and at once: what was near is not near any more.
    generator = np.random.default_rng(8)
    organ = seed_sphere()
    counter = CrossingCounter(organ.vertices, organ.triangles)
    one_patch, one_organ = np.array([0, len(organ.triangles)]), np.zeros(len(organ.vertices), dtype=np.int32)
    counts = []
    for step in range(120):
        crumpled = organ.vertices + 0.4 * np.sin(step / 30.0) ** 2 * np.cos(7.0 * organ.vertices[:, [1, 2, 0]])
        if step % 10 == 0:
            crumpled = crumpled + generator.normal(scale=0.1, size=crumpled.shape)
        turn = (
            random_quaternion(generator)
            if step % 25 == 0
            else np.array([0.0, np.sin(step / 9.0), 0.0, np.cos(step / 9.0)])
        )
        vertices = rotate(turn, crumpled) + 0.05 * step
        counts.append(counter.count(vertices).own)
        assert counts[-1] == count_crossings(vertices, organ.triangles, one_patch, one_organ)[0]
    assert min(counts) == 0
    assert max(counts) > 100


def test_crossings_of_what_is_too_crumpled_to_know_what_is_near_are_counted_all_the_same():
    generator = np.random.default_rng(2)
    organ = icosphere(1.0, 1)
    counter = CrossingCounter(organ.vertices, organ.triangles)
    for scale in (0.0, 1.0, 0.1, 0.01):
        crumpled = organ.vertices * 0.1 ** (scale > 0.1) + generator.normal(
            scale=0.3 * scale, size=organ.vertices.shape
        )
        assert counter.count(crumpled).own == brute_force(crumpled, organ.triangles)
        assert (counter._near.counts[0] == UNKNOWN) == (scale == 1.0)


# Brute force --------------------------------------------------------------------------------------------------------


def unsteady_states(scene, steps, generator):
    """Poses of tools that move and jump in and out of organs, and vertices of organs that deform, turn and go away."""
    rest = np.concatenate([placed.vertices for placed in scene.organs])
    size = np.ptp(rest, axis=0).max()
    shift, crumple = np.zeros(3), generator.normal(size=rest.shape)
    positions = np.array([placed.position for placed in scene.tools])
    orientations = np.array([placed.orientation for placed in scene.tools])
    for step in range(steps):
        if step % 16 == 0:
            turn, way = random_quaternion(generator), generator.normal(size=(len(positions), 3))
            amount = generator.choice([0.0, 0.004, 0.02]) * size
        if step % 24 == 0:
            # Just over some vertex, at it, or anywhere.
            at = rest[generator.integers(len(rest), size=len(positions))] + shift
            positions = at + generator.choice([0.02, 0.2, 2.0]) * generator.normal(size=positions.shape)
            orientations = np.array([random_quaternion(generator) for _ in positions])
            if step % 72 == 0:
                positions[0] += 5.0 * size
        shift = shift + 0.002 * size * rotate(turn, np.array([1.0, 0.0, 0.0]))
        positions = positions + generator.choice([0.01, 0.1]) * way
        yield positions, orientations, rest + amount * np.sin(0.3 * step) * crumple + shift


@pytest.mark.parametrize("name", motions.SCENES)
def test_worlds_are_seen_as_by_brute_force(name):
    scene = getattr(scenes, name)()
    count, generator = 3, np.random.default_rng(12)
    worlds, references = WorldsInspector(scene, count), [ReferenceInspector(scene) for _ in range(count)]
    kinds = dict.fromkeys(
        ("apart", "inside", "surface_depth", "node_depth", "enclosed", "passages", "turned", "own"), 0
    )
    for step, states in enumerate(
        zip(*(unsteady_states(scene, 144, child) for child in generator.spawn(count)), strict=True)
    ):
        active = generator.random(count) > 0.05
        if step % 50 == 49:
            worlds.reset([1])
            references[1].reset()
        seen = worlds.inspect(*(np.array(parts) for parts in zip(*states, strict=True)), active)
        for world in range(count):
            if not active[world]:
                assert seen.world(world) == WorldInspection((APART,) * len(scene.tools), Crossings(0, 0))
                continue
            expected, found = references[world].inspect(*states[world]), seen.world(world)
            assert found.crossings == expected.crossings
            assert seen.residuals[world] == found.residual
            assert seen.wrong_side[world] == found.wrong_side
            kinds["own"] += found.crossings.own > 0
            for one, other in zip(found.tools, expected.tools, strict=True):
                assert asdict(one) == pytest.approx(asdict(other), abs=1e-12)
                kinds["apart"] += one == APART
                kinds["inside"] += one.centre_inside and one.surface_depth == 0.0
                for kind in ("surface_depth", "node_depth", "enclosed", "passages", "turned"):
                    kinds[kind] += getattr(one, kind) > 0
    # Some organs are too thin to hold a tool.
    assert (kinds.pop("inside") > 0) == (name in ("seed", "palpate", "clamp"))
    assert min(kinds.values()) > 0, kinds


@pytest.mark.parametrize("name", ["seed", "fissure", "clamp"])
def test_a_motion_is_seen_as_by_brute_force(name):
    simulation = Simulation(getattr(scenes, name)(), engine="batch")
    inspector, reference = WorldInspector(simulation.scene), ReferenceInspector(simulation.scene)
    linear, angular = motions.plough(simulation, 0.3, np.random.default_rng(4))
    touching = 0
    try:
        for v, w in zip(linear, angular, strict=True):
            report = simulation.step(v, w)
            touching += bool(report.loads[:, :3].any())
            state = simulation.tool_positions, simulation.tool_orientations, simulation.nodes
            seen, expected = inspector.inspect(*state), reference.inspect(*state)
            assert seen.crossings == expected.crossings
            for one, other in zip(seen.tools, expected.tools, strict=True):
                assert asdict(one) == pytest.approx(asdict(other), abs=1e-12)
    finally:
        simulation.close()
    assert touching > 30


# Worlds and motions -------------------------------------------------------------------------------------------------


def test_a_world_is_seen_with_all_its_tools():
    scene = scenes.clamp()
    inspector = WorldInspector(scene)
    nodes = np.concatenate([placed.vertices for placed in scene.organs])
    positions = np.array([placed.position for placed in scene.tools])
    orientations = np.array([placed.orientation for placed in scene.tools])
    positions[1] += 100.0
    positions[0] = nodes.mean(axis=0)
    seen = inspector.inspect(positions, orientations, nodes)
    assert seen.tools[1] == APART
    assert seen.tools[0].residual > 0.1
    assert seen.residual == seen.tools[0].residual
    assert seen.wrong_side


def seen_with(depth=0.0, own=0, between=0):
    return WorldInspection((replace(APART, corner_depth=depth),), Crossings(own, between))


def test_a_tally_counts_and_follows_what_lasts():
    tally = Tally()
    for depth, reported, own in ((0.02, 0.0, 0), (0.03, 0.02, 1), (0.001, 0.0, 2), (0.05, 0.0, 0), (0.0, 0.0, 1)):
        tally.add(seen_with(depth, own), touching=depth > 0.0, reported=reported)
    assert (tally.steps, tally.touching, tally.deep, tally.longest_deep, tally.unreported) == (5, 4, 3, 2, 2)
    assert (tally.depth, tally.deepest_step, tally.reported) == (0.05, 3, 0.02)
    assert (tally.crossed, tally.longest_crossed, tally.most_crossings, tally.crossed_between) == (3, 2, 2, 0)
    assert "_deep_since" not in tally.as_dict()


@pytest.mark.parametrize("name", list(motions.MOTIONS))
def test_motions_come_to_touch_and_can_be_repeated(name):
    simulation = Simulation(scenes.seed(), engine="batch")
    try:
        linear, angular = motions.MOTIONS[name](simulation, 0.2, np.random.default_rng(1))
        again = motions.MOTIONS[name](simulation, 0.2, np.random.default_rng(1))
        np.testing.assert_array_equal(linear, again[0])
        np.testing.assert_array_equal(angular, again[1])
        assert linear.shape == angular.shape == (len(linear), 1, 3)
        tally = inspection.watch_motion(simulation, linear, angular)
    finally:
        simulation.close()
    assert tally.steps == len(linear)
    assert tally.touching > 0
    assert not tally.diverged


def run_main(monkeypatch, capsys, *options):
    monkeypatch.setattr(sys, "argv", ["inspection", *options])
    inspection.main()
    output = capsys.readouterr().out.splitlines()
    return output, json.loads(output[-1])


def test_the_command_looks_at_a_motion(monkeypatch, capsys):
    output, result = run_main(monkeypatch, capsys, "--motion", "press", "--seconds", "0.05", "--seed", "3")
    assert result["benchmark"] == "inspection"
    assert result["passed"]
    assert result["steps"] == len(output) - 2
    assert 0.0 < result["touching"] < result["steps"]


def test_the_command_repeats_a_recording(monkeypatch, capsys, tmp_path):
    simulation = Simulation(scenes.seed(), engine="batch")
    state = simulation.save()
    simulation.close()
    path = tmp_path / "recording.npz"
    parts = {
        "nodes": state.nodes,
        "velocities": state.node_velocities,
        # The plate in the middle of the organ.
        "positions": state.nodes.mean(axis=0)[None],
        "orientations": state.tool_orientations,
        "linear": np.zeros((2, 1, 3)),
        "angular": np.zeros((2, 1, 3)),
    }
    np.savez(path, **parts)
    output, result = run_main(monkeypatch, capsys, "--recording", str(path), "--json")
    assert len(output) == 1
    assert (result["steps"], result["motion"], result["passed"]) == (2, str(path), False)
    del parts["linear"]
    np.savez(path, **parts)
    with pytest.raises(SystemExit):
        run_main(monkeypatch, capsys, "--recording", str(path))
    assert "lacks ['linear']" in capsys.readouterr().err

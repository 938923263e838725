"""Constraints of tools that share no vertex are solved apart."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loose import LooseOrgans

from spatula_env.contact.islands import IslandRoom, find_islands, greatest_violation
from spatula_env.contact.structures import (
    FEATURE_LENGTH,
    GAP,
    GROUND,
    INERTIA,
    NO_VERTEX,
    NORMAL,
    ORGANS,
    OWNER,
    POINT,
    ROW_LENGTH,
)
from spatula_env.geometry import Tool, box_surface

AFTER_TOOLS = 1000
"""Stands for contact between organs in place of the index of a tool; it is greater than all of these."""

seeds = st.integers(0, 2**32 - 1)


def islands_of(features, inverse_mass, tools):
    """Constraints with the ground that belong to no island, and the islands, as lists of constraints."""
    order = np.full(len(features), -1)
    room = IslandRoom(*(np.full(size, -1) for size in (tools + 2, len(inverse_mass), tools + 1, tools + 1)))
    count = find_islands(len(features), features, inverse_mass, tools, order, room)
    assert (room.holders == -1).all()
    ends = room.starts[: count + 1].tolist()
    assert ends[-1] == len(features)
    return order[: ends[0]].tolist(), [order[a:b].tolist() for a, b in pairwise(ends)]


def reference_islands(features, inverse_mass):
    """The same with Python sets: owners that share a free vertex are merged into one group."""
    groups = []
    owners = np.where(features[:, OWNER] == ORGANS, AFTER_TOOLS, features[:, OWNER])
    for owner in sorted(set(owners.tolist()) - {GROUND}):
        ends = features[owners == owner][:, : 4 if owner == AFTER_TOOLS else 3].ravel().tolist()
        held = {v for v in ends if inverse_mass[v] > 0.0}
        joined = [group for group in groups if group[1] & held]
        groups = [group for group in groups if group not in joined]
        groups.append(({owner}.union(*(g[0] for g in joined)), held.union(*(g[1] for g in joined))))
    lone, islands = [], {min(owners): [] for owners, _ in groups}
    for c, row in enumerate(features):
        mine = [g for g in groups if (owners[c] in g[0] if owners[c] != GROUND else int(row[0]) in g[1])]
        (islands[min(mine[0][0])] if mine else lone).append(c)
    return lone, [islands[first] for first in sorted(islands)]


@given(seeds)
def test_islands_are_what_is_connected_by_free_vertices(seed):
    generator = np.random.default_rng(seed)
    tools, vertices = int(generator.integers(1, 6)), int(generator.integers(3, 40))
    inverse_mass = np.where(generator.uniform(size=vertices) < 0.2, 0.0, 1.0)
    ground = generator.integers(0, vertices, size=generator.integers(0, 6))
    rows = [[*generator.integers(0, vertices, size=4).tolist(), ORGANS, 0] for _ in range(generator.integers(0, 4))]
    rows += [[v, v, v, NO_VERTEX, GROUND, -1] for v in ground.tolist() if inverse_mass[v] > 0.0]
    for owner in range(tools):
        for _ in range(generator.integers(0, 5)):
            rows.append([*generator.integers(0, vertices, size=3).tolist(), NO_VERTEX, owner, 0])
    features = np.array(rows, dtype=np.int32).reshape(-1, FEATURE_LENGTH)
    assert islands_of(features, inverse_mass, tools) == reference_islands(features, inverse_mass)


def test_the_greatest_violation_is_that_of_what_can_move():
    rows = np.zeros((4, ROW_LENGTH))
    rows[:, GAP], rows[:, INERTIA] = [-0.3, 0.2, -0.1, -0.5], [1.0, 1.0, 1.0, 0.0]
    features = np.zeros((4, FEATURE_LENGTH), dtype=np.int32)
    assert greatest_violation(np.array([0, 1]), rows, features) == 0.3
    assert greatest_violation(np.array([1, 2]), rows, features) == 0.1
    assert greatest_violation(np.array([1, 3]), rows, features) == 0.0


def test_half_of_the_distance_between_organs_may_be_missing():
    rows, features = np.zeros((1, ROW_LENGTH)), np.zeros((1, FEATURE_LENGTH), dtype=np.int32)
    rows[0, GAP], rows[0, INERTIA], features[0, OWNER] = -0.3, 1.0, ORGANS
    rows[0, NORMAL : NORMAL + 3], rows[0, POINT : POINT + 3] = (0.0, 0.6, 0.8), (0.0, 0.24, 0.32)
    assert greatest_violation(np.array([0]), rows, features) == pytest.approx(0.1)


def test_a_tool_on_another_organ_changes_nothing():
    """Results are equal bit for bit, however many sweeps the other organ takes."""
    organ, plate = box_surface((3.0, 3.0, 1.0), 0.5), Tool.box((1.0, 0.8, 0.1), 5, "all")
    places = (np.zeros(3), np.array([10.0, 0.0, 0.0]))
    tilted = (0.1, 0.0, 0.0, np.sqrt(1.0 - 0.1**2))

    def press(which):
        """Tools on some of the organs, the second one pressed by its edge and dragged aside; nodes and loads."""
        organs = [shifted(organ, places[k]) for k in which]
        tools = [(plate, places[k] + [0.1, 0.2, 0.56 + 0.1 * k], tilted if k else (0.0, 0.0, 0.0, 1.0)) for k in which]
        loose = LooseOrgans(organs, tools, friction=0.3)
        velocities = np.array([[0.0, 0.0, -2.0], [1.0, 0.5, -4.0]])[list(which)]
        impulses = []
        for _ in range(40):
            loose.step(velocities, np.zeros_like(velocities))
            impulses.append(loose.nodal_impulses.copy())
        return loose.nodes, np.array(impulses), loose.wrenches

    nodes, impulses, wrenches = press((0, 1))
    for k in range(2):
        alone = press((k,))
        own = slice(k * len(organ.vertices), (k + 1) * len(organ.vertices))
        np.testing.assert_array_equal(nodes[own], alone[0])
        np.testing.assert_array_equal(impulses[:, own], alone[1])
        np.testing.assert_array_equal(wrenches[k], alone[2][0])
    assert np.abs(impulses).max(axis=(0, 2)).max() > 0.0


def shifted(organ, by):
    """An organ somewhere else."""
    return type(organ)(organ.vertices + by, organ.triangles, organ.name)

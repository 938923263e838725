from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.geometry import box_surface, icosphere, seed_sphere
from spatula_env.geometry.surface import edges
from spatula_env.scenes import PlacedOrgan
from spatula_env.sim.soft_body import (
    BENDING_STIFFNESS,
    EDGE_STIFFNESS,
    join,
    node_masses,
    ordered_links,
    shuffle,
    soft_body,
)


def graph_distances(pairs, count):
    """Graph distance between any two nodes, by breadth-first search."""
    neighbours = [set() for _ in range(count)]
    for a, b in pairs.tolist():
        neighbours[a].add(b)
        neighbours[b].add(a)
    distances = np.full((count, count), -1)
    for start in range(count):
        distances[start, start] = 0
        queue = deque([start])
        while queue:
            node = queue.popleft()
            for other in neighbours[node]:
                if distances[start, other] < 0:
                    distances[start, other] = distances[start, node] + 1
                    queue.append(other)
    return distances


# Links -------------------------------------------------------------------------------------------------------------


def test_the_seeds_sphere_has_the_links_that_bullet_makes():
    _, stiffness = ordered_links(seed_sphere().triangles)
    assert (stiffness == EDGE_STIFFNESS).sum() == 978
    assert (stiffness == BENDING_STIFFNESS).sum() == 2021


@pytest.mark.parametrize("organ", [icosphere(1.0, 1), box_surface(spacing=0.5), seed_sphere(node_count=60)])
def test_edges_and_pairs_at_distance_two_are_linked_once(organ):
    links, stiffness = ordered_links(organ.triangles)
    distances = graph_distances(edges(organ.triangles), len(organ.vertices))
    assert (distances[tuple(links.T)] == np.where(stiffness == EDGE_STIFFNESS, 1, 2)).all()
    assert len(np.unique(np.sort(links, axis=1), axis=0)) == len(links)
    assert len(links) == ((distances == 1) | (distances == 2)).sum() // 2


@given(st.integers(0, 500))
def test_shuffling_loses_nothing(count):
    assert sorted(shuffle(count).tolist()) == list(range(count))


def test_three_elements_are_shuffled_as_worked_out_by_hand():
    # The random numbers are 2936714474, 250175297 and 1200992172, which leave 2, 2 and 0 when divided by 3. Swapping
    # places 0 and 2, 1 and 2, 2 and 0 makes 0 1 2 into 2 1 0, 2 0 1 and 1 0 2.
    assert shuffle(3).tolist() == [1, 0, 2]


# Masses ------------------------------------------------------------------------------------------------------------


def test_masses_sum_to_the_organs_and_follow_its_symmetry():
    organ = icosphere(2.0, 1)
    masses = node_masses(organ, 3.0)
    assert masses.sum() == pytest.approx(3.0, rel=1e-12)
    # The corners of the icosahedron have five triangles around them, the middles of its edges have six.
    assert np.ptp(masses[:12]) < 1e-6 * masses[0]
    assert np.ptp(masses[12:]) < 1e-6 * masses[0]
    assert masses[12] > 1.1 * masses[0]


def test_a_mass_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match="mass"):
        node_masses(icosphere(), 0.0)


# Soft bodies -------------------------------------------------------------------------------------------------------


def test_links_rest_at_the_length_they_have_in_the_scene():
    placed = PlacedOrgan(icosphere(2.0, 1), position=(5.0, -1.0, 7.0), orientation=(0.5, 0.5, 0.5, 0.5))
    body = soft_body(placed)
    assert np.array_equal(body.vertices, placed.vertices)
    lengths = np.linalg.norm(np.subtract(*placed.vertices[body.links.T]), axis=1)
    assert np.allclose(body.squared_rest_lengths, lengths**2, rtol=1e-12)


def test_the_ends_of_a_link_share_its_stretch_so_that_momentum_stays():
    body = soft_body(PlacedOrgan(seed_sphere(node_count=60), mass=2.0))
    shares = body.shares()
    assert np.allclose(shares.sum(axis=1), body.stiffness, rtol=1e-12)
    momenta = body.masses[body.links] * shares
    assert np.allclose(momenta[:, 0], momenta[:, 1], rtol=1e-12)


def test_a_fixed_node_leaves_all_to_the_other_end():
    body = soft_body(PlacedOrgan(icosphere(2.0, 1), fixed_nodes=(0, 12)))
    assert body.inverse_masses[[0, 12]].tolist() == [0.0, 0.0]
    assert (body.masses > 0.0).all()
    fixed = body.inverse_masses[body.links] == 0.0
    both, one = fixed.all(axis=1), fixed.any(axis=1) & ~fixed.all(axis=1)
    shares = body.shares()
    assert both.sum() == 1
    assert (shares[both] == 0.0).all()
    assert (shares[fixed] == 0.0).all()
    assert np.array_equal(shares[one].sum(axis=1), body.stiffness[one])


def test_joined_bodies_stay_apart():
    one = soft_body(PlacedOrgan(icosphere(1.0, 0)))
    other = soft_body(PlacedOrgan(icosphere(2.0, 1), mass=4.0, fixed_nodes=(3,)))
    both = join([one, other])
    assert len(both.vertices) == len(one.vertices) + len(other.vertices)
    assert (both.links < len(one.vertices)).all(axis=1).sum() == len(one.links)
    assert (both.links >= len(one.vertices)).all(axis=1).sum() == len(other.links)
    assert np.flatnonzero(both.inverse_masses == 0.0).tolist() == [len(one.vertices) + 3]
    assert np.array_equal(both.shares(), np.concatenate([one.shares(), other.shares()]))
    apart = np.subtract(*both.vertices[both.links.T])
    assert np.allclose(both.squared_rest_lengths, (apart**2).sum(axis=1), rtol=1e-12)


def test_nodes_too_close_to_be_linked_are_named():
    organ = box_surface((1.0, 1.0, 5e-9), spacing=1.0)
    with pytest.raises(ValueError, match=r"'box'.* nodes \d+ and \d+"):
        soft_body(PlacedOrgan(organ))

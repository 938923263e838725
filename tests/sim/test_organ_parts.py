"""Organs of several parts: a soft body each, in both engines, and words about those that nothing holds."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from dataclasses import replace

import numpy as np
import pytest

from spatula_env import Simulation, scenes
from spatula_env.geometry import Organ, icosphere, load_organ
from spatula_env.geometry.parts import describe_parts, organ_parts
from spatula_env.scenes import PlacedOrgan
from spatula_env.sim import SceneWarning
from spatula_env.sim.soft_body import ordered_links, soft_body

PATIENCE = 300.0
"""For a child process that would otherwise hang for ever [s]."""


def joined(*organs, offsets, name="two parts"):
    starts = np.cumsum([0, *(len(organ.vertices) for organ in organs)])
    return Organ(
        np.concatenate([organ.vertices + offset for organ, offset in zip(organs, offsets, strict=True)]),
        np.concatenate([organ.triangles + start for organ, start in zip(organs, starts, strict=False)]),
        name,
    )


BALLS = joined(icosphere(2.0, 2), icosphere(1.0, 1), offsets=[(0.0, 0.0, 0.0), (4.0, 0.0, 0.0)])


def hollow():
    wall, cavity = icosphere(2.0, 2), icosphere(0.8, 1)
    triangles = np.concatenate([wall.triangles, cavity.triangles[:, ::-1] + len(wall.vertices)])
    return Organ(np.concatenate([wall.vertices, cavity.vertices]), triangles, "hollow")


def mixed(organ):
    """The same organ with its nodes in another order, so that a part's nodes do not follow each other."""
    order = np.random.default_rng(0).permutation(len(organ.vertices))
    return Organ(organ.vertices[order], np.argsort(order).astype(np.int32)[organ.triangles], organ.name), order


def touching():
    """Two tetrahedra that share a vertex: links connect them, edges of triangles do not."""
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [-1.0, -1.0, 1.0]])
    other = -corners[1:]
    triangles = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]])
    mirrored = np.where(triangles > 0, triangles + 3, 0)[:, ::-1]
    return Organ(np.concatenate([corners, other]), np.concatenate([triangles, mirrored]), "hourglass")


def placed(organ, held=True, height=2.0):
    """An organ whose parts are all held by a few of their nodes, so that nothing falls."""
    fixed = [int(node) for part in organ_parts(organ) for node in part.nodes[:4]] if held else []
    return PlacedOrgan(organ, position=(0.0, 0.0, height), fixed_nodes=tuple(fixed))


def scene(organ, **options):
    return replace(scenes.seed(), organs=(placed(organ, **options),))


# What parts are ----------------------------------------------------------------------------------------------------


def test_parts_are_what_no_edge_connects():
    parts = organ_parts(BALLS)
    assert [len(part.nodes) for part in parts] == [162, 42]
    assert [len(part.triangles) for part in parts] == [320, 80]
    assert sum(part.volume for part in parts) == pytest.approx(BALLS.volume)
    assert describe_parts(parts) == "162 nodes and 32.4 u3, 42 nodes and 3.66 u3"
    assert len(organ_parts(icosphere())) == 1


def test_the_wall_of_a_cavity_is_a_part():
    wall, cavity = organ_parts(hollow())
    assert wall.volume > 0.0 > cavity.volume
    assert "42 nodes around a cavity of 1.87 u3" in describe_parts([wall, cavity])


def test_many_parts_are_told_shortly():
    parts = organ_parts(BALLS) * 6
    assert describe_parts(parts).endswith("162 nodes and 32.4 u3, 42 nodes and 3.66 u3, 4 more")


def test_each_part_has_the_links_of_a_body_of_its_own():
    shuffled, order = mixed(BALLS)
    body = soft_body(PlacedOrgan(shuffled, mass=3.0))
    parts = organ_parts(shuffled)
    assert body.masses.sum() == pytest.approx(3.0)
    expected = np.concatenate([part.nodes[ordered_links(part.triangles)[0]] for part in parts])
    np.testing.assert_array_equal(body.links, expected)
    assert {len(part.nodes) for part in parts} == {162, 42}
    # No link leads from the one to the other.
    in_first = order < 162
    assert (in_first[body.links[:, 0]] == in_first[body.links[:, 1]]).all()


# Both engines ------------------------------------------------------------------------------------------------------


@pytest.mark.bullet
@pytest.mark.parametrize("organ", [BALLS, hollow(), mixed(BALLS)[0]], ids=["two balls", "cavity", "mixed order"])
def test_both_engines_step_all_parts_alike(organ):
    simulations = [Simulation(scene(organ), engine="bullet"), Simulation(scene(organ), "batch", precision="double")]
    bullet, batch = simulations
    np.testing.assert_allclose(bullet.nodes, batch.nodes, rtol=0.0, atol=1e-3)
    batch.restore(bullet.save())
    generator = np.random.default_rng(1)
    velocities = generator.normal(size=bullet.nodes.shape) * np.isfinite(bullet.node_masses)[:, None]
    for simulation in simulations:
        simulation.restore(replace(simulation.save(), node_velocities=velocities))
    path = [bullet.nodes]
    for _ in range(10):
        for simulation in simulations:
            simulation.step()
        path.append(bullet.nodes)
        np.testing.assert_allclose(bullet.nodes, batch.nodes, rtol=0.0, atol=1e-6)
    assert np.ptp(path, axis=0).max() > 1e-4
    np.testing.assert_allclose(bullet.node_masses, batch.node_masses, rtol=1e-12)
    for simulation in simulations:
        simulation.close()


@pytest.mark.bullet
def test_a_part_moves_as_it_does_alone():
    # The second ball falls freely beside the first one, as if that were not there.
    both = Simulation(replace(scene(BALLS), gravity=0.0, ground=None), engine="bullet")
    second = Organ(BALLS.vertices[162:], BALLS.triangles[320:] - 162)
    alone = replace(scene(second), gravity=0.0, ground=None)
    mass = float(soft_body(placed(BALLS)).masses[162:].sum())
    alone = Simulation(replace(alone, organs=(replace(alone.organs[0], mass=mass),)), engine="bullet")
    velocities = np.random.default_rng(2).normal(size=(42, 3))
    velocities[np.isinf(alone.node_masses)] = 0.0
    for simulation in (both, alone):
        everything = np.zeros_like(simulation.nodes)
        everything[-42:] = velocities
        simulation.restore(replace(simulation.save(), node_velocities=everything))
        for _ in range(20):
            simulation.step()
    np.testing.assert_allclose(both.nodes[162:], alone.nodes, rtol=0.0, atol=1e-9)
    both.close()
    alone.close()


SCRIPT = """
import warnings
from dataclasses import replace
import numpy as np
from spatula_env import Simulation, scenes
from spatula_env.geometry import Organ, icosphere
from spatula_env.scenes import PlacedOrgan
warnings.simplefilter("ignore")
first, second = icosphere(2.0, 2), icosphere(1.0, 1)
vertices = np.vstack([first.vertices, second.vertices + [4.0, 0.0, 0.0]])
organ = Organ(vertices, np.vstack([first.triangles, second.triangles + len(first.vertices)]), "two parts")
simulation = Simulation(replace(scenes.seed(), organs=(PlacedOrgan(organ, position=(0.0, 0.0, 2.0)),)), engine="bullet")
simulation.step()
print(np.isfinite(simulation.nodes).all())
"""


@pytest.mark.bullet
def test_loose_parts_do_not_hang_bullet():
    # In a process of its own, as no signal reaches one that hangs in Bullet.
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(SCRIPT)], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert done.stdout.strip() == "True", done.stderr


@pytest.mark.bullet
def test_parts_that_meet_in_a_vertex_are_refused_for_bullet_alone():
    with pytest.raises(ValueError, match=r"'hourglass' must not have parts that meet in a vertex.*7 nodes.*2 such"):
        Simulation(scene(touching(), held=False), engine="bullet")
    simulation = Simulation(scene(touching(), height=1.0), engine="batch")
    simulation.step()
    assert np.isfinite(simulation.nodes).all()


@pytest.mark.bullet
def test_more_nodes_than_bullet_can_count_are_refused(monkeypatch):
    monkeypatch.setattr("spatula_env.sim.bullet.MOST_NODES", 100)
    with pytest.raises(
        ValueError, match=r"at most 100 nodes in a part with engine 'bullet', got 162 nodes and 32.4 u3"
    ):
        Simulation(scene(BALLS), engine="bullet")


def test_an_organ_too_far_from_its_origin_is_refused():
    far = Organ(icosphere(0.2, 1).vertices + 2.0**24, icosphere(0.2, 1).triangles, "far")
    with pytest.raises(ValueError, match="'far' must be closer to the origin of its frame"):
        soft_body(PlacedOrgan(far))


# Words -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["bullet", "batch"])
def test_loose_parts_are_named_at_loading(engine):
    with pytest.warns(SceneWarning) as caught:
        Simulation(scene(BALLS, held=False), engine=engine).close()
    told = [str(each.message) for each in caught if "nothing connects" in str(each.message)]
    assert len(told) == 1
    assert "'two parts' consists of 2 parts that nothing connects (162 nodes and 32.4 u3, 42 nodes" in told[0]
    assert "2 of them are held by no fixed node and will fall" in told[0]
    assert all(each.filename == __file__ for each in caught)


def test_parts_that_are_held_are_no_cause_for_a_warning():
    Simulation(scene(BALLS), engine="batch").close()


def test_loading_a_file_of_several_parts_says_so(tmp_path):
    pytest.importorskip("trimesh")
    file = tmp_path / "balls.obj"
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}\n" for x, y, z in BALLS.vertices]
    lines += [f"f {a} {b} {c}\n" for a, b, c in BALLS.triangles + 1]
    file.write_text("".join(lines), encoding="utf-8")
    with pytest.warns(UserWarning, match=r"balls\.obj holds 2 parts that nothing connects \(162 nodes and 32.4 u3, 42"):
        organ = load_organ(file)
    assert len(organ.vertices) == 204


@pytest.mark.bullet
def test_bullet_is_given_nothing_to_draw():
    # With the organ's own surface it would look for the nearest triangle of every vertex: minutes, for a fine one.
    simulation = Simulation(scene(BALLS), engine="bullet")
    (world,) = simulation.worlds.engine.loaded
    assert [world._bullet.getMeshData(body, -1, physicsClientId=world._client)[0] for body in world._bodies] == [3, 3]
    simulation.close()

"""Checks of a scene before anything moves, and the likely causes that errors name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spatula_env import Simulation, scenes
from spatula_env.geometry import Organ, Tool, icosphere
from spatula_env.scenes import Ground, PlacedOrgan, PlacedTool, Scene
from spatula_env.sim import SimulationDiverged
from spatula_env.sim.scene_checks import check_surfaces, organs_below_ground, tools_in_organs
from spatula_env.sim.worlds import Worlds

BALL = icosphere(1.0, 1)
TOOL = Tool.box((0.5, 0.5, 0.125), 2)
PRESETS = [scenes.seed, scenes.retract, scenes.clamp, scenes.fissure, scenes.palpate]


def scene_of(organ=BALL, height=1.0, tool_height=4.0, **options):
    """An organ above or in the ground, and a tool over its middle or in it."""
    tools = (PlacedTool(TOOL, (0.0, 0.0, tool_height)),)
    return Scene((PlacedOrgan(organ, (0.0, 0.0, height), **options),), tools)


def crossed():
    """A sphere one of whose nodes is on the far side."""
    vertices = np.array(BALL.vertices)
    vertices[3] *= -2.0
    return Organ(vertices, BALL.triangles, "crossed")


@pytest.mark.parametrize("preset", PRESETS)
def test_nothing_is_wrong_with_the_presets(preset):
    scene = preset()
    check_surfaces(scene)
    assert organs_below_ground(scene) == ""
    poses = (np.array([getattr(tool, name) for tool in scene.tools]) for name in ("position", "orientation"))
    nodes = np.concatenate([placed.vertices for placed in scene.organs])
    assert tools_in_organs(scene.organs, nodes, scene.tools, *poses) == ""


@pytest.mark.parametrize("make", [lambda scene: Simulation(scene, engine="batch"), lambda scene: Worlds(scene, 2)])
def test_a_surface_that_crosses_itself_is_an_error(make):
    with pytest.raises(ValueError, match=r"organs: the surface of organ 'crossed' must not cross .* in \d+ places"):
        make(scene_of(crossed()))


def test_the_organ_that_crosses_itself_is_found_among_others():
    fine, wrong = PlacedOrgan(BALL, (5.0, 0.0, 1.0)), PlacedOrgan(crossed(), (0.0, 0.0, 3.0))
    with pytest.raises(ValueError, match="'crossed'"):
        check_surfaces(replace(scene_of(), organs=(fine, wrong)))
    # Two organs that go through each other are another matter.
    check_surfaces(replace(scene_of(), organs=(fine, replace(fine, position=(5.5, 0.0, 1.0)))))


def test_organs_below_the_ground_are_told():
    assert organs_below_ground(scene_of(height=1.0)) == ""
    assert organs_below_ground(scene_of(height=0.99)) == ""
    assert organs_below_ground(replace(scene_of(height=-5.0), ground=None)) == ""
    assert organs_below_ground(replace(scene_of(height=-5.0), ground=Ground(-6.0))) == ""
    told = organs_below_ground(scene_of(height=-5.0))
    assert "organ 'icosphere' starts with 42 of 42 free nodes below the ground, which is at 0 u, down to -6 u" in told
    low = tuple(np.flatnonzero(BALL.vertices[:, 2] < -0.5).tolist())
    assert organs_below_ground(scene_of(height=0.5, fixed_nodes=low)) == ""
    assert organs_below_ground(scene_of(height=0.5)) != ""


@pytest.mark.parametrize(
    ("height", "told"), [(1.0, True), (0.0, True), (2.03, True), (2.1, False), (4.0, False), (np.nan, False)]
)
def test_tools_in_organs_are_told(height, told):
    far = PlacedOrgan(BALL, (9.0, 0.0, 1.0))
    scene = replace(scene_of(), organs=(far, *scene_of().organs))
    nodes = np.concatenate([placed.vertices for placed in scene.organs])
    position, orientation = np.array([[0.0, 0.0, height]]), np.array([[0.0, 0.0, 0.0, 1.0]])
    found = tools_in_organs(scene.organs, nodes, scene.tools, position, orientation)
    assert found.startswith("tool 0 was in organ 'icosphere' at the start") == told
    assert (found == "") != told


def test_an_organ_below_the_ground_is_said_to_be_there():
    with pytest.raises(SimulationDiverged, match="starts with 42 of 42 free nodes below the ground") as caught:
        Simulation(scene_of(height=-5.0), engine="batch")
    assert "gravity" not in str(caught.value)


@pytest.mark.parametrize("placed_later", [False, True])
def test_a_tool_that_starts_in_an_organ_is_said_to_have_been_there(placed_later):
    simulation = Simulation(scene_of(tool_height=4.0 if placed_later else 1.0), engine="batch")
    if placed_later:
        simulation.place_tool((0.0, 0.0, 1.0))
    simulation.step()
    # As if physics had broken down: whatever an organ does around a tool, this is what is likely to be the cause.
    simulation.worlds.state.nodes[0, :, 2] *= -1.0
    told = simulation.worlds.why_diverged(0)
    assert "'icosphere' has turned inside out; tool 0 was in organ 'icosphere' at the start" in told
    assert "gravity" not in told
    # Another start, another cause.
    simulation.reset()
    simulation.place_tool((0.0, 0.0, 4.0))
    simulation.step()
    simulation.worlds.state.nodes[0, :, 2] *= -1.0
    assert "gravity may be too strong" in simulation.worlds.why_diverged(0)
    simulation.close()


def test_where_tools_were_is_not_guessed_in_a_state_of_a_later_time():
    simulation = Simulation(scene_of(), engine="batch")
    simulation.step()
    state = simulation.save()
    inside = replace(state, tool_positions=np.array([[0.0, 0.0, 1.0]]))
    simulation.restore(inside)
    simulation.worlds.move(np.zeros((1, 1, 3)), np.zeros((1, 1, 3)))
    assert "tool 0" not in simulation.worlds.why_diverged(0)
    simulation.close()

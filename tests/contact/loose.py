"""Contact alone: organs of loose nodes, that fly on as they are until a tool meets them."""

from __future__ import annotations

import numpy as np

from spatula_env import scenes
from spatula_env.contact.model import ContactModel, Motions
from spatula_env.geometry.transforms import integrate_rotation

DT = 1.0 / 240.0


class LooseOrgans:
    """Organs and tools of a scene without an engine; nodes of equal mass, unless told."""

    def __init__(self, organs, tools, masses=None, *, ground=None, gravity=0.0, friction=0.0, first_step="inside"):
        self.scene = scenes.Scene(
            organs=tuple(scenes.PlacedOrgan(organ, mass=float(len(organ.vertices))) for organ in organs),
            tools=tuple(
                scenes.PlacedTool(tool, position, orientation, friction) for tool, position, orientation in tools
            ),
            ground=ground,
            gravity=gravity,
            dt=DT,
        )
        self.nodes = np.concatenate([organ.vertices for organ in organs])
        self.velocities = np.zeros_like(self.nodes)
        self.masses = np.ones(len(self.nodes)) if masses is None else np.array(masses, dtype=np.float64)
        self.model = ContactModel(self.scene, 1.0 / self.masses, first_step)
        self.positions = np.array([placed.position for placed in self.scene.tools])
        self.orientations = np.array([placed.orientation for placed in self.scene.tools])

    def step(self, linear=(0.0, 0.0, 0.0), angular=(0.0, 0.0, 0.0), moved=None):
        """One step: the tools by their velocities, the nodes by theirs or to where they are `moved`."""
        shape = self.positions.shape
        linear = np.array(np.broadcast_to(np.asarray(linear, dtype=np.float64), shape))
        angular = np.array(np.broadcast_to(np.asarray(angular, dtype=np.float64), shape))
        turned = np.array([integrate_rotation(*pair, DT) for pair in zip(self.orientations, angular, strict=True)])
        motions = Motions(self.positions, self.orientations, self.positions + linear * DT, turned, linear, angular)
        free = self.nodes + self.velocities * DT if moved is None else np.array(moved)
        self.nodes, self.velocities = self.model.resolve(self.nodes, free, self.velocities.copy(), motions)
        self.positions, self.orientations = motions.positions, motions.orientations
        return self.model

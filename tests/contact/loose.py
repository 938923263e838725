"""Contact without an engine: organs of unconnected nodes, which keep their velocities until a tool meets them."""

from __future__ import annotations

import numpy as np

from spatula_env import scenes
from spatula_env.contact import settings
from spatula_env.contact.flags import FIRST_STEP_CODES, FlaggedDetector
from spatula_env.contact.motion import Motions, OrganMotion, StepOutcome
from spatula_env.contact.pressure import contact_table
from spatula_env.contact.step import resolve_step
from spatula_env.contact.structures import surface_list
from spatula_env.contact.world import Workspace, World, scene_skin
from spatula_env.geometry.transforms import integrate_rotation

DT = 1.0 / 240.0


class LooseOrgans:
    """Organs and tools of a scene without an engine; nodes have equal masses unless `masses` are given.

    The results of each step are `residual`, `nodal_impulses` (V, 3), `wrenches` (N, 6), averaged over the step, and
    `contact_table`. `detectors` has a row for each tool, with a detector for each organ; `world` is what kernels get.
    """

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
        self.positions = np.array([placed.position for placed in self.scene.tools])
        self.orientations = np.array([placed.orientation for placed in self.scene.tools])
        self.detectors = [[FlaggedDetector(tool, first_step) for _ in organs] for tool, _, _ in tools]
        for row in self.detectors:
            for detector, organ in zip(row, organs, strict=True):
                detector.memory.resize(len(organ.vertices), len(organ.triangles))
        memories = [detector.memory for row in self.detectors for detector in row]
        surfaces = surface_list([np.array(organ.triangles) for organ in organs])
        self.world = World(
            self.scene, [row[0].shape for row in self.detectors], memories, surfaces, scene_skin(self.scene),
            1.0 / self.masses, Workspace(), True,
        )  # fmt: skip
        self._first_step = FIRST_STEP_CODES[first_step]
        self._numbers, self._impulses = np.zeros(settings.RESULT_LENGTH), np.zeros((len(tools) + 1, 6))
        self.residual = 0.0
        self.nodal_impulses, self.wrenches = np.zeros_like(self.nodes), np.zeros((len(tools), 6))

    def step(self, linear=(0.0, 0.0, 0.0), angular=(0.0, 0.0, 0.0), moved=None):
        """Make one step: tools move by their velocities, nodes by theirs, or to the positions `moved`."""
        shape = self.positions.shape
        linear = np.array(np.broadcast_to(np.asarray(linear, dtype=np.float64), shape))
        angular = np.array(np.broadcast_to(np.asarray(angular, dtype=np.float64), shape))
        turned = np.array([integrate_rotation(*pair, DT) for pair in zip(self.orientations, angular, strict=True)])
        motions = Motions(self.positions, self.orientations, self.positions + linear * DT, turned, linear, angular)
        free = self.nodes + self.velocities * DT if moved is None else np.array(moved)
        nodes, velocities, self.nodal_impulses = np.empty((3, *self.nodes.shape))
        status = resolve_step(
            self.world.structure,
            self._first_step,
            motions,
            OrganMotion(self.nodes, free, self.velocities, nodes, velocities),
            StepOutcome(self.nodal_impulses, self._impulses, self._numbers),
        )
        if status != 0:
            raise FloatingPointError("the nodes' or the tools' positions are not finite")
        self.nodes, self.velocities = nodes, velocities
        self.positions, self.orientations = motions.positions, motions.orientations
        self.residual, self.wrenches = float(self._numbers[settings.RESIDUAL]), self._impulses[:-1] / DT

    def contact_table(self):
        """(C, 8) contacts that pushed in the last step; see `pressure.contact_table`."""
        return contact_table(self.world.workspace.constraints, int(self._numbers[settings.CONTACT_COUNT]))

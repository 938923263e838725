"""One world of a scene for the contact kernels: its arrays, and what is remembered of its contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from spatula_env.contact import energy, settings
from spatula_env.contact.energy import LEDGER_LENGTH
from spatula_env.contact.multipliers import MOST_PASSED
from spatula_env.contact.near import find_as_before
from spatula_env.contact.self_contact import leave_out, touching_pairs
from spatula_env.contact.skin import copy_near, crossed_for, forget_near, make_near, make_skin, set_crossed_for
from spatula_env.contact.structures import (
    copy_constraints,
    fit_room,
    make_constraints,
    make_room,
    make_world_contacts,
    memory_list,
    replace_tool,
    restore_constraints,
    tool_list,
)
from spatula_env.contact.tangles import place

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.arrays import FloatArray
    from spatula_env.contact.structures import Memory
    from spatula_env.scenes import Scene

FIRST_ROOM = 256
"""Initial capacity of the arrays of constraints."""

Multipliers = tuple["NDArray[Any]", "NDArray[Any]", "NDArray[Any]"]
"""Multipliers from which the next position solve starts: names, features and rows of constraints."""


class NearMemory(NamedTuple):
    """Memory of organs that are near themselves or each other; see `skin.Near`.

    Attributes:
        found_at: (3, V) positions of the nodes when the near pairs were found [u].
        reach: (V,) how far they may get from there before the pairs are found anew [u].
        cones: (P, 4) cones around the normals of patches of the surfaces.
        patch_pairs: Pairs of patches that may meet.
        is_known: Whether any of this is known.
        crossed_for: For how long organs have crossed themselves or each other [s].
    """

    found_at: FloatArray
    reach: FloatArray
    cones: FloatArray
    patch_pairs: NDArray[np.int64]
    is_known: bool
    crossed_for: float


ORGAN_FRICTION = 0.1
"""Coefficient of friction of organs with themselves and each other: wet surfaces slide."""


@dataclass(frozen=True)
class ContactMemory:
    """Memory of the contacts of a world from one step to the next.

    Attributes:
        flags: Flags of the contact nodes, for each tool (outer) and organ (inner).
        multipliers: Names, features and rows of the constraints from which the next solve starts.
        ledger: (O, 5) ledger of the energy that the tools put into each organ; see `energy`.
        wrenches: (N, 6) force and torque on each tool, averaged over the last step [kg u/s2, kg u2/s2].
        near: Memory of organs that are near themselves or each other.
        pace: Fraction of their motion that the tools carry out in the next step; see `step.slow_tools`.
    """

    flags: tuple[tuple[NDArray[np.bool_], ...], ...]
    multipliers: Multipliers
    ledger: FloatArray
    wrenches: FloatArray
    near: NearMemory
    pace: float = 1.0


def _mean_edge(scene: Scene) -> float:
    """The smallest mean edge of any organ of a scene [u]."""
    return min(float(placed.organ.edge_lengths.mean()) for placed in scene.organs)


def scene_skin(scene: Scene) -> Any:
    """The `Skin` of a scene's organs, with pairs of features that touch in the organs' initial shapes excluded."""
    organs = [placed.organ for placed in scene.organs]
    skin = make_skin([np.array(organ.triangles) for organ in organs], [len(organ.vertices) for organ in organs])
    vertices = np.concatenate([placed.vertices for placed in scene.organs])
    leave_out(skin, touching_pairs(skin, make_near(skin), vertices, _mean_edge(scene)))
    return skin


class Workspace:
    """Workspace for one query at a time, which worlds that are queried one after the other can share.

    Attributes:
        constraints: Constraints of the query.
        earlier: Constraints of earlier queries in the same step.
        trial: Constraints of the last position solve in the same query.
        room: `ScratchRoom` of kernels.
    """

    def __init__(self) -> None:
        """Allocate the arrays."""
        self.constraints = make_constraints(FIRST_ROOM)
        self.earlier = make_constraints(MOST_PASSED)
        self.trial = make_constraints(FIRST_ROOM)
        self.room = make_room()


class World:
    """The contact of one world: a `WorldContacts` and the arrays in it.

    Attributes:
        memories: `Memory` of each tool (outer) and organ (inner).
        friction: (N,) coefficients of the tools.
        settings: (10,) indexed by the column names of `settings`.
        inverse_masses: (V,) of the organs' nodes [1/kg].
        ledger: (O, 5) ledger of the energy that the tools put into each organ; see `energy`.
        pace: (1,) fraction of their motion that the tools carry out in the next step; see `step.slow_tools`.
        workspace: `Workspace` of a query.
        structure: The `WorldContacts` for kernels.
    """

    def __init__(
        self,
        scene: Scene,
        shapes: Sequence[Any],
        memories: Sequence[Memory],
        surfaces: Any,
        skin: Any,
        inverse_masses: FloatArray,
        workspace: Workspace,
        keeps_apart: bool = True,
    ) -> None:
        """Prepare for a scene.

        Args:
            scene: The scene, with its tools, organs and ground.
            shapes: `ToolShape` of each tool.
            memories: `Memory` of each tool (outer) and organ (inner).
            surfaces: List of the organs' triangles, for kernels.
            skin: `Skin` of all organs; see `scene_skin`.
            inverse_masses: (V,) of the organs' nodes [1/kg].
            workspace: `Workspace` of a query.
            keeps_apart: Whether organs are kept apart from themselves and each other.
        """
        starts = np.cumsum([0, *(len(placed.organ.vertices) for placed in scene.organs)])
        self.memories = tuple(memories)
        self.friction = np.array([placed.friction for placed in scene.tools], dtype=np.float64)
        self.inverse_masses = inverse_masses.copy()
        self.settings = np.zeros(settings.SETTINGS_LENGTH)
        self.settings[settings.DT] = scene.dt
        self.settings[settings.MEAN_EDGE] = _mean_edge(scene)
        self.settings[settings.GRAVITY] = scene.gravity
        self.settings[settings.ORGAN_FRICTION] = ORGAN_FRICTION
        self.settings[settings.KEEPS_APART] = float(keeps_apart)
        if scene.ground is not None:
            self.settings[settings.HAS_GROUND] = 1.0
            self.settings[settings.GROUND_HEIGHT] = scene.ground.height
            self.settings[settings.GROUND_FRICTION] = scene.ground.friction
        self.set_inverse_masses(inverse_masses)
        self.ledger = np.zeros((len(scene.organs), LEDGER_LENGTH))
        self.pace = np.ones(1)
        self.workspace = workspace
        self._warm = make_constraints(FIRST_ROOM)
        self._warm_count = np.zeros(1, dtype=np.int64)
        self._skin, self._near = skin, make_near(skin)
        self.structure = make_world_contacts(
            tool_list(list(shapes)),
            memory_list([memory.structure for memory in memories]),
            surfaces,
            workspace.constraints,
            workspace.earlier,
            workspace.trial,
            self._warm,
            self._warm_count,
            starts[:-1].astype(np.int64),
            self.friction,
            self.settings,
            self.inverse_masses,
            skin,
            self._near,
            self.ledger,
            self.pace,
            workspace.room,
        )
        fit_room(self.structure)

    def set_inverse_masses(self, inverse_masses: FloatArray) -> None:
        """Change the masses of the organs' nodes (V,) [1/kg]."""
        self.inverse_masses[:] = inverse_masses
        free = inverse_masses[inverse_masses > 0.0]
        self.settings[settings.IS_FREE] = float(len(free) == len(inverse_masses))
        self.settings[settings.MEAN_INVERSE_MASS] = float(free.mean()) if len(free) else 0.0

    def forget_solves(self) -> None:
        """Forget multipliers, ledger, pace and near pairs, so that the next step is solved as a first one.

        Its solves then start from zero, energy is counted anew, and the tools carry out all of their motion.
        """
        self._warm_count[0] = 0
        self.ledger[:] = 0.0
        self.pace[:] = 1.0
        forget_near(self._near)

    def copy_multipliers(self) -> Multipliers:
        """Copy the multipliers from which the next step's solve starts."""
        copied: Multipliers = copy_constraints(self._warm, int(self._warm_count[0]))
        return copied

    def restore_multipliers(self, multipliers: Multipliers) -> None:
        """Restore multipliers that `copy_multipliers` returned."""
        restore_constraints(self._warm, *(part.copy() for part in multipliers))
        self._warm_count[0] = len(multipliers[0])

    @property
    def crossed_for(self) -> float:
        """For how long organs have crossed themselves or each other [s]."""
        return float(crossed_for(self._near))

    def copy_near(self) -> NearMemory:
        """Copy the memory of what is near and of how long organs have crossed."""
        found_at, reach, cones, patch_pairs, is_known = copy_near(self._near)
        return NearMemory(found_at, reach, cones, patch_pairs, bool(is_known), self.crossed_for)

    def restore_near(self, memory: NearMemory, vertices: FloatArray) -> None:
        """Restore a memory that `copy_near` returned.

        Args:
            memory: The memory.
            vertices: (V, 3) positions at which the organs' nodes have been put [u]. If one of them is out of its reach,
                or the surface has folded, the near pairs are found anew in the next step.
        """
        forget_near(self._near)
        if memory.is_known:
            find_as_before(self._skin, self._near, *memory[:4])
            if not place(self._skin, self._near, vertices, bool(self.settings[settings.IS_FREE])):
                forget_near(self._near)
        set_crossed_for(self._near, memory.crossed_for)

    def admit_energy(self, vertices: FloatArray, velocities: FloatArray) -> None:
        """Count the energy that the organs were given when they were put into a state whose ledger has been restored.

        Args:
            vertices: (V, 3) [u].
            velocities: (V, 3) [u/s].
        """
        energy.admit_energy(self.structure, vertices, velocities)

    def set_tool(self, index: int, shape: Any) -> None:
        """Replace a tool of the world by a `ToolShape` with as many contact nodes."""
        replace_tool(self.structure, index, shape)

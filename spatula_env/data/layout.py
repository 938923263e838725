"""The layout of a dataset: names and rates of its numbers, so that reading it needs no physics."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spatula_env.definitions import FIRST, definition_number
from spatula_env.files import checksum

if TYPE_CHECKING:
    import gymnasium

KEY = "spatula_env"
"""Key of a `Layout` in a dataset's metadata."""
VECTOR = "observation"
"""Name of an observation that is a single vector and not a dictionary."""


@dataclass(frozen=True)
class Layout:
    """The layout of a dataset's numbers.

    Attributes:
        observation_names: Names along the last axis of each entry of an observation; the entry of a single vector is
            `VECTOR`. Entries without names, such as pictures, are left out.
        action_names: Names of the numbers of an action.
        control_frequency: Control steps per second; None if that is not known.
        task: What the task asks for, in a sentence.
        scene: Name of the scene in `spatula_env.scenes`.
        lerobot_names: LeRobot's names of the entries of an observation.
        workspace_low: (3,) the corner of the tool's workspace, in which positions are given [m]; empty if not known.
        workspace_high: (3,) the opposite corner [m].
        definition: Number of the definition of the task; None if the data were not recorded by this package.
        organ: Checksum of the file of the organ, if it was not the task's own, else empty.
    """

    observation_names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    action_names: tuple[str, ...] = ()
    control_frequency: float | None = None
    task: str = ""
    scene: str = ""
    lerobot_names: Mapping[str, str] = field(default_factory=dict)
    workspace_low: tuple[float, ...] = ()
    workspace_high: tuple[float, ...] = ()
    definition: int | None = None
    organ: str = ""

    @classmethod
    def of(cls, env: gymnasium.Env[Any, Any]) -> Layout:
        """The layout of an environment; empty if it is not one of this package."""
        made: Any = getattr(env, "unwrapped", env)
        builder, control = getattr(made, "observation_builder", None), getattr(made, "control", None)
        if builder is None or control is None:
            return cls()
        # Imported here because it loads the physics, which an environment of this package has loaded already.
        from spatula_env.envs.observations import lerobot_keys

        goals = tuple(made.task.goal_names)
        named = {part.name: _component_names(part.name, part.size, goals) for part in builder.parts}
        entries: dict[str, tuple[str, ...]] = {}
        whole = tuple(name for names in named.values() for name in names)
        space = env.observation_space
        apart = {
            entry: tuple(name for part in builder.parts if part.sensed is sensed for name in named[part.name])
            for entry, sensed in (("sensors", True), ("privileged", False))
        }
        for entry, inner in getattr(space, "spaces", {VECTOR: space}).items():
            if entry in (VECTOR, "state"):
                names = whole
            elif entry in apart:
                names = apart[entry]
            elif entry in ("achieved_goal", "desired_goal"):
                names = tuple(f"{entry}_{name}" for name in goals)
            else:
                names = named.get(entry, ())
            # A wrapper may have changed the entry.
            if names and inner.shape[-1:] == (len(names),):
                entries[entry] = names
        return cls(
            observation_names=entries,
            action_names=tuple(control.names),
            control_frequency=float(made.settings.control_frequency),
            task=(inspect.getdoc(type(made)) or "").partition("\n")[0],
            scene=made.definition.scene.__name__,
            lerobot_names=lerobot_keys(space),
            workspace_low=tuple(map(float, made.workspace.low)),
            workspace_high=tuple(map(float, made.workspace.high)),
            definition=int(made.task.definition),
            organ="" if made.settings.organ is None else checksum(Path(made.settings.organ)),
        )

    @classmethod
    def from_record(cls, record: Mapping[str, Any] | None) -> Layout:
        """Make a layout from what `as_record` returned; from None, an empty one."""
        if record is None:
            return cls()
        frequency, number = record.get("control_frequency"), record.get("definition", FIRST)
        return cls(
            observation_names={name: tuple(names) for name, names in record.get("observation_names", {}).items()},
            action_names=tuple(record.get("action_names", ())),
            control_frequency=None if frequency is None else float(frequency),
            task=str(record.get("task", "")),
            scene=str(record.get("scene", "")),
            lerobot_names=dict(record.get("lerobot_names", {})),
            workspace_low=tuple(record.get("workspace_low", ())),
            workspace_high=tuple(record.get("workspace_high", ())),
            definition=None if number is None else int(number),
            organ=str(record.get("organ", "")),
        )

    def definition_of(self, env_id: str) -> int:
        """The number of the definition of an environment's task; the present one if the layout has none."""
        return definition_number(env_id) if self.definition is None else self.definition

    def as_record(self) -> dict[str, Any]:
        """The layout as values that JSON can store."""
        return {
            "observation_names": {name: list(names) for name, names in self.observation_names.items()},
            "action_names": list(self.action_names),
            "control_frequency": self.control_frequency,
            "task": self.task,
            "scene": self.scene,
            "lerobot_names": dict(self.lerobot_names),
            "workspace_low": list(self.workspace_low),
            "workspace_high": list(self.workspace_high),
            "definition": self.definition,
            **({"organ": self.organ} if self.organ else {}),
        }

    def find(self, part: str) -> tuple[str, slice] | None:
        """Find a part of three numbers, such as "tool_position": its entry, and the slice of it; None if not there."""
        wanted = _component_names(part, 3, ())
        for entry, names in self.observation_names.items():
            for start in range(len(names) - 2):
                if names[start : start + 3] == wanted:
                    return entry, slice(start, start + 3)
        return None


def _component_names(part: str, size: int, goals: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the numbers of a part."""
    if part in ("goal", "error") and len(goals) == size:
        return tuple(f"{part}_{name}" for name in goals)
    if size == 1:
        return (part,)
    if size == 3:
        return tuple(f"{part}_{axis}" for axis in "xyz")
    if size % 3 == 0:
        return tuple(f"{part}_{index}_{axis}" for index in range(size // 3) for axis in "xyz")
    return tuple(f"{part}_{index}" for index in range(size))

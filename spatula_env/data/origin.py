"""The origin of a dataset: what its episodes must have in common, so that they mean the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import EnvSpec

from spatula_env.data.index import episode_file
from spatula_env.data.layout import KEY, Layout
from spatula_env.data.specs import differences, spec_from_json, storable_spec

if TYPE_CHECKING:
    import gymnasium

MEANING = (
    "observation_names",
    "action_names",
    "control_frequency",
    "workspace_low",
    "workspace_high",
    "definition",
    "organ",
)
"""Fields of a `Layout` on which the meaning of an episode's numbers depends."""


@dataclass(frozen=True)
class Origin:
    """Where episodes come from.

    Attributes:
        spec: Specification with which the environment was made.
        layout: Names of the numbers.
        spaces: "observation_space" and "action_space", as Minari writes them.
    """

    spec: EnvSpec
    layout: Layout
    spaces: Mapping[str, str]

    @classmethod
    def of(cls, env: gymnasium.Env[Any, Any], layout: Layout | None = None) -> Origin:
        """The origin of the episodes of an environment.

        Args:
            env: An environment from `gymnasium.make`.
            layout: Names of the numbers; None takes them from `env`.

        Raises:
            ImportError: If Minari is missing.
            ValueError: If `env` has a specification that cannot be stored.
        """
        from minari.serialization import serialize_space

        return cls(
            spec=storable_spec(env),
            layout=layout if layout is not None else Layout.of(env),
            spaces={
                "observation_space": serialize_space(env.observation_space),
                "action_space": serialize_space(env.action_space),
            },
        )

    def check(
        self, metadata: Mapping[str, Any], dataset_id: str, folder: Path, *, several_settings: bool = False
    ) -> None:
        """Check that the episodes of a dataset have the same origin.

        Args:
            metadata: Metadata of the dataset.
            dataset_id: Its id, for errors.
            folder: Its folder.
            several_settings: Whether options of the environment may differ, as long as the numbers mean the same.

        Raises:
            ValueError: If they do not; names what differs.
        """
        elsewhere = f"take another name or delete {folder}"
        stored = spec_from_json(metadata.get("env_spec"))
        apart = differences(self.spec, stored)
        if stored.id != self.spec.id:
            raise ValueError(f"dataset {dataset_id!r} has episodes of {stored.id}, not of {self.spec.id}; {elsewhere}")
        for name, value in self.spaces.items():
            if metadata.get(name) != value:
                told = f", as the options differ in {'; '.join(apart)}" if apart else ""
                raise ValueError(
                    f"dataset {dataset_id!r} has episodes with another {name.replace('_', ' ')}{told}; {elsewhere}"
                )
        if apart and not several_settings:
            raise ValueError(
                f"dataset {dataset_id!r} has episodes with other options, which differ in {'; '.join(apart)}: give "
                f"the same, or {elsewhere}"
            )
        known = Layout.from_record(metadata.get(KEY))
        if Layout() not in (known, self.layout):
            unlike = [name for name in MEANING if getattr(known, name) != getattr(self.layout, name)]
            if unlike:
                names = ", ".join(unlike).replace("_", " ")
                raise ValueError(f"dataset {dataset_id!r} has episodes with another {names}; {elsewhere}")
        if metadata["total_episodes"] and not episode_file(folder / "data", 0).exists():
            raise ValueError(f"dataset {dataset_id!r} was not written by this program; take another name")

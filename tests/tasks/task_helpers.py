"""Settings for tests of the tasks: the organs of their scenes, before these have come to rest."""

from __future__ import annotations

from functools import cache

from spatula_env.envs.clamp import CLAMP
from spatula_env.envs.fissure import FISSURE
from spatula_env.envs.palpate import PALPATE
from spatula_env.envs.press import PRESS
from spatula_env.envs.retract import RETRACT
from spatula_env.envs.settings import Definition
from spatula_env.envs.workspace import place_workspace, setting_of
from spatula_env.tasks import Setting

DEFINITIONS: dict[str, Definition] = {each.name: each for each in (PRESS, RETRACT, FISSURE, CLAMP, PALPATE)}


@cache
def setting_of_task(name: str) -> Setting:
    definition = DEFINITIONS[name]
    scene = definition.scene()
    return setting_of(scene, place_workspace(scene, scene.organs[0].vertices, definition.workspace_height))

"""Scene and task of an environment: the task's own, or on an organ from a file, made of a material if one is given."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from spatula_env.engines import load_engine
from spatula_env.geometry.loading import load_organ
from spatula_env.geometry.prepared import PreparedOrgan
from spatula_env.scenes import Material, with_material
from spatula_env.sim.calibration import calibrated
from spatula_env.sim.scene_checks import wave_passage

if TYPE_CHECKING:
    from spatula_env.envs.settings import Definition, EnvSettings
    from spatula_env.scenes import Scene
    from spatula_env.tasks.base import Task
    from spatula_env.tasks.situation import Setting

CALM_PASSAGE = 0.3
"""Longest way of a shear wave in a step, by the mean edge of a surface, on an organ of one's own."""


def scene_of(definition: Definition, settings: EnvSettings) -> Scene:
    """Make the scene of an environment.

    An organ of one's own has forces as of brain tissue: with springs, whose stiffness is measured for that, which
    takes seconds; with a material they follow from it.

    Args:
        definition: Scene and task.
        settings: From `Definition.read`.

    Raises:
        FileNotFoundError: If there is no file of the organ.
        ValueError: If it is not what it should be, or does not bear the tool.
    """
    if settings.organ is None:
        scene = definition.scene()
        return scene if settings.material is None else with_material(scene, settings.material)
    own = definition.own_organ
    assert own is not None
    assert settings.engine is not None
    organ = load_organ(settings.organ)
    assert isinstance(organ, PreparedOrgan)
    scene = own.scene(organ)
    if settings.material is not None:
        scene = with_material(scene, settings.material)
    abilities = load_engine(settings.engine).abilities
    if abilities.springs:
        vertices = scene.organs[0].organ.vertices
        return calibrated(scene, place=vertices[vertices[:, 2].argmax(), :2])
    return with_short_steps(scene) if abilities.materials else scene


def with_short_steps(scene: Scene) -> Scene:
    """Divide the physics step of a scene until a shear wave is slow enough for contact with its organ.

    Contact is resolved once in a step. With longer steps the force on a tool shakes, the more so the stiffer an organ
    and the finer its surface.

    Args:
        scene: A scene with one organ, whose material is `Material()` if it has none.
    """
    placed = scene.organs[0]
    material = Material() if placed.material is None else placed.material
    wave_speed = math.sqrt(material.shear_modulus / material.density) / scene.scale.length
    passage = wave_passage(placed.organ, wave_speed, scene.dt)
    return replace(scene, dt=scene.dt / max(1, math.ceil(passage / CALM_PASSAGE)))


def task_of(definition: Definition, settings: EnvSettings, setting: Setting) -> Task:
    """Make the task of an environment, of the task's own organ or of one from a file.

    Args:
        definition: Scene and task.
        settings: From `Definition.read`.
        setting: Setting of the scene.

    Raises:
        ValueError: If the task cannot be set on the organ; the message says why.
    """
    if settings.organ is None:
        return definition.task(settings.task, setting)
    assert definition.own_organ is not None
    return definition.own_organ.task(settings.task, setting)

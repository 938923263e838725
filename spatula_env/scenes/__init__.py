"""Scenes: organs, tools, ground, and the scale that turns scene units into SI.

`seed`, `retract`, `fissure`, `clamp` and `palpate` are presets; any other scene is built from `Scene` and its parts.
"""

from __future__ import annotations

from spatula_env.scenes.base import (
    STANDARD_DENSITY,
    TISSUE_MODULUS,
    Ground,
    PlacedOrgan,
    PlacedTool,
    Scale,
    ScaleName,
    Scene,
    lying_as_material,
    with_material,
)
from spatula_env.scenes.clamp import JAW_CLEARANCE, clamp
from spatula_env.scenes.fissure import FISSURE_CLEARANCE, ON_EDGE, fissure
from spatula_env.scenes.material import BrainRegion, Material, ModelName, as_material
from spatula_env.scenes.own_lines import organ_with_fissure, organ_with_ridge
from spatula_env.scenes.own_organ import organ_from_above, organ_from_aside, own_organ
from spatula_env.scenes.palpate import palpate
from spatula_env.scenes.retract import BLADE_CLEARANCE, QUARTER_TURN, UPRIGHT, retract
from spatula_env.scenes.seed import RESTING_SPHERE, RESTING_TISSUE, seed

__all__ = [
    "BLADE_CLEARANCE",
    "FISSURE_CLEARANCE",
    "JAW_CLEARANCE",
    "ON_EDGE",
    "QUARTER_TURN",
    "RESTING_SPHERE",
    "RESTING_TISSUE",
    "STANDARD_DENSITY",
    "TISSUE_MODULUS",
    "UPRIGHT",
    "BrainRegion",
    "Ground",
    "Material",
    "ModelName",
    "PlacedOrgan",
    "PlacedTool",
    "Scale",
    "ScaleName",
    "Scene",
    "as_material",
    "clamp",
    "fissure",
    "lying_as_material",
    "organ_from_above",
    "organ_from_aside",
    "organ_with_fissure",
    "organ_with_ridge",
    "own_organ",
    "palpate",
    "retract",
    "seed",
    "with_material",
]

"""Shapes, without physics: organ surfaces, tools with their contact nodes, and rotations.

Organs are closed triangle surfaces (:class:`Organ`), tools are rigid convex bodies that carry contact nodes
(:class:`Tool`), and :mod:`~spatula_env.geometry.transforms` has the quaternion arithmetic between their
frames.
"""

from __future__ import annotations

from spatula_env.geometry.blocks import FissuredBlock, RidgedBlock, fissured_block, ridged_block
from spatula_env.geometry.hull import convex_hull
from spatula_env.geometry.loading import load_organ
from spatula_env.geometry.meshes import Organ, box_surface, icosphere, seed_sphere, torus
from spatula_env.geometry.prepared import PreparedOrgan
from spatula_env.geometry.surface import check_surface
from spatula_env.geometry.tools import Tool

__all__ = [
    "FissuredBlock",
    "Organ",
    "PreparedOrgan",
    "RidgedBlock",
    "Tool",
    "box_surface",
    "check_surface",
    "convex_hull",
    "fissured_block",
    "icosphere",
    "load_organ",
    "ridged_block",
    "seed_sphere",
    "torus",
]

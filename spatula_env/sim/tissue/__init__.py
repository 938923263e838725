"""Organs that are a material: nearly incompressible hyperelastic solids, by finite elements."""

"""Organs made of a material: nearly incompressible hyperelastic solids, discretised by finite elements."""

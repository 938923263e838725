"""Organs as MuJoCo's flexes: tetrahedra of a Neo-Hookean solid, in contact by this package's own model."""

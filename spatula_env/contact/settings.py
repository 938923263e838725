"""Names of the columns of a world's settings, and of the numbers that result from resolving a step."""

from __future__ import annotations

SETTINGS_LENGTH = 10
DT, MEAN_EDGE, HAS_GROUND, GROUND_HEIGHT, GROUND_FRICTION, MEAN_INVERSE_MASS, GRAVITY = 0, 1, 2, 3, 4, 5, 6
ORGAN_FRICTION, KEEPS_APART, IS_FREE = 7, 8, 9
"""Columns of the settings: length of a step [s], mean edge of the organ with the smallest mean edge [u], whether there
is ground, its height [u] and coefficient of friction, mean inverse mass of the free nodes [1/kg], gravity [u/s2],
coefficient of friction between organs, whether organs are kept apart from themselves and each other, whether no node is
held."""

PENETRATION, RESIDUAL, QUERIES, CONTACT_COUNT, CROSSINGS, CROSSED_FOR, STOPPED = 0, 1, 2, 3, 4, 5, 6
RESULT_LENGTH = 7
"""Columns of the result: greatest depth of a contact node in an organ before the response [u], greatest depth left
after it [u], number of queries, number of constraints, number of crossings of organs, for how long organs have crossed
[s], whether the tools were stopped or slowed."""

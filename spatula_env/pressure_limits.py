"""Pressures that tissue bears, from the literature."""

from __future__ import annotations

COST_PRESSURE = 2670.0
"""Pressure above which a dose is counted, 20 mmHg [Pa]. Rats whose brains were retracted with no more for 15 minutes
were spared damage (J. Rosenorn and N. Diemer, J Neurosurg 63:608, 1985): this is a dose, not a momentary limit."""

VIOLATION_PRESSURE = 4000.0
"""Pressure that is flagged, 30 mmHg [Pa]: with it, for the same time, five brains of six had infarcts (same source)."""

HARMFUL_PRESSURE = 5330.0
"""Pressure that ends an episode at the level "hard", 40 mmHg [Pa]: with it, for the same time, all of six brains had
infarcts (same source)."""

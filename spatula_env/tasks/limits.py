"""Pressures that tissue bears, from the literature."""

from __future__ import annotations

COST_PRESSURE = 2670.0
"""Pressure from which on a dose is counted, 20 mmHg [Pa]. Rats whose brains were retracted with no more for 15 minutes
were spared damage (J. Rosenorn and N. Diemer, J Neurosurg 63:608, 1985): that is a dose, and no limit for a moment."""

VIOLATION_PRESSURE = 4000.0
"""Pressure that is flagged, 30 mmHg [Pa]: with it, for as long, five brains of six had infarcts (the same source)."""

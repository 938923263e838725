"""What to call the outcome of a press."""

from __future__ import annotations

from typing import Literal

Verdict = Literal["contact", "unstable", "inside"]

GREATEST_RESIDUAL = 0.01
"""In contact, no part of the organ's surface over the tool is farther above its lower face than this [u]."""

GREATEST_RIPPLE = 0.05
"""In contact, the force's standard deviation is no greater than this part of its mean."""

LEAST_INSIDE_SHARE = 0.5
"""Inside, the tool's centre was inside the organ in more than this part of the time that the tool was held."""

CRITERIA = {
    "contact": (
        f"the organ's surface is nowhere more than {GREATEST_RESIDUAL:g} u above the tool's lower face, the force on "
        f"the tool points up and its standard deviation is at most {GREATEST_RIPPLE:.0%} of its mean (the last 100 "
        "steps), and in no step of the run both nodes of a pair were flagged"
    ),
    "inside": (
        f"otherwise, if the tool's centre was inside the organ in more than {LEAST_INSIDE_SHARE:.0%} of the steps in "
        "which the tool was held"
    ),
    "unstable": "everything else",
}
"""The criteria in words, in the order in which they are applied."""


def judge(
    *,
    residual: float | None,
    force_mean: float,
    force_deviation: float,
    pairs_steps: int,
    inside_share: float,
    diverged: bool = False,
) -> Verdict:
    """Judge a press.

    Args:
        residual: Greatest height of the organ's surface over the tool's lower face [u], negative where all of it is
            below; None if there is no organ over the tool or under it.
        force_mean: Mean of the upward force on the tool, in any unit.
        force_deviation: Its standard deviation, in the same unit.
        pairs_steps: Steps in which both nodes of a pair were flagged.
        inside_share: Part of the held steps in which the tool's centre was inside the organ.
        diverged: Whether positions stopped being finite.

    Returns:
        "contact", "inside" or "unstable"; see `CRITERIA`.
    """
    if diverged:
        return "unstable"
    surface_holds = residual is not None and residual <= GREATEST_RESIDUAL
    force_holds = force_mean > 0.0 and force_deviation <= GREATEST_RIPPLE * force_mean
    if surface_holds and force_holds and pairs_steps == 0:
        return "contact"
    return "inside" if inside_share > LEAST_INSIDE_SHARE else "unstable"

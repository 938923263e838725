"""Organs from anatomy: a surface or a labelled volume of a segmentation becomes an organ that can be manipulated.

:func:`prepare_organ` does what the command `spatula organ prepare` does. Needs the extra ``anatomy``; an organ that was
prepared is read by :func:`spatula_env.geometry.load_organ`, without it.
"""

from __future__ import annotations

from spatula_env.anatomy.options import PrepareOptions, Report, Step
from spatula_env.anatomy.preparing import prepare_organ

__all__ = ["PrepareOptions", "Report", "Step", "prepare_organ"]

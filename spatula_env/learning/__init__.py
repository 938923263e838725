"""Training, cloning and evaluating policies."""

from __future__ import annotations

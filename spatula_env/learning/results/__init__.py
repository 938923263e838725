"""The training results in the documentation: planned, computed, evaluated, and written as a page."""

from __future__ import annotations

"""The documentation's results of training: planned, made, evaluated, and written as a page."""

from __future__ import annotations

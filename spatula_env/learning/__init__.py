"""Policies and how to train, clone and evaluate them."""

from __future__ import annotations

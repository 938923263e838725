"""What the documentation says of training: what is planned, made, evaluated and told on its page."""

from __future__ import annotations

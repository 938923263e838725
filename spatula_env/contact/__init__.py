"""The seed's contact algorithm: detection by the flags method, and the response to it."""

from __future__ import annotations

from spatula_env.contact.flags import Contacts, FlaggedDetector

__all__ = ["Contacts", "FlaggedDetector"]

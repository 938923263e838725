"""Commands that install missing extras; they depend on where this package was installed from."""

from __future__ import annotations

import json
import os
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

DISTRIBUTION = "spatula-env"

QUOTE = '"' if os.name == "nt" else "'"
"""Quotation mark that shells need around a word with brackets and spaces."""


def install_hint(*extras: str) -> str:
    """The command that installs extras of this package, from where the package itself came from.

    Args:
        *extras: Names of extras, such as "train"; pyproject.toml lists what they contain.

    Returns:
        Such as ``pip install 'spatula-env[train]'``; from a checkout ``pip install -e '/path/of/checkout[train]'``.
    """
    wanted = f"[{','.join(extras)}]"
    options, before, after = _origin()
    return f"pip install {options}{QUOTE}{before}{wanted}{after}{QUOTE}"


@cache
def _origin() -> tuple[str, str, str]:
    """Options of pip, and the text before and after the extras, for this installation."""
    return origin_of(_direct_url(), Path(__file__).parents[1])


def origin_of(direct_url: dict[str, Any] | None, place: Path) -> tuple[str, str, str]:
    """Determine where to install from.

    Args:
        direct_url: What pip has recorded of an installation from elsewhere than an index; None: nothing.
        place: The folder that contains this package.

    Returns:
        Options of pip, and the text before and after the extras.
    """
    if (place / "pyproject.toml").is_file():
        return "-e ", str(place), ""
    if direct_url is None:
        return "", DISTRIBUTION, ""
    url = str(direct_url["url"])
    if "vcs_info" in direct_url:
        told = direct_url["vcs_info"]
        return "", DISTRIBUTION, f" @ {told['vcs']}+{url}@{told.get('requested_revision') or told['commit_id']}"
    if "dir_info" in direct_url:
        # Imported locally, like importlib.metadata below: these imports take longer than all else in a short command.
        from urllib.request import url2pathname

        folder = Path(url2pathname(unquote(urlsplit(url).path)))
        if not folder.is_dir():
            return "", DISTRIBUTION, ""
        return "", str(folder), ""
    return "", DISTRIBUTION, f" @ {url}"


def _direct_url() -> dict[str, Any] | None:
    """What pip has recorded of the installation's origin, see PEP 610; None: nothing."""
    from importlib import metadata

    try:
        text = metadata.distribution(DISTRIBUTION).read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        return None
    told: dict[str, Any] | None = json.loads(text) if text else None
    return told

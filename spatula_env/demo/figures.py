"""Renews what the documentation shows: `python -m spatula_env.demo.figures`, in the repository's root.

It draws the pictures in docs/images and puts the comparison's table into README.md.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

from spatula_env.demo import require_extra
from spatula_env.engines import import_bullet

TABLE_PLACE = re.compile(r"(?<=<!-- comparison -->\n).*?(?=<!-- end of comparison -->)", re.DOTALL)
"""Where the table is in a document: between two comments, each on a line of its own."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the comparison and write pictures and table.

    Args:
        arguments: Of the command line.

    Raises:
        ImportError: If the extra "demo" or PyBullet is not installed.
        ValueError: If the document has no place for the table.
    """
    parser = argparse.ArgumentParser(prog="python -m spatula_env.demo.figures", description=__doc__)
    parser.add_argument("--images", type=Path, default=Path("docs/images"), help="folder (default: %(default)s)")
    parser.add_argument(
        "--document", type=Path, default=Path("README.md"), help="with the table (default: %(default)s)"
    )
    chosen = parser.parse_args(arguments)
    require_extra()

    from spatula_env.demo.pictures import figure, side_by_side
    from spatula_env.demo.report import markdown_table
    from spatula_env.demo.runner import comparison_cases, encode_png, figure_results, film_gif, prepare_folder
    from spatula_env.demo.workers import start_workers, submit_cases
    from spatula_env.files import write_bytes, write_text

    text = chosen.document.read_text(encoding="utf-8")
    replace_table(text, "")
    import_bullet("the figure of three contact models")
    prepare_folder(chosen.images)
    with start_workers() as pool:
        futures = submit_cases(pool, comparison_cases("bullet"), lambda case: None)
        film = pool.submit(film_gif, "bullet", 310, 8)
        results = [future.result() for future in futures]
        pages = [figure(result, width=480, text_scale=1.45) for result in figure_results(results)]
        write_bytes(chosen.images / "contact-models.png", encode_png(side_by_side(pages)))
        write_bytes(chosen.images / "press.gif", film.result())
    write_text(chosen.document, replace_table(text, markdown_table(results)))


def replace_table(text: str, table: str) -> str:
    """A document with another table.

    Args:
        text: Of the document.
        table: To stand between the two comments.

    Raises:
        ValueError: If the comments are not there.
    """
    renewed, count = TABLE_PLACE.subn(lambda _: table, text)
    if count != 1:
        raise ValueError(f"the document must have one place for the table, has {count}: {TABLE_PLACE.pattern}")
    return renewed


if __name__ == "__main__":
    main()

from __future__ import annotations

from pathlib import Path

import pytest

from spatula_env.demo.figures import main, replace_table

BEFORE = "Text.\n\n<!-- comparison -->\n| old |\n<!-- end of comparison -->\n\nMore.\n"


def test_only_the_table_is_replaced() -> None:
    after = replace_table(BEFORE, "| new |\n| --- |\n")
    assert after == BEFORE.replace("| old |\n", "| new |\n| --- |\n")
    assert replace_table(after, "| old |\n") == BEFORE


@pytest.mark.parametrize("text", ["", "<!-- comparison -->\n", BEFORE + BEFORE])
def test_a_document_without_one_place_is_refused(text: str, tmp_path: Path) -> None:
    document = tmp_path / "README.md"
    document.write_text(text)
    with pytest.raises(ValueError, match="one place for the table"):
        main(["--document", str(document), "--images", str(tmp_path / "images")])
    assert document.read_text() == text
    assert not (tmp_path / "images").exists()


def test_the_readme_has_the_place() -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    assert replace_table(readme, "") != readme

"""Escaping. Oracles: parsers of each language, and what a text looks like after them."""

from __future__ import annotations

import csv
import io
import xml.etree.ElementTree as xml
from html.parser import HTMLParser

from hypothesis import given
from hypothesis import strategies as st
from matplotlib.cbook import is_math_text

from robocar.core.text import csv_cell, figure_text, html_text, markdown_cell, markdown_text, one_line, printable, xml_text

ANYTHING = st.text(st.characters(codec=None), max_size=30)  # with control characters and halves of surrogate pairs


class _Texts(HTMLParser):
    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


@given(ANYTHING)
def test_every_language_gets_back_the_text(text: str) -> None:
    shown = printable(text)
    assert shown.encode().decode() == shown
    assert all(c.isprintable() or c in "\n\t" for c in shown)
    assert "\n" not in one_line(text)
    html = _Texts()
    html.feed(f"<p>{html_text(text)}</p>")
    assert (html.tags, html.text) == (["p"], shown)
    node = xml.Element("a", name=xml_text(text))
    node.text = xml_text(text)
    assert xml.fromstring(xml.tostring(node)).text in (xml_text(text), None if not xml_text(text) else xml_text(text))
    assert not is_math_text(figure_text(text))
    assert figure_text(text).replace(r"\$", "$").strip() == one_line(text).strip()
    cell = csv_cell(text)
    assert not str(cell).lstrip().startswith(("=", "+", "-", "@"))
    lines = io.StringIO(newline="")
    csv.writer(lines).writerow([cell, "end"])
    assert list(csv.reader(io.StringIO(lines.getvalue(), newline=""))) == [[cell, "end"]]


def test_numbers_are_no_formulas() -> None:
    assert [csv_cell(value) for value in (-1.5, 3, None, "=1+1", " @x", "a-b")] == [-1.5, 3, None, "'=1+1", "' @x", "a-b"]


def test_markdown() -> None:
    """By hand, after CommonMark 0.31, section 2.4: a backslash before punctuation is the punctuation."""
    assert markdown_text("a|b *c* [x](y) <i> `d`\n# e") == r"a\|b \*c\* \[x\]\(y\) \<i\> \`d\` \# e"
    assert markdown_cell("`a`|b <i>\n**c**") == r"`a`\|b &lt;i> **c**"
    assert markdown_cell(r"already \| escaped") == r"already \| escaped"

"""Parse an HTML page and check what every page of the program must satisfy."""

import re
from html.parser import HTMLParser

VOID = {"meta", "br", "wbr", "img", "link", "input", "hr"}
# HTML's own elements and those of SVG that the figures are made of.
ELEMENTS = frozenset(
    re.findall(
        r"\w+",
        "html head meta title style body a header p h1 h2 h3 h4 main nav section article ul ol li div span dl dt dd "
        "bdi wbr strong em small details summary input label table caption thead tbody tr th td data figure figcaption "
        "pre script svg g defs path use clippath rect text tspan circle image",
    )
)


class Page(HTMLParser):
    """Elements, attributes and text of a page, refusing tags that do not close."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.tags, self.attributes, self.text, self.open = [], [], [], []
        self.feed(html)
        assert not self.open, f"not closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value) for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value) for name, value in attrs]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    def values(self, attribute):
        return [value for _, name, value in self.attributes if name == attribute]

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


def assert_sound(html):
    page = Page(html)
    assert set(page.tags) <= ELEMENTS, set(page.tags) - ELEMENTS
    ids = page.values("id")
    assert len(ids) == len(set(ids)), [i for i in ids if ids.count(i) > 1]
    targets = [v[1:] for v in page.values("href") if v.startswith("#")]
    targets += [t for _, _, value in page.attributes for t in re.findall(r"url\(#([^)]+)\)", value or "")]
    assert set(targets) <= set(ids), set(targets) - set(ids)
    for tag, name, value in page.attributes:
        assert not name.startswith("on"), (tag, name, value)
        if name in ("href", "src", "xlink:href"):
            assert value.startswith(("#", "data:image/", "https://doi.org/")), (tag, name, value)
            assert not value.startswith("https:") or tag == "a"
    return page

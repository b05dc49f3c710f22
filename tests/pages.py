"""Reading pages as their readers do: parsed strictly, without pictures, by their words."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser

import numpy as np
from sklearn.naive_bayes import GaussianNB

from cyclofeat.counting import evaluate
from cyclofeat.report._page import Section

PICTURE = {"image": "data:,", "alt": "", "width": 1, "height": 1}  # in place of one that takes time
VOID = {"meta", "img", "br", "link", "input", "hr", "source"}


class Balanced(HTMLParser):
    """Parser that fails where an element is closed that was not the last one opened."""

    def __init__(self):
        super().__init__()
        self.open, self.tags, self.text, self.attributes = [], [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, *pair) for pair in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)  # closed at once, as in SVG
        self.attributes += [(tag, *pair) for pair in attrs]

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "title", "script"):
            self.text.append(data)


def parse(page):
    parser = Balanced()
    parser.feed(page)
    parser.close()
    assert not parser.open
    return parser


def summary_of(write, *arguments, **options):
    """What a function that writes a page gives to the page's template."""
    section = Section()
    write(*arguments, path=section, **options)
    return section.summary


def words(parsed):
    return " ".join(" ".join(parsed.text).split()).replace("\N{NO-BREAK SPACE}", " ")


def read_words(path):
    """Words of the page in a file."""
    return words(parse(path.read_text(encoding="utf-8")))


def assert_in_order(text, parts):
    """The parts stand in a text, one after the other."""
    missing = [part for part in parts if part not in text]
    assert not missing
    assert [*map(text.find, parts)] == sorted(map(text.find, parts))


def without_pictures(page):
    return re.sub(r"data:image/svg\+xml;base64,[A-Za-z0-9+/=]+", "", page)


def unpacked(column):
    """Numbers of a plot's column that is held as text."""
    return np.frombuffer(base64.b64decode(column["base64"]), dtype="<f4")


def without_scripts(page):
    return re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)


def small_windows(n_assemblies=30):
    """Features, counts and assemblies: two windows each, of three counts that overlap."""
    y = np.repeat(np.arange(n_assemblies) % 3, 2)
    X = y[:, np.newaxis] + np.random.default_rng(0).normal(0, 0.5, (y.size, 1))
    return X, y, np.repeat([f"A<{k}>" for k in range(n_assemblies)], 2)


def evaluated(n_assemblies=30):
    return evaluate(GaussianNB(), *small_windows(n_assemblies))

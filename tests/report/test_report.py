"""Properties of all pages: whole or not at all, fit for screens and paper, errors before the work."""

import sys

import pytest
from pages import PICTURE, evaluated

from cyclofeat.report import check_page_path, write_evaluation_report


@pytest.fixture(scope="module")
def content():
    return {"bayes": evaluated()}


@pytest.fixture
def _no_pictures(monkeypatch):
    """Pages without the time that their pictures take."""
    monkeypatch.setattr("cyclofeat.report._figures.draw_picture", lambda *_, **__: PICTURE)


@pytest.mark.usefixtures("_no_pictures")
def test_pictures_follow_the_scheme_of_the_screen_and_not_of_the_printer(content, tmp_path):
    page = write_evaluation_report(content, tmp_path / "page.html").read_text(encoding="utf-8")
    assert "@media screen and (prefers-color-scheme: dark)" in page
    assert "@media (prefers-color-scheme" not in page
    assert "@media print" in page


@pytest.mark.usefixtures("_no_pictures")
def test_the_same_values_give_the_same_file(content, tmp_path):
    first, again = (write_evaluation_report(content, tmp_path / name) for name in ("a.html", "b.html"))
    assert first.read_bytes() == again.read_bytes()


@pytest.mark.parametrize("module", ["jinja2", "matplotlib.figure"])
def test_missing_packages_are_named_with_their_remedy(content, module, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match="pip install " + module.partition(".")[0]):
        write_evaluation_report(content, tmp_path / "x.html")
    assert not list(tmp_path.iterdir())


def test_a_page_that_cannot_be_written_is_an_error_before_the_work(tmp_path, monkeypatch):
    assert check_page_path(tmp_path / "x.HTM") == tmp_path / "x.HTM"
    with pytest.raises(FileNotFoundError, match="nowhere does not exist"):
        check_page_path(tmp_path / "nowhere" / "x.html")
    with pytest.raises(ValueError, match="must end in .html, got 'x.pdf'"):
        check_page_path(tmp_path / "x.pdf")
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(ImportError, match="pip install jinja2"):
        check_page_path(tmp_path / "x.html")

"""The report's page: whole in one file, the same tables as the Markdown, and fit for a phone."""

import re
from html import unescape

import pytest
from browser_helpers import WIDTHS, Elements, browse, measure
from report_helpers import WHOLE, write

from bench.offline_page import POLICY
from bench.report import cli

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = write(tmp_path_factory.mktemp("whole"), WHOLE, more=True)
    assert cli.main([str(found)]) == 0
    return found


@pytest.fixture(scope="module")
def page(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def test_page_is_whole_without_scripts_and_loads_nothing(page):
    elements = Elements()
    elements.feed(page)
    elements.close()
    assert elements.open == []
    assert not elements.tags & {"script", "iframe", "object", "embed", "form"}
    assert all(link.startswith(("data:", "#")) for link in elements.links)
    assert "@import" not in page and "url(" not in page.replace("url(#", "") and POLICY in page
    assert "http" not in page.replace('http-equiv="', "")
    assert len(page) < 2_000_000


def test_names_inside_plots_are_unique_and_all_that_are_meant_exist(page):
    names = re.findall(r'\bid="([^"]*)"', page)
    assert len(names) == len(set(names))
    assert set(re.findall(r'(?:href="|url\()#([^")]*)', page)) <= set(names)


def test_page_and_markdown_have_the_same_cells(folder, page):
    words = (folder / "report.md").read_text(encoding="utf-8")
    rows = [re.split(r" \| ", line[2:-2]) for line in words.splitlines() if line.startswith("| ")]
    told = [[cell.strip("* ") for cell in row] for row in rows if set("".join(row)) - set("-: ")]
    shown = [
        [unescape(cell).strip() for cell in re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row)]
        for row in re.findall(r"<tr[^>]*>(.*?)</tr>", page)
        if "colspan" not in row
    ]
    assert len(told) == len(shown) > 400
    for cells, other in zip(told, shown, strict=True):
        assert [cell.split(": ")[-1] for cell in cells] == other


def test_plots_take_the_colours_of_the_page(page):
    plots = re.findall(r"<svg .*?</svg>", page, re.DOTALL)
    assert len(plots) == 9
    for plot in plots:
        assert "var(--ink)" in plot and "#010203" not in plot and "#040506" not in plot
        assert "#ffffff" not in plot and "#000000" not in plot and 'aria-label="' in plot


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_wider_than_the_screen_and_every_plot_shows(width, page, tmp_path):
    measured = measure(page, width, tmp_path)
    assert measured["width"] == width and measured["scroll"] == width and measured["wide"] == []
    assert len(measured["pictures"]) == 9 and measured["broken"] == 0
    assert all(inside > 30 and across > width / 5 for inside, across in measured["pictures"])


def test_browser_has_nothing_to_complain_of(folder, tmp_path):
    picture = tmp_path / "page.png"
    run = browse(folder / "report.html", 360, tmp_path, "--enable-logging=stderr", f"--screenshot={picture}")
    assert ":CONSOLE" not in run.stderr, run.stderr
    assert picture.stat().st_size > 20_000


def test_page_is_dark_where_the_reader_wants_it_so(folder, tmp_path):
    image = pytest.importorskip("PIL.Image")
    shades = []
    for name, flags in (("light", ()), ("dark", ("--blink-settings=preferredColorScheme=0",))):
        picture = tmp_path / f"{name}.png"
        browse(folder / "report.html", 600, tmp_path / name, *flags, f"--screenshot={picture}")
        shades.append(sum(image.open(picture).convert("RGB").getpixel((2, 2))))
    assert shades[0] > 700 and shades[1] < 150

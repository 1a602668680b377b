"""The report in a real browser: clouds that turn, small windows, dark mode, no network.

Needs Chromium: tests/install_browser.sh. Without one these tests are skipped, or fail
where DPC_JAX_BROWSER is "required", as .ci/run has it.
"""

import numpy as np
import pytest
from report_pages import make_report

SIZE_LIMIT = 8e6  # bytes of a page
DRAWN = "document.body.dataset.clouds"  # index and colours, once they are drawn


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The same run with and without a ground truth."""
    folder = tmp_path_factory.mktemp("pages")
    return {
        truth: make_report(folder / str(truth), has_truth=truth)
        for truth in (True, False)
    }


def read_plot(browser, name):
    """What is seen of a plot, float [rows, cols, 3]."""
    x, y, width, height = browser.locate(f"#{name}")
    box = tuple(map(int, (x, y, x + width, y + height)))
    return np.asarray(browser.take_picture().crop(box), float)


def measure_change(first, second):
    """Share of the pixels that differ clearly."""
    return float(np.mean(np.abs(first - second).max(axis=-1) > 30))


def assert_sound(browser, page):
    assert browser.errors == []
    assert browser.requests == [page.resolve().as_uri()]


@pytest.mark.parametrize("has_truth", [True, False])
def test_the_clouds_are_drawn_from_the_page_alone(browser, pages, has_truth):
    page = pages[has_truth]
    assert page.stat().st_size < SIZE_LIMIT
    browser.open(page)
    assert browser.wait_for(DRAWN) == "0 own"
    names = ["predicted", "true"] if has_truth else ["predicted"]
    assert browser.ask("document.querySelectorAll('.plot canvas').length") >= len(names)
    browser.scroll_to("#predicted")
    for name in names:
        # An ellipsoid of 300 balls covers some hundredths of its plot.
        plot = read_plot(browser, name)
        assert measure_change(plot, plot[5, 5]) > 0.02
    assert browser.ask("document.querySelectorAll('[data-colors]').length") == (
        2 if has_truth else 0
    )
    assert_sound(browser, page)


def test_clouds_turn_together_and_their_colours_and_shapes_are_chosen(browser, pages):
    browser.open(pages[True])
    browser.wait_for(DRAWN)
    browser.scroll_to("#predicted")
    before = [read_plot(browser, name) for name in ("predicted", "true")]
    browser.drag("#predicted", by=(120, 40))
    cameras = "['predicted', 'true'].map(n => Object.values(document.getElementById(n)"
    cameras += "._fullLayout.scene._scene.getCamera().eye))"
    browser.wait_for(
        f"(([a, b]) => a.every((v, i) => Math.abs(v - b[i]) < 1e-6))({cameras})"
    )
    after = [read_plot(browser, name) for name in ("predicted", "true")]
    for old, new in zip(before, after, strict=True):
        assert measure_change(old, new) > 0.01
    browser.ask("document.querySelector('[data-colors=error]').click()")
    browser.wait_for(f"{DRAWN} === '0 error'")
    assert measure_change(after[0], read_plot(browser, "predicted")) > 0.01
    assert browser.ask("document.getElementById('scale').hidden") is False
    choose = "(c => { c.value = '2'; c.dispatchEvent(new Event('change')); })"
    browser.ask(f"{choose}(document.getElementById('choice'))")
    browser.wait_for(f"{DRAWN} === '2 error'")
    assert_sound(browser, pages[True])


@pytest.mark.parametrize(("has_truth", "dark"), [(True, True), (False, False)])
def test_a_phone_needs_no_sideways_scrolling(browser, pages, has_truth, dark):
    page = pages[has_truth]
    browser.open(page, width=400, height=800, dark=dark)
    browser.wait_for(DRAWN)
    # Configuration and files unfolded, too.
    browser.ask("document.querySelectorAll('details').forEach(d => d.open = true)")
    assert browser.ask("document.documentElement.scrollWidth") == 400
    assert_sound(browser, page)


def test_dark_mode_is_dark_and_its_charts_too(browser, pages):
    def look(dark):
        """Brightness of the window below the title, and of a chart's part of it."""
        browser.open(pages[True], dark=dark)
        browser.wait_for(DRAWN)
        paper = browser.take_picture().convert("L")
        browser.scroll_to(".chart")
        chart = browser.take_picture().convert("L")
        return [float(np.median(np.asarray(shown))) for shown in (paper, chart)]

    assert min(look(dark=False)) > 230
    assert max(look(dark=True)) < 80


def test_without_the_3d_engine_the_page_says_so_and_shows_its_pictures(browser, pages):
    text = pages[True].read_text(encoding="utf-8")
    broken = pages[True].with_name("broken.html")
    start = text.index('id="plotly">') + len('id="plotly">')
    broken.write_text(text[:start] + "H4sI" + text[start + 4000 :], encoding="utf-8")
    browser.open(broken)
    browser.wait_for(
        "document.querySelector('#predicted .say').textContent.includes('cannot')"
    )
    assert browser.ask("document.querySelectorAll('.wide img').length") == 4

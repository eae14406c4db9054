"""The viewer in a browser: its picture is that of the library."""

import numpy as np
import pytest

from splatree.render.pipeline import render
from splatree.scene.options import RenderOptions, SelectOptions
from splatree.view.options import ViewOptions
from splatree.view.viewer import Viewer

from .chromium import chromium, find_chromium

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_chromium() is None, reason="the viewer's tests need Chromium, which is not installed"),
]

SIZE = (480, 270)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture(scope="module")
def viewer(city_tree):
    with Viewer(city_tree, ViewOptions(budget=60_000)) as made:
        yield made


def opened(browser, viewer, query=""):
    page = browser.new_page()
    page.open(f"{viewer.url}?noui{query}", size=SIZE)
    page.wait_for("window.splatree?.isReady")
    return page


def psnr(found, expected):
    return -10 * np.log10(np.mean((found - np.clip(expected, 0, 1)) ** 2))


def picture(viewer, page, **select):
    """The library's picture of what the page shows."""
    background = tuple(page.evaluate("splatree.page.background()"))
    return render(
        viewer._server.exhibits[0].scene,
        viewer.camera,
        RenderOptions(background=background),
        SelectOptions(**select),
    ).image


def settled(page):
    """Wait until the newest cut is drawn and on the screen."""
    page.wait_for("splatree.isReady")
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def test_the_browser_draws_the_cut_as_the_library_does(browser, viewer):
    page = opened(browser, viewer, "&renderer=webgl&exact=0")
    header = page.evaluate("splatree.layers[0].header")
    assert 0.85 * 60_000 <= header["rows"] <= 60_000
    assert psnr(page.screenshot(), picture(viewer, page, pixel_error=header["tau"])) >= 40
    assert page.evaluate("splatree.stats.bytesAtFirst") <= 700_000
    assert page.errors == []
    page.close()


def test_moving_and_the_slider_change_the_cut(browser, viewer):
    page = opened(browser, viewer, "&renderer=webgl&exact=0")
    before = page.evaluate("splatree.layers[0].header")
    x, y = SIZE[0] / 2, SIZE[1] / 2
    page.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
    for i in range(1, 5):
        page.mouse("mouseMoved", x + 15 * i, y - 5 * i, button="left", buttons=1)
    page.mouse("mouseReleased", x + 60, y - 20, button="left", clickCount=1)
    page.mouse("mouseWheel", x, y, deltaX=0, deltaY=-300)
    page.wait_for(f"splatree.layers[0].header.seq > {before['seq']}")
    settled(page)
    moved = page.evaluate("splatree.layers[0].header")
    assert moved["seq"] > before["seq"]
    assert psnr(page.screenshot(), picture(viewer, page, pixel_error=moved["tau"])) >= 40
    page.evaluate("splatree.state.budget = 20_000, splatree.changed()")
    settled(page)
    fewer = page.evaluate("splatree.layers[0].header")
    assert fewer["rows"] <= 20_000
    assert psnr(page.screenshot(), picture(viewer, page, pixel_error=fewer["tau"])) >= 40
    held = page.evaluate("splatree.layers[0].room.count")
    assert held <= fewer["rows"]
    assert page.errors == []
    page.close()


def test_a_camera_that_rests_gets_the_exact_picture(browser, viewer):
    page = opened(browser, viewer, "&renderer=webgl")
    page.wait_for("splatree.isExact")
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    header = page.evaluate("splatree.layers[0].frameHeader")
    expected = np.clip(picture(viewer, page, pixel_error=header["tau"]), 0, 1)
    # 8 bits, and last bits of a pose that went through JSON: two steps at most.
    assert np.abs(page.screenshot() - expected).max() <= 2.5 / 255
    assert page.evaluate("splatree.stats.psnr") >= 40
    page.close()


def test_without_webgl_the_server_draws(browser, viewer):
    page = browser.new_page()
    page.open(f"{viewer.url}?noui&renderer=frames", size=SIZE)
    page.wait_for("window.splatree?.isExact")
    header = page.evaluate("splatree.layers[0].frameHeader")
    assert (header["width"], header["height"]) == SIZE
    expected = np.clip(picture(viewer, page, pixel_error=header["tau"]), 0, 1)
    assert np.abs(page.screenshot() - expected).max() <= 2.5 / 255
    page.mouse("mouseWheel", 200, 100, deltaX=0, deltaY=-300)
    page.wait_for(f"splatree.isExact && splatree.layers[0].frameHeader.seq > {header['seq']}")
    assert page.evaluate("splatree.layers[0].frameHeader.seq") > header["seq"]
    assert page.errors == []
    page.close()


def test_two_pages_at_once_show_views_of_their_own(browser, viewer):
    one = opened(browser, viewer, "&renderer=webgl&exact=0")
    two = opened(browser, viewer, "&renderer=webgl&exact=0")
    two.evaluate("splatree.camera.orbit(1.0, -0.2)")
    settled(two)
    header = two.evaluate("splatree.layers[0].header")
    assert psnr(two.screenshot(), picture(viewer, two, pixel_error=header["tau"])) >= 40
    one.evaluate("splatree.camera.orbit(0.02, 0)")
    settled(one)
    header = one.evaluate("splatree.layers[0].header")
    assert psnr(one.screenshot(), picture(viewer, one, pixel_error=header["tau"])) >= 40
    assert one.errors + two.errors == []
    one.close()
    two.close()

"""What the tests of the viewer in a browser have in common."""

import numpy as np

from splatree.render.pipeline import render
from splatree.scene.options import RenderOptions, SelectOptions

SIZE = (480, 270)


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
    shown(page)


def shown(page):
    """Wait until what is drawn is on the screen."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

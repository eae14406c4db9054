"""The viewer as people use it: by keys alone, on lines that break, with graphics that are taken away."""

import time

import numpy as np
import pytest

import splatree as st
from splatree.scene.thinning import ThinOptions
from splatree.simplify.thin import thin
from splatree.view.options import ViewOptions
from splatree.view.viewer import Viewer

from .chromium import find_chromium
from .viewing import SIZE, opened, picture, psnr, settled, shown

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_chromium() is None, reason="the viewer's tests need Chromium, which is not installed"),
]


def press(page, code, key, *, is_down=True, is_up=True, modifiers=0):
    """A key pressed and let go, or one of both."""
    more = {"code": code, "key": key, "modifiers": modifiers, "windowsVirtualKeyCode": ord(key.upper()[0])}
    if is_down:
        page.call("Input.dispatchKeyEvent", type="keyDown", **more)
    if is_up:
        page.call("Input.dispatchKeyEvent", type="keyUp", **more)


def held_for(page, seconds, **keys):
    """How far the camera went, its pose before and after, while the controls took a step of so many seconds with a key held."""
    before = np.array(page.evaluate("splatree.camera.eye"))
    press(page, **keys, is_up=False)
    page.evaluate(f"splatree.controls.step({seconds})")
    press(page, **keys, is_down=False)
    return np.linalg.norm(np.array(page.evaluate("splatree.camera.eye")) - before)


@pytest.fixture
def stepped(browser, viewer):
    """A page that moves only where a test says for how long."""
    page = opened(browser, viewer, "&renderer=webgl&exact=0")
    page.evaluate("window.__stop = true")
    return page


def test_what_is_hidden_is_drawn_coarsely_where_that_is_asked_for(browser, viewer):
    page = opened(browser, viewer, "&renderer=webgl")
    page.evaluate("splatree.camera.zoom(0.25), splatree.camera.orbit(0.3, 0.25)")
    distances = []
    for is_on in (False, True):
        page.evaluate(
            f"splatree.page.occlusion.input.checked = {str(not is_on).lower()}, splatree.page.occlusion.input.click()"
        )
        page.wait_for("splatree.isExact && splatree.stats.psnr")
        shown(page)
        assert page.evaluate("splatree.state.occlusion") is is_on
        assert page.evaluate("splatree.stats.psnr") >= 40  # the exact picture is of the cut that the browser draws
        distances.append(psnr(page.screenshot(), picture(viewer, page, pixel_error=0)))
    assert distances[1] > distances[0] + 1.5
    assert page.errors == []


def test_shift_flies_three_times_as_fast(stepped):
    slow = held_for(stepped, 0.1, code="KeyW", key="w")
    fast = held_for(stepped, 0.1, code="KeyW", key="W", modifiers=8)
    assert fast == pytest.approx(3 * slow, rel=1e-6)


def test_a_key_let_go_over_a_dialog_or_with_control_stops_the_flight(stepped):
    press(stepped, "KeyW", "w", is_up=False)
    press(stepped, "KeyH", "h")
    assert stepped.evaluate("document.getElementById('help').open")
    press(stepped, "KeyW", "w", is_down=False)
    assert stepped.evaluate("splatree.controls.keys.size") == 0
    press(stepped, "KeyH", "h")
    assert not stepped.evaluate("document.getElementById('help').open")
    press(stepped, "KeyW", "w", is_up=False)
    press(stepped, "KeyW", "w", is_down=False, modifiers=2)
    assert stepped.evaluate("splatree.controls.keys.size") == 0


def test_plus_and_minus_come_nearer_and_go_back(stepped):
    before = stepped.evaluate("splatree.camera.distance()")
    held_for(stepped, 0.3, code="BracketRight", key="+")  # where it is on a German keyboard
    assert stepped.evaluate("splatree.camera.distance()") == pytest.approx(before * np.exp(-0.3), rel=1e-6)
    held_for(stepped, 0.3, code="Minus", key="-")
    assert stepped.evaluate("splatree.camera.distance()") == pytest.approx(before, rel=1e-6)


def test_the_middle_of_the_picture_becomes_the_point_to_turn_about(browser, viewer):
    page = opened(browser, viewer, "&renderer=webgl&exact=0")
    page.evaluate(
        "(({ eye, target }) => splatree.camera.set(eye, target.map((x, i) => 3 * x - 2 * eye[i])))(splatree.camera)"
    )
    settled(page)
    before = page.evaluate("splatree.camera.distance()")
    press(page, "KeyF", "f")
    page.wait_for(f"splatree.motion === null && splatree.camera.distance() < 0.7 * {before}")


def test_all_that_can_be_done_has_a_name_and_is_reached_by_the_tab_key(browser, viewer, city_tree):
    small = thin(city_tree, ThinOptions(keep=0.05)).scene
    with Viewer(city_tree, ViewOptions(budget=20_000), beside=small) as pair:
        page = browser.new_page()
        page.open(f"{pair.url}?renderer=webgl&exact=0", size=SIZE)
        page.wait_for("window.splatree?.isReady")
        page.evaluate(
            "splatree.page.toggleSettings(), document.querySelectorAll('details').forEach((d) => (d.open = true))"
        )
        page.wait_for("getComputedStyle(document.getElementById('panel')).visibility === 'visible'")
        seen = []
        while len(seen) < 200:
            press(page, "Tab", "\t")
            seen.append(page.evaluate("document.activeElement.id || document.activeElement.tagName"))
            if seen[-1] == seen[0] and len(seen) > 1:
                break
        controls = "[...document.querySelectorAll('canvas, button, input, summary, #divider')]"
        assert len(seen) - 1 >= page.evaluate(f"{controls}.filter((e) => e.offsetParent || e.id).length")
        nodes = page.call("Accessibility.getFullAXTree")["nodes"]
        roles = {"button", "slider", "checkbox", "application", "splitter"}
        names = [(node["role"]["value"], node.get("name", {}).get("value", "")) for node in nodes if "role" in node]
        found = [(role, name) for role, name in names if role in roles]
        assert len(found) > 40 and all(name for _, name in found), found
        said = page.evaluate("splatree.page.budget.querySelector('input').getAttribute('aria-valuetext')")
        assert said == "20 k"
        page.evaluate("document.getElementById('divider').focus()")
        press(page, "ArrowLeft", "ArrowLeft")
        assert page.evaluate("splatree.state.split") == pytest.approx(0.48)
        assert page.evaluate("document.getElementById('divider').getAttribute('aria-valuenow')") == "48"
        assert page.errors == []
        page.close()


def test_whoever_wants_less_motion_jumps(browser, viewer):
    page = opened(browser, viewer, "&renderer=webgl&exact=0")
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-reduced-motion", "value": "reduce"}])
    page.evaluate("splatree.camera.orbit(0.5, 0), splatree.reset(), splatree.motion(0)")
    assert page.evaluate("splatree.camera.eye") == page.evaluate("splatree.firstEye()")
    assert page.evaluate("getComputedStyle(document.getElementById('panel')).transitionDuration") == "0s"


def test_a_page_that_may_keep_nothing_is_shown_all_the_same(browser, viewer):
    page = browser.new_page()
    refuse = (
        "Object.defineProperty(window, 'localStorage', { get() { throw new DOMException('no', 'SecurityError'); } })"
    )
    page.call("Page.addScriptToEvaluateOnNewDocument", source=refuse)
    page.open(f"{viewer.url}?noui&renderer=webgl&exact=0", size=SIZE)
    page.wait_for("window.splatree?.isReady")
    theme = page.evaluate("document.documentElement.dataset.theme")
    press(page, "KeyT", "t")
    assert page.evaluate("document.documentElement.dataset.theme") != theme
    assert page.errors == []


def test_graphics_that_were_taken_away_come_back(browser, viewer):
    page = opened(browser, viewer, "&renderer=webgl&exact=0")
    page.evaluate("splatree.page.showBoxes('blocks')")
    page.wait_for("splatree.lines.boxes?.uploaded")
    page.evaluate("splatree.page.showBoxes('none')")
    page.evaluate("(window.graphics = splatree.painter.gl.getExtension('WEBGL_lose_context')).loseContext()")
    page.wait_for("splatree.isBlind")
    assert not page.evaluate("document.getElementById('notice').hidden")
    page.evaluate("splatree.camera.orbit(0.2, 0), window.graphics.restoreContext()")
    page.wait_for("!splatree.isBlind && splatree.layers[0].room.count > 0")
    settled(page)
    tau = page.evaluate("splatree.layers[0].header.tau")
    assert psnr(page.screenshot(), picture(viewer, page, pixel_error=tau)) >= 40
    page.evaluate("splatree.page.showBoxes('blocks')")
    page.wait_for("splatree.lines.boxes?.uploaded")
    shown(page)
    assert page.evaluate("splatree.painter.gl.getError()") == 0
    assert page.errors == []


@pytest.mark.parametrize("renderer", ["frames", "webgl"])
def test_a_server_that_was_started_again_goes_on_where_the_page_is(browser, city_tree, renderer):
    options = ViewOptions(budget=20_000)
    with Viewer(city_tree, options) as first:
        page = browser.new_page()
        page.open(f"{first.url}?noui&renderer={renderer}", size=SIZE)
        page.wait_for("window.splatree?.isExact")
        page.evaluate("splatree.camera.orbit(0.3, 0.1)")
        pose = page.evaluate("splatree.camera.pose()")
        port = first.port
    page.wait_for("!document.getElementById('notice').hidden")
    page.evaluate("splatree.camera.orbit(0.1, 0)")  # asked for in vain
    time.sleep(0.3)
    page.evaluate("splatree.camera.orbit(-0.1, 0)")
    with Viewer(city_tree, ViewOptions(budget=20_000, port=port)):
        page.wait_for("splatree.isExact", timeout=30)
        assert page.evaluate("document.getElementById('notice').hidden")
        np.testing.assert_allclose(page.evaluate("splatree.camera.pose()"), pose, atol=1e-9)
        page.close()


def test_a_page_that_rested_goes_on_at_a_key(browser, viewer):
    page = opened(browser, viewer, "&renderer=webgl&exact=0")
    page.evaluate(
        "splatree.layers[0].link.socket.onclose({ code: 4000, reason: 'idle: the page said nothing for ten minutes' })"
    )
    assert "press a key" in page.evaluate("document.getElementById('notice').textContent")
    press(page, "KeyA", "a")
    page.wait_for("splatree.layers[0].link.isOpen")
    settled(page)
    assert page.evaluate("document.getElementById('notice').hidden")


def test_a_photograph_stays_while_the_camera_does(browser, city_tree):
    camera = st.flyout(city_tree, st.PathOptions(views=2, width=64, height=36))[0]
    photos, options = {camera.name: np.ones((36, 64, 3), np.float32)}, ViewOptions(budget=20_000)
    with Viewer(city_tree, options, cameras=st.Cameras((camera,)), photos=photos) as made:
        page = opened(browser, made, "&renderer=webgl&exact=0")
        page.wait_for("splatree.page.views.given.length")
        page.evaluate("splatree.page.views.take(splatree.page.views.given[0], 0, 'camera')")
        settled(page)
        photo = "document.getElementById('photo')"
        assert not page.evaluate(f"{photo}.hidden")
        page.call("Emulation.setDeviceMetricsOverride", width=400, height=180, deviceScaleFactor=1, mobile=False)
        page.wait_for("splatree.layers[0].isSettled && document.getElementById('stage').height === 180")
        settled(page)
        assert not page.evaluate(f"{photo}.hidden") and page.evaluate(f"{photo}.style.width") == "320px"
        page.evaluate("splatree.page.toggleTheme()")
        settled(page)
        assert not page.evaluate(f"{photo}.hidden")
        page.evaluate("splatree.camera.orbit(0.01, 0)")
        settled(page)
        assert page.evaluate(f"{photo}.hidden")
        page.close()


def test_boxes_of_many_let_the_scene_shine_through(browser, viewer):
    page = opened(browser, viewer, "&renderer=webgl&exact=0")
    plain = page.screenshot()
    page.evaluate("splatree.page.showBoxes('blocks')")
    page.wait_for("splatree.lines.boxes?.uploaded")
    shown(page)
    changed = np.abs(page.screenshot() - plain).mean()
    assert 0.005 < changed < 0.12
    page.evaluate("splatree.page.showBoxes('none')")


def test_a_side_of_the_clipping_box_takes_the_other_along(stepped):
    stepped.evaluate("splatree.page.setClip(true)")
    stepped.evaluate(
        "((input) => { input.value = 0.7; input.dispatchEvent(new Event('input')); })"
        "(splatree.page.clipRows.querySelectorAll('input')[1])"
    )  # x to 0.7 of the width
    stepped.evaluate(
        "((input) => { input.value = 0.9; input.dispatchEvent(new Event('input')); })"
        "(splatree.page.clipRows.querySelectorAll('input')[0])"
    )  # and x from 0.9
    low, high = stepped.evaluate("[splatree.state.box[0], splatree.state.box[3]]")
    assert low == pytest.approx(high)
    values = stepped.evaluate(
        "[...splatree.page.clipRows.querySelectorAll('input')].slice(0, 2).map((input) => input.value)"
    )
    assert values == ["0.9", "0.9"]
    stepped.evaluate("splatree.page.setClip(false)")

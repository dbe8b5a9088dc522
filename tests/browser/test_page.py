"""The served page in a real browser: loads, samples, plays, downloads, survives, for two browsers at once."""

import json
import os
import re
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

if not os.environ.get("CI"):  # where everything must run, a missing package is an error
    pytest.importorskip("viser")
    pytest.importorskip("selenium")

import viser
from driver import Browser

from graspcascade.core.objects import CATALOGUE
from graspcascade.core.outcomes import VERDICTS
from graspcascade.formats import load_grasps
from graspcascade.viewer import with_friction
from graspcascade.viewer.page import Start
from graspcascade.viewer.server import write_standalone


def play(browser: Browser) -> str:
    """Play the trial of the present grasp to its end and give the verdict shown."""
    browser.choose("speed", "8 x")
    browser.press("Play trial")
    browser.wait_text(".gc-shown", "trial at")
    return browser.wait_text(".gc-verdict", "protocol")


def test_loads_and_draws_the_hand_and_the_object(browser: Browser, address: str) -> None:
    browser.open(address)
    assert len(browser.rows()) == 4
    picture = browser.wait_drawn()
    assert picture.std() > 0.05
    assert browser.chrome.title == "graspcascade"
    assert browser.text(".gc-shown") == "settled"
    assert "protocol paper" in browser.text(".gc-verdict")
    assert re.search(r"measured: \d+ % \(95 %: \d+ to \d+ %\) of 500 trials held", browser.text(".gc-measured"))
    assert browser.complaints() == []


def test_hand_and_object_fill_the_canvas_and_little_forearm_does(browser: Browser, address: str) -> None:
    browser.open(address)
    rows, columns = np.nonzero(browser.wait_drawn().max(axis=2) < 0.5)
    height, width = browser.picture().shape[:2]
    assert np.ptp(rows) > height / 3
    assert abs(float(np.median(columns)) / width - 0.5) < 0.15


def test_samples_what_is_asked_for_on_the_sides_that_exist(browser: Browser, address: str) -> None:
    browser.open(address)
    assert browser.options("held by") == ["any", "x = 3 cm", "y = 4.5 cm", "z = 6 cm"]
    browser.choose("object", "cylinder_large")
    browser.until(lambda: browser.options("held by") == ["any", "x = 5 cm"], "the sides of the cylinder")
    browser.choose("type", "tip_pinch")
    browser.choose("held by", "x = 5 cm")
    browser.type("n", "7")
    browser.type("seed", "3")
    browser.press("Sample")
    browser.wait_text(".gc-message", "7 grasps sampled")
    browser.until(lambda: len(browser.rows()) == 7, "seven rows")
    assert {row[1] for row in browser.rows()} == {"x = 5 cm"}
    browser.press("next")
    browser.until(lambda: browser.text(".gc-current").startswith("1 "), "the second grasp")
    browser.press("previous")
    browser.press("previous")
    browser.until(lambda: browser.text(".gc-current").startswith("6 "), "the last grasp")
    assert browser.complaints() == []


def test_shows_three_states_of_a_grasp(browser: Browser, address: str) -> None:
    browser.open(address)
    settled = browser.wait_drawn()
    for view in ("pregrasp", "target"):
        browser.choose("show", view)
        browser.wait_text(".gc-shown", view)
        browser.until(
            lambda: np.abs(browser.picture() - settled).mean() > 1e-3, f"{view} looks unlike the settled hand"
        )
    assert "protocol paper" in browser.text(".gc-verdict")


def test_plays_a_trial_and_shows_its_verdict_with_the_protocol(browser: Browser, address: str) -> None:
    browser.open(address)
    shown = play(browser)
    assert "protocol paper" in shown
    verdict = browser.rows()[0][3].removesuffix(" faithful").replace(" ", "_")
    assert verdict in VERDICTS
    assert verdict.replace("_", " ") in shown
    assert "1 tried" in browser.text(".gc-rate")


def test_another_friction_is_another_protocol(browser: Browser, address: str) -> None:
    browser.open(address)
    browser.type("friction", "0.6")
    browser.wait_text(".gc-rate", "protocol paper, friction 0.6")
    browser.press("Try all")
    browser.wait_text(".gc-message", "tried 4 of 4")
    rate = browser.wait_text(".gc-rate", "of 4 tried held")
    assert re.search(r"95 %: \d+ to \d+ %\), protocol paper, friction 0\.6", rate)
    assert all(row[3] != "-" for row in browser.rows())


def test_downloads_files_that_can_be_read_back(browser: Browser, address: str, start: Start) -> None:
    browser.open(address)
    browser.press("Download")
    path = browser.downloaded("tripod_box_medium_seed0.json")
    np.testing.assert_array_equal(load_grasps(path).posture, start.batch.grasps.posture)
    assert json.loads(path.read_text())["metadata"]["asked"]["grasp_type"] == "tripod"
    browser.choose("what", "this grasp")
    browser.press("next")
    browser.until(lambda: browser.text(".gc-current").startswith("1 "), "the second grasp")
    browser.press("Download")
    path = browser.downloaded("tripod_box_medium_seed0_grasp1.json")
    np.testing.assert_array_equal(load_grasps(path).posture, start.batch.grasps.posture[1:2])


BAD = (
    ("n", "0", "Sample", "n must be a whole number between 1 and 200, got 0"),
    ("n", "-3", "Sample", "n must be a whole number between 1 and 200, got -3"),
    ("n", "123456789012345678", "Sample", "n must be a whole number between 1 and 200"),
    ("seed", "-1", "Sample", "seed must be a whole number between 0 and"),
    ("friction", "-2", "Play trial", "friction must be between"),
    ("friction", "1000", "Try all", "friction must be between"),
)
GOOD = {"n": "4", "seed": "0", "friction": "0.8"}


def test_survives_bad_values(browser: Browser, address: str) -> None:
    browser.open(address)
    browser.wait_drawn()
    before, layout = browser.rows(), browser.layout()
    for label, value, button, message in BAD:
        browser.type(label, value)
        browser.press(button)
        browser.wait_text(".gc-message[data-kind=error]", message)
        browser.type(label, GOOD[label])
    browser.until(lambda: browser.layout() == layout, "the controls stand where they stood")
    # Words are no numbers: the last number typed stays.
    browser.type("n", "many")
    browser.press("Sample")
    browser.wait_text(".gc-message[data-kind=note]", "4 grasps sampled")
    assert browser.rows() == before
    assert browser.complaints() == []


def test_an_object_of_ones_own_size_is_set_by_sliders(browser: Browser, any_size_address: str) -> None:
    browser.open(any_size_address)
    browser.wait_drawn()
    assert browser.field("object").get_attribute("value") == "cylinder, own size"
    assert {"diameter mm", "height mm"} <= set(browser.labels())
    assert "x mm" not in browser.labels()
    browser.choose("object", "box, own size")
    browser.until(lambda: {"x mm", "y mm", "z mm"} <= set(browser.labels()), "a slider for each side of a box")
    assert "diameter mm" not in browser.labels()
    browser.slide("x mm", 8)  # it was 32 mm
    browser.slide("z mm", -5)  # it was 60 mm
    browser.until(
        lambda: browser.options("held by") == ["any", "x = 4 cm", "y = 4.1 cm", "z = 5.5 cm"], "the sides of the box"
    )
    browser.press("Sample")
    browser.wait_text(".gc-message", "2 grasps sampled")
    browser.wait_text(".gc-shown", "settled")
    browser.press("Download")
    path = browser.downloaded("palmar_pinch_box_40x41x55mm_seed0.json")
    assert list(load_grasps(path).tasks.objects) == ["box:40x41x55mm"]
    assert browser.complaints() == []


def test_a_model_that_knows_objects_by_name_says_so_and_offers_these(browser: Browser, address: str) -> None:
    browser.open(address)
    assert "knows these 9 objects by name and no other size" in browser.text(".gc-hint")
    assert browser.options("object") == list(CATALOGUE)


def test_two_browsers_at_once_do_not_disturb_each_other(
    browser: Browser, second_browser: Browser, address: str
) -> None:
    browser.open(address)
    second_browser.open(address)
    second_browser.choose("object", "sphere_small")
    second_browser.type("n", "2")
    second_browser.press("Sample")
    second_browser.until(lambda: len(second_browser.rows()) == 2, "two rows")
    assert len(browser.rows()) == 4
    verdicts: dict[str, str] = {}
    both = [
        threading.Thread(target=lambda name=name, one=one: verdicts.update({name: play(one)}))
        for name, one in (("first", browser), ("second", second_browser))
    ]
    for one in both:
        one.start()
    for one in both:
        one.join()
    assert set(verdicts) == {"first", "second"}
    assert "1 of 1" in browser.text(".gc-rate") or "0 of 1" in browser.text(".gc-rate")
    assert [len(one.rows()) for one in (browser, second_browser)] == [4, 2]


CONNECT = """
const [address, protocol, done] = arguments;
const socket = new WebSocket(address, [protocol]);
socket.onopen = () => { socket.close(); done("open"); };
socket.onerror = () => done("refused");
"""


@pytest.fixture
def foreign_site(tmp_path: Path) -> Iterator[str]:
    """Serve a folder as another site would, from another port: that alone makes an origin another one."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=str(tmp_path)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_another_sites_page_can_neither_connect_nor_show_the_page(
    browser: Browser, address: str, foreign_site: str, tmp_path: Path
) -> None:
    (tmp_path / "index.html").write_text(f'<title>foreign</title><iframe src="{address}"></iframe>')
    asked = (address.replace("http", "ws"), f"viser-v{viser.__version__}")
    browser.open(address)
    assert browser.chrome.execute_async_script(CONNECT, *asked) == "open"
    browser.complaints()
    browser.chrome.get(foreign_site)
    assert browser.chrome.title == "foreign"
    assert browser.chrome.execute_async_script(CONNECT, *asked) == "refused"
    complaints = browser.complaints()
    for reason in ("X-Frame-Options", "Unexpected response code: 403"):
        assert [line for line in complaints if reason in line]


def test_a_name_pointed_at_this_machine_shows_nothing_and_cannot_connect(browser: Browser, address: str) -> None:
    rebound = address.replace("127.0.0.1", "rebound.example")
    browser.chrome.get(rebound)
    assert "Refused" in browser.text("body")
    asked = (rebound.replace("http", "ws"), f"viser-v{viser.__version__}")
    assert browser.chrome.execute_async_script(CONNECT, *asked) == "refused"
    browser.open(address.replace("127.0.0.1", "localhost"))
    browser.complaints()


def test_a_standalone_page_draws_without_a_server(browser: Browser, start: Start, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    two = replace(start.batch, grasps=start.batch.grasps[:2])
    assert write_standalone(out, two, start.hand, with_friction(0.7)) == 2
    browser.open(out.as_uri())
    assert browser.chrome.title == "tripod_box_medium_seed0 - graspcascade"
    assert browser.wait_drawn().std() > 0.05
    assert len(browser.rows()) == 2
    assert "protocol paper, friction 0.7" in browser.text(".gc-rate")
    first = browser.picture()
    browser.until(lambda: np.abs(browser.picture() - first).mean() > 1e-3, "the trial moves")
    assert [line for line in browser.complaints() if "http" in line] == []

"""The served page in a real browser: loads, samples, plays, downloads, survives, for two browsers at once."""

import json
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

if not os.environ.get("CI"):  # where everything must run, a missing package is an error
    pytest.importorskip("viser")
    pytest.importorskip("selenium")

from driver import Browser

from graspcascade.formats import load_grasps
from graspcascade.trials import VERDICTS
from graspcascade.viewer.page import Start


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
    assert browser.complaints() == []


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
    posture = browser.wait_drawn()
    for view in ("pregrasp", "settled"):
        browser.choose("show", view)
        browser.wait_text(".gc-shown", view)
        browser.until(lambda: np.abs(browser.picture() - posture).mean() > 1e-3, f"{view} looks unlike the posture")
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
    ("n", "0", "Sample", "n must be between 1 and 200, got 0"),
    ("n", "-3", "Sample", "n must be between 1 and 200, got -3"),
    ("n", "123456789012345678", "Sample", "n must be between 1 and 200"),
    ("seed", "-1", "Sample", "seed must be between 0 and"),
    ("friction", "-2", "Play trial", "friction must be between"),
    ("friction", "1000", "Try all", "friction must be between"),
)
GOOD = {"n": "4", "seed": "0", "friction": "0.8"}


def test_survives_bad_values(browser: Browser, address: str) -> None:
    browser.open(address)
    before = browser.rows()
    for label, value, button, message in BAD:
        browser.type(label, value)
        browser.press(button)
        browser.wait_text(".gc-message[data-kind=error]", message)
        browser.type(label, GOOD[label])
    # Words are no numbers: the last number typed stays.
    browser.type("n", "many")
    browser.press("Sample")
    browser.wait_text(".gc-message[data-kind=note]", "4 grasps sampled")
    assert browser.rows() == before
    assert browser.complaints() == []


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


def test_a_standalone_page_draws_without_a_server(browser: Browser, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    command = [sys.executable, "-m", "graspcascade.cli", "view", "--html", str(out), "--n", "2", "--friction", "0.7"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("wrote 2 grasps with their trials under protocol paper, friction 0.7")
    browser.open(out.as_uri())
    assert browser.wait_drawn().std() > 0.05
    assert len(browser.rows()) == 2
    assert "protocol paper, friction 0.7" in browser.text(".gc-rate")
    first = browser.picture()
    browser.until(lambda: np.abs(browser.picture() - first).mean() > 1e-3, "the trial moves")
    assert [line for line in browser.complaints() if "http" in line] == []

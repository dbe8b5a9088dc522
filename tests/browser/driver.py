"""What a person does on the page, in a few words; everything waits for what it needs to see."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
from numpy.typing import NDArray
from selenium.common.exceptions import StaleElementReferenceException
from selenium.webdriver import Chrome, Keys
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

from graspcascade.viewer.shapes import OBJECT_RGB

PATIENCE_S = 40.0
ORANGE = np.array(OBJECT_RGB) / max(OBJECT_RGB)


class Browser:
    """Drive one Chromium."""

    def __init__(self, chrome: Chrome, downloads: Path) -> None:
        self.chrome, self.downloads = chrome, downloads

    def until(self, happens: Callable[[], Any], what: str) -> Any:
        waiting = WebDriverWait(self.chrome, PATIENCE_S, 0.05, [StaleElementReferenceException])
        return waiting.until(lambda _: happens(), f"not within {PATIENCE_S} s: {what}")

    def find(self, css: str) -> list[WebElement]:
        return self.chrome.find_elements(By.CSS_SELECTOR, css)

    def text(self, css: str) -> str:
        """Read in one go: what a playing trial rewrites many times a second is gone before a second question."""
        script = "return [...document.querySelectorAll(arguments[0])].map(found => found.innerText).join(' ')"
        return " ".join(str(self.chrome.execute_script(script, css)).split())

    def wait_text(self, css: str, part: str) -> str:
        return str(self.until(lambda: part in self.text(css) and self.text(css), f"{part!r} in {css}"))

    def open(self, address: str) -> None:
        self.chrome.get(address)
        self.until(lambda: self.find(".gc-table"), "the table of samples")

    def rows(self) -> list[list[str]]:
        """Read the table of samples without its heading."""
        script = (
            "return [...document.querySelectorAll('.gc-table tr')].slice(1)"
            ".map(row => [...row.cells].map(cell => cell.innerText))"
        )
        return list(self.chrome.execute_script(script))

    def field(self, label: str) -> WebElement:
        path = f"//label[normalize-space()='{label}']"
        described: WebElement = self.until(lambda: self.chrome.find_element(By.XPATH, path), label)
        named = self.chrome.find_elements(By.ID, str(described.get_attribute("for")))
        # A text field does not carry the name that its label is for.
        return named[0] if named else self.chrome.find_element(By.XPATH, f"{path}/following::input[1]")

    def type(self, label: str, value: str) -> None:
        field = self.field(label)
        field.click()
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(value)

    def slide(self, label: str, steps: int) -> None:
        """Move a slider by some steps, to the right or, if negative, to the left."""
        path = f"//label[normalize-space()='{label}']/following::*[@role='slider'][1]"
        key = Keys.ARROW_RIGHT if steps > 0 else Keys.ARROW_LEFT
        self.until(lambda: self.chrome.find_element(By.XPATH, path), label).send_keys(key * abs(steps))

    def labels(self) -> list[str]:
        """List the labels of the controls."""
        return [label.text for label in self.find("label") if label.is_displayed()]

    def choose(self, label: str, option: str) -> None:
        field = self.field(label)
        # What stands at the panel's lower edge lies under the handle that resizes it.
        self.chrome.execute_script("arguments[0].scrollIntoView({block: 'center'})", field)
        field.click()
        path = f"//*[@role='option'][normalize-space()='{option}']"
        shown = self.until(lambda: [e for e in self.chrome.find_elements(By.XPATH, path) if e.is_displayed()], option)
        shown[0].click()
        self.until(lambda: self.field(label).get_attribute("value") == option, f"{label} is {option}")

    def options(self, label: str) -> list[str]:
        self.field(label).click()
        shown = self.until(lambda: [e.text for e in self.find("[role=option]") if e.is_displayed()], label)
        self.field(label).send_keys(Keys.ESCAPE)
        return list(shown)

    def press(self, button: str) -> None:
        path = f"//button[normalize-space()='{button}']"
        self.until(lambda: self.chrome.find_elements(By.XPATH, path), button)[0].click()

    def layout(self) -> list[int]:
        """Measure how far apart the controls stand, in pixels, however far the panel is scrolled."""
        names = ("Sample", "previous", "Play trial", "Try all")
        y = [self.chrome.find_element(By.XPATH, f"//button[normalize-space()='{n}']").location["y"] for n in names]
        # The other panel stands on its lower edge, so that its height is what would move.
        table, below = (self.find(css)[0].location["y"] for css in (".gc-table", ".gc-rate"))
        return [round(b - a) for a, b in pairwise(y)] + [round(below - table)]

    def downloaded(self, name: str) -> Path:
        path = self.downloads / name
        self.until(lambda: path.exists() and not list(self.downloads.glob("*.crdownload")), f"{name} arrives")
        return path

    def picture(self) -> NDArray[np.float64]:
        """Take a picture of the 3-D canvas, ``(h, w, 3)`` from 0 to 1."""
        image = iio.imread(self.find("canvas")[0].screenshot_as_png)
        return np.asarray(image[..., :3] / 255.0)

    def wait_drawn(self) -> NDArray[np.float64]:
        """Wait until hand (dark) and object (orange) are on the canvas."""

        def drawn() -> list[NDArray[np.float64]]:
            picture = self.picture()
            dark = (picture.max(axis=2) < 0.5).mean()
            return [picture] if dark > 0.01 and orange(picture) > 0.002 else []

        found: list[NDArray[np.float64]] = self.until(drawn, "hand and object on the canvas")
        return found[0]

    def complaints(self) -> list[str]:
        """Read the errors on the browser's console since the last call."""
        return [entry["message"] for entry in self.chrome.get_log("browser") if entry["level"] == "SEVERE"]


def orange(picture: NDArray[np.float64]) -> float:
    """Measure the part of a picture that has the object's colour in some light."""
    bright = picture.max(axis=2, keepdims=True)
    hue = picture / np.maximum(bright, 1e-6)
    return float(((np.abs(hue - ORANGE).max(axis=2) < 0.2) & (bright[..., 0] > 0.4)).mean())

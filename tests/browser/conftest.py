"""A real Chromium, and a served page for it."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from graspcascade.core.protocols import PAPER
from graspcascade.hands import Hand
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.heuristic import Screened
from graspcascade.viewer import SampleRequest, sample_batch

if TYPE_CHECKING:
    from driver import Browser

    from graspcascade.viewer.page import Start

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",  # WebGL without a graphics card
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--no-first-run",
    "--host-resolver-rules=MAP rebound.example 127.0.0.1",  # a name that its owner points at this machine
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1200,900",
    "--force-device-scale-factor=0.4",  # the same layout with a sixth of the pixels to shade
)
OpenBrowser = Callable[[], "Browser"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put these tests last: a server's and a browser's threads should not run beside tests of other things."""
    here = Path(__file__).parent
    items.sort(key=lambda item: here in item.path.parents)


@pytest.fixture(scope="session")
def programs() -> tuple[str, str]:
    """Find Chromium and its driver: skip without them, except where CI says that everything must run."""
    paths = shutil.which("chromium"), shutil.which("chromedriver")
    if paths[0] is None or paths[1] is None:
        reason = "needs Chromium and its driver: apt-get install chromium chromium-driver"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return paths[0], paths[1]


@contextmanager
def opened(programs: tuple[str, str], folder: Path) -> Iterator["Browser"]:
    from driver import Browser
    from selenium.webdriver import Chrome, ChromeOptions
    from selenium.webdriver.chrome.service import Service

    options = ChromeOptions()
    options.binary_location = programs[0]
    for flag in (*FLAGS, f"--user-data-dir={folder / 'profile'}"):
        options.add_argument(flag)
    downloads = folder / "downloads"
    downloads.mkdir(parents=True)
    options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    chrome = Chrome(options=options, service=Service(programs[1]))
    try:
        yield Browser(chrome, downloads)
    finally:
        chrome.quit()


@pytest.fixture(scope="module")
def browser(programs: tuple[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator["Browser"]:
    with opened(programs, tmp_path_factory.mktemp("browser")) as one:
        yield one


@pytest.fixture
def second_browser(programs: tuple[str, str], tmp_path: Path) -> Iterator["Browser"]:
    with opened(programs, tmp_path) as one:
        yield one


@pytest.fixture(scope="module")
def start(hand: Hand) -> "Start":
    from graspcascade.viewer.page import Start

    sampler, request = GraspSampler.pretrained(), SampleRequest.of(n=4)
    return Start(sampler, hand, request, PAPER, sample_batch(sampler, hand, request))


@pytest.fixture(scope="module")
def any_size_address(hand: Hand) -> Iterator[str]:
    """Serve a page whose model takes objects of any size."""
    from graspcascade.viewer.page import Start
    from graspcascade.viewer.server import close_server, serve

    screened, request = Screened.pretrained(), SampleRequest.of("palmar_pinch", "cylinder:12x140mm", n=2)
    server = serve(Start(screened, hand, request, PAPER, sample_batch(screened, hand, request)), port=0)
    yield f"http://127.0.0.1:{server.get_port()}"
    close_server(server)


@pytest.fixture(scope="module")
def address(start: "Start") -> Iterator[str]:
    from graspcascade.viewer.server import close_server, serve

    server = serve(start, port=0)
    yield f"http://127.0.0.1:{server.get_port()}"
    close_server(server)

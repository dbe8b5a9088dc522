"""The served page as a browser speaks to it: what clicks do, what crafted values end in, whom the server answers."""

import gc
import os
import queue
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import pytest

if not os.environ.get("CI"):  # where everything must run, a missing package is an error
    pytest.importorskip("viser")

import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from graspcascade.core.errors import InputError
from graspcascade.core.objects import as_object
from graspcascade.core.protocols import PAPER
from graspcascade.hands import Hand
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.heuristic import Heuristic, Screened
from graspcascade.proposals.prior import PosturePrior
from graspcascade.viewer import Batch, SampleRequest, sample_batch
from graspcascade.viewer import server as server_module
from graspcascade.viewer.page import ANY_SIDE, OWN_SIZE, Page, Start, same_side, side_axis, side_choices
from graspcascade.viewer.server import close_server, open_server, serve, write_standalone

PATIENCE_S = 30.0
VISER = f"viser-v{viser.__version__}"
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, 1.0),
    "fov": 0.7,
    "near": 0.01,
    "far": 100.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}


class Watched(Page):
    """Tell whoever waits of everything that the page writes."""

    written: "queue.Queue[str]" = queue.Queue()
    last: "Watched"

    def __init__(self, client: viser.ClientHandle, start: Start) -> None:
        super().__init__(client, start)
        Watched.last = self
        self.written.put("ready")

    def say(self, text: str, *, error: bool = False) -> None:
        super().say(text, error=error)
        self.written.put(text)

    def write(self) -> None:
        super().write()
        self.written.put("")


class Visitor:
    """Speak to the server as viser's page does."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._send(CAMERA)
        self.wait(lambda text: text == "ready", "a page")
        self.page = Watched.last

    @property
    def panel(self) -> Any:
        return self.page.panel

    def change(self, name: str, value: object) -> None:
        uuid = getattr(self.panel, name)._impl.uuid
        self._send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})

    def press(self, name: str) -> None:
        self.change(name, True)

    def _send(self, message: dict[str, object]) -> None:
        self._socket.send(msgspec.msgpack.encode(message))

    def wait(self, happened: Callable[[str], object], what: str) -> None:
        while True:
            try:
                text = Watched.written.get(timeout=PATIENCE_S)
            except queue.Empty:
                pytest.fail(f"not within {PATIENCE_S} s: {what}")
            if happened(text):
                return

    def hears(self, words: str) -> None:
        self.wait(lambda text: words in text, words)


@pytest.fixture(scope="module")
def start(hand: Hand) -> Start:
    sampler, request = GraspSampler.pretrained(), SampleRequest.of(n=3)
    return Start(sampler, hand, request, PAPER, sample_batch(sampler, hand, request))


@pytest.fixture(scope="module")
def port(start: Start) -> Iterator[int]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(server_module, "Page", Watched)
        server = serve(start, port=0)
        yield server.get_port()
        close_server(server)


@pytest.fixture
def visitor(port: int) -> Iterator[Visitor]:
    Watched.written.queue.clear()
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[VISER], max_size=None) as socket:
        yield Visitor(socket)


def test_the_page_begins_with_the_settled_hand_and_its_verdict(visitor: Visitor) -> None:
    assert visitor.panel.view.value == "settled"
    about = visitor.panel.about.content
    assert '<span class="gc-shown">settled</span>' in about
    assert "protocol paper" in about
    assert "not tried yet" not in about
    assert "500 trials held, protocol paper" in visitor.panel.measured.content


@pytest.mark.parametrize("button", ["play", "try_all"])
@pytest.mark.parametrize("friction", [0.0, 99.0, float("nan")])
def test_a_friction_out_of_range_is_a_message_and_nothing_plays(
    visitor: Visitor, button: str, friction: float, capfd: pytest.CaptureFixture[str]
) -> None:
    visitor.change("friction", friction)
    visitor.hears("friction must be between")
    visitor.press(button)
    visitor.hears("friction must be between")
    assert visitor.panel.stop.disabled
    assert visitor.panel.view.value == "settled"
    visitor.change("friction", 0.8)
    visitor.hears("trials under protocol paper")
    assert capfd.readouterr() == ("", "")


CRAFTED = (
    ("side", "", "sample", "unknown side axis ''"),
    ("side", "w = 3 cm", "sample", "unknown side axis 'w'"),
    ("n", float("nan"), "sample", "n must be a whole number between 1 and 200, got nan"),
    ("n", 1e300, "sample", "n must be a whole number"),
    ("n", 2.5, "sample", "n must be a whole number"),
    ("n", 0, "sample", "n must be a whole number"),
    ("seed", float("inf"), "sample", "seed must be a whole number"),
    ("seed", -1, "sample", "seed must be a whole number"),
    ("grasp_type", "tripood", "sample", "Did you mean 'tripod'"),
    ("object", "teapot", "sample", "unknown object 'teapot'"),
    ("file_format", "docx", "download", "unknown format 'docx'"),
    ("speed", "", "play", "unknown speed ''"),
    ("view", "sideways", "", "unknown view 'sideways'"),
    ("grasp", float("nan"), "", "there is no grasp nan"),
    ("grasp", float("inf"), "", "there is no grasp inf"),
)


@pytest.mark.parametrize(("widget", "value", "button", "words"), CRAFTED)
def test_crafted_values_end_in_a_message(
    visitor: Visitor, widget: str, value: object, button: str, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    visitor.change(widget, value)
    if button:
        visitor.press(button)
    visitor.hears(words)
    assert 'data-kind="error"' in visitor.panel.message.content
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("value", ["many", None, [1, 2], {"a": 1}])
def test_values_of_another_type_are_ignored_without_a_word(
    visitor: Visitor, value: object, capfd: pytest.CaptureFixture[str]
) -> None:
    visitor.change("n", value)
    visitor.press("sample")
    visitor.hears("3 grasps sampled")
    gc.collect()
    assert capfd.readouterr() == ("", "")


def test_a_moment_that_is_no_number_is_the_start_or_the_end(visitor: Visitor) -> None:
    visitor.change("time", float("nan"))
    visitor.wait(lambda _: "trial at" in visitor.panel.about.content, "a moment of the trial")


def test_panel_and_scene_agree_after_playing_and_trying(visitor: Visitor) -> None:
    visitor.change("speed", "8 x")
    visitor.press("play")
    visitor.wait(lambda text: not text and visitor.panel.stop.disabled, "the end of the trial")
    visitor.press("try_all")
    visitor.hears("tried 3 of 3")
    assert visitor.panel.view.value == "trial"
    assert '<span class="gc-shown">trial at 7.7 s: carry</span>' in visitor.panel.about.content
    visitor.change("view", "settled")
    visitor.wait(lambda _: ">settled<" in visitor.panel.about.content, "the settled hand again")
    assert "3 of 3 tried held" in visitor.panel.table.content


def test_another_click_ends_what_plays(visitor: Visitor) -> None:
    visitor.change("speed", "0.25 x")
    visitor.press("play")
    visitor.wait(lambda _: not visitor.panel.stop.disabled, "the trial plays")
    visitor.change("grasp", 1)
    visitor.wait(lambda _: visitor.panel.stop.disabled, "the other grasp")
    assert visitor.page.session.index == 1
    assert visitor.panel.view.value == "trial"


def test_a_cell_that_rarely_holds_comes_with_a_warning(visitor: Visitor) -> None:
    visitor.change("grasp_type", "lateral_tripod")
    visitor.change("object", "sphere_small")
    visitor.wait(lambda _: "rarely hold" in visitor.panel.measured.content, "the warning")


def test_an_object_of_ones_own_size_is_sampled_and_shown(
    hand: Hand, prior: PosturePrior, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_module, "Page", Watched)
    heuristic, request = Screened(Heuristic(hand, prior)), SampleRequest.of(n=1)
    server = serve(Start(heuristic, hand, request, PAPER, sample_batch(heuristic, hand, request)), port=0)
    Watched.written.queue.clear()
    with connect(f"ws://127.0.0.1:{server.get_port()}", subprotocols=[VISER], max_size=None) as socket:
        visitor = Visitor(socket)
        assert visitor.panel.size.disabled
        visitor.change("object", OWN_SIZE)
        visitor.change("size", "box:32x41x80mm")
        visitor.wait(lambda _: visitor.panel.side.options == ("any", "x = 3.2 cm", "y = 4.1 cm"), "its sides")
        visitor.change("side", "y = 4.1 cm")
        visitor.press("sample")
        visitor.hears("1 grasps sampled")
        assert "has not been measured" in visitor.panel.measured.content
        visitor.change("size", "box:32x41")
        visitor.wait(lambda _: "lacks a unit" in visitor.panel.measured.content, "what is wrong with the size")
        assert visitor.page.session.grasp.side_axis.tolist() == ["y"]
    close_server(server)


def test_a_page_without_a_model_shows_its_grasps_and_says_what_sampling_needs(
    cut_hands: Mapping[int, Hand], prior: PosturePrior, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_module, "Page", Watched)
    hand = cut_hands[2]
    batch = sample_batch(Screened(Heuristic(hand, prior)), hand, SampleRequest.of("tip_pinch", "sphere_small", n=1))
    server = serve(Start(None, hand, SampleRequest.of(), PAPER, batch), port=0)
    Watched.written.queue.clear()
    with connect(f"ws://127.0.0.1:{server.get_port()}", subprotocols=[VISER], max_size=None) as socket:
        visitor = Visitor(socket)
        assert "settled" in visitor.panel.about.content
        assert "no model for hand_of_2" in visitor.panel.measured.content
        visitor.press("sample")
        visitor.hears("no model for hand_of_2 to sample from: give one by --model")
        assert visitor.page.session.batch is batch
    close_server(server)


# --- whom the server answers


def handshake(port: int, **options: Any) -> int:
    try:
        with connect(f"ws://127.0.0.1:{port}", subprotocols=[VISER], max_size=None, **options):
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


def test_only_the_servers_own_page_may_connect(port: int) -> None:
    own = f"http://127.0.0.1:{port}"
    assert handshake(port) == 101
    assert handshake(port, origin=own) == 101
    for foreign in ("http://evil.example", f"http://127.0.0.1:{port + 1}", f"http://localhost:{port}", "null"):
        assert handshake(port, origin=foreign) == 403


@pytest.mark.parametrize(
    ("host", "origin", "own"),
    [
        ("localhost:8080", "http://localhost:8080", True),
        ("LOCALHOST:8080", "http://localhost:8080", True),
        ("192.168.0.7:8080", "http://192.168.0.7:8080", True),
        ("[::1]:8080", "http://[::1]:8080", True),
        ("lab.example:8080", "http://lab.example:8080", True),
        ("localhost:8080", None, True),
        ("rebound.example:8080", "http://rebound.example:8080", False),
        ("rebound.example:8080", None, False),
        ("127.0.0.1.rebound.example", None, False),
        ("", None, False),
        ("localhost:8080", "https://evil.example", False),
    ],
)
def test_a_name_pointed_at_this_machine_is_not_its_own(host: str, origin: str | None, own: bool) -> None:
    headers = {"Host": host} | ({} if origin is None else {"Origin": origin})
    assert server_module.is_own_page(headers, "lab.example") is own


def test_a_viser_that_cannot_be_guarded_is_refused(hand: Hand, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped = []

    class Unguarded(viser.ViserServer):
        def __init__(self, *_: object, **__: object) -> None:
            pass

        def stop(self) -> None:
            stopped.append(self)

    monkeypatch.setattr(server_module, "_LocalServer", Unguarded)
    with pytest.raises(InputError, match=r"install viser 1\.1"):
        open_server("127.0.0.1", 0, hand)
    assert len(stopped) == 1


def test_a_server_says_nothing_and_leaves_its_port_free(hand: Hand, capsys: pytest.CaptureFixture[str]) -> None:
    server = open_server("127.0.0.1", 0, hand)
    port = server.get_port()
    with pytest.raises(InputError, match="in use"):
        open_server("127.0.0.1", port, hand)
    assert server.request_share_url() is None
    close_server(server)
    close_server(open_server("127.0.0.1", port, hand))
    assert capsys.readouterr() == ("", "")


# --- a page without a server


def test_a_standalone_page_holds_everything(start: Start, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    batch = Batch(start.batch.grasps[:2], "mine <b>")
    assert write_standalone(out, batch, start.hand, PAPER) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    page = out.read_text(encoding="utf-8")
    assert "<title>mine &lt;b&gt; - graspcascade</title>" in page
    assert page.count('class="gc-table"') == 1
    assert "2 of 2 tried held" in page
    assert "protocol paper" in page
    assert re.findall(r"""(?:src|href)=["']?https?:""", page) == []


# --- sides


def test_sides_are_those_the_hand_can_reach_round() -> None:
    large = side_choices(as_object("box_large"), 0.065)
    assert large == ("any", "x = 4 cm", "y = 5.5 cm")
    assert [side_axis(choice) for choice in large] == [None, "x", "y"]
    assert same_side(side_choices(as_object("sphere_small"), 0.065), "y") == ANY_SIDE
    assert same_side(side_choices(as_object("box_small"), 0.065), "y") == "y = 3 cm"
    assert side_choices(as_object("sphere:90mm"), 0.065) == ("any",)

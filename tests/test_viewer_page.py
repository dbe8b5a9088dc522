"""The served page as a browser speaks to it: what clicks do, what crafted values end in, whom the server answers."""

import asyncio
import contextlib
import gc
import gzip
import html
import logging
import os
import queue
import re
import socket
from collections.abc import Callable, Iterator, Mapping
from http.client import HTTPConnection
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import pytest

if not os.environ.get("CI"):  # where everything must run, a missing package is an error
    pytest.importorskip("viser")

import viser
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE, as_object
from graspcascade.core.protocols import PAPER, Conditions
from graspcascade.hands import Hand
from graspcascade.proposals import Proposal
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.heuristic import Heuristic, Screened
from graspcascade.proposals.prior import PosturePrior
from graspcascade.proposals.ranked import Ranked
from graspcascade.proposals.scorer import Chances, Scorer
from graspcascade.viewer import Batch, SampleRequest, guard, sample_batch
from graspcascade.viewer import server as server_module
from graspcascade.viewer.page import ANY_SIDE, Page, Start, same_side, side_axis, side_choices
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
        self.send(CAMERA)
        self.wait(lambda text: text == "ready", "a page")
        self.page = Watched.last

    @property
    def panel(self) -> Any:
        return self.page.panel

    def change(self, name: str, value: object) -> None:
        self.move(getattr(self.panel, name), value)

    def move(self, widget: Any, value: object) -> None:
        self.send({"type": "GuiUpdateMessage", "uuid": widget._impl.uuid, "updates": {"value": value}})

    def press(self, name: str) -> None:
        self.change(name, True)

    def send(self, message: object) -> None:
        self._socket.send(message if isinstance(message, bytes | str) else msgspec.msgpack.encode(message))

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
    # Reading on by itself, so that a goodbye is not waited for behind frames of a trial.
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[VISER], max_size=None, max_queue=None) as socket:
        yield Visitor(socket)


@pytest.fixture
def silent(capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Check that nothing was printed or logged, tracebacks of lost tasks included."""
    yield
    gc.collect()
    assert capfd.readouterr() == ("", "")
    assert [record.getMessage() for record in caplog.get_records("call") if record.levelno >= logging.WARNING] == []


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
    ("side", "", "", "unknown side ''"),
    ("side", "w = 3 cm", "", "unknown side 'w = 3 cm'"),
    ("flip", "sideways", "", "unknown flip 'sideways'"),
    ("scope", "", "", "unknown scope ''"),
    ("n", float("nan"), "sample", "n must be a whole number between 1 and 200, got nan"),
    ("n", 1e300, "sample", "n must be a whole number"),
    ("n", 2.5, "sample", "n must be a whole number"),
    ("n", 0, "sample", "n must be a whole number"),
    ("seed", float("inf"), "sample", "seed must be a whole number"),
    ("seed", -1, "sample", "seed must be a whole number"),
    ("grasp_type", "tripood", "", "Did you mean 'tripod'"),
    ("object", "teapot", "", "unknown object 'teapot'"),
    ("file_format", "docx", "", "unknown file format 'docx'"),
    ("speed", "", "", "unknown speed ''"),
    ("view", "sideways", "", "unknown view 'sideways'"),
    ("grasp", float("nan"), "", "grasp must be between 0 and 2, got nan"),
    ("grasp", float("inf"), "", "grasp must be between 0 and 2, got inf"),
    ("grasp", 3, "", "grasp must be between 0 and 2, got 3"),
    ("time", float("nan"), "", "time must be between 0 and 7.7, got nan"),
    ("time", -1, "", "time must be between 0 and 7.7, got -1"),
    ("n", "many", "", "n must be a number, got 'many'"),
    ("n", "7", "", "n must be a number, got '7'"),
    ("n", True, "", "n must be a number, got True"),
    ("object", 3, "", "object must be text, got 3.0"),
    ("sample", "yes", "", "sample must be true or false, got 'yes'"),
    ("object", "x" * 90_000, "", "unknown object 'xxx"),
)


@pytest.mark.parametrize(("widget", "value", "button", "words"), CRAFTED)
def test_crafted_values_end_in_a_message(
    visitor: Visitor, widget: str, value: object, button: str, words: str, silent: None
) -> None:
    visitor.change(widget, value)
    if button:
        visitor.press(button)
    visitor.hears(words)
    assert 'data-kind="error"' in visitor.panel.message.content


def test_a_refused_value_leaves_the_widget_as_it_was(visitor: Visitor) -> None:
    for name, value in (("side", ""), ("n", "7"), ("n", True), ("grasp", 9), ("view", "sideways")):
        before = getattr(visitor.panel, name).value
        visitor.change(name, value)
        visitor.wait(bool, "a message")
        assert getattr(visitor.panel, name).value == before
    visitor.press("sample")
    visitor.hears("3 grasps sampled")


def frames(panel: Any) -> list[object]:
    """List messages that no page sends: bytes and text as they are, anything else to be packed."""
    uuid = panel.n._impl.uuid
    update, upload = {"type": "GuiUpdateMessage", "uuid": uuid}, {"transfer_uuid": "x", "source_component_uuid": uuid}
    start = {"filename": "a", "mime_type": "b", "part_count": 1, "size_bytes": 4}
    inner = ({"update_cb": [1]}, {"removed": True}, {"is_button": True}, {"value": 4, "uuid": "x"}, {"nothing": 1})
    values = (None, [1, 2], {"a": 1}, b"4", [[]] * 1_000)
    return [
        "text",
        b"",
        b"\xc1",
        b"\x91" * 50_000 + b"\xc0",
        b"\xdf\xff\xff\xff\xff",
        None,
        [1, 2],
        {},
        {"type": "Unknown"},
        {"type": ["GuiUpdateMessage"]},
        {"type": "ViewerCameraMessage"},
        CAMERA | {"wxyz": (float("nan"),) * 4},
        CAMERA | {"wxyz": (1.0,)},
        CAMERA | {"position": [0.0] * 5_000},
        CAMERA | {"fov": "wide"},
        CAMERA | {"far": float("inf")},
        CAMERA | {"image_width": -1},
        CAMERA | {"more": 1},
        update,
        update | {"updates": 3},
        update | {"updates": {"value": 4}, "more": 1},
        update | {"uuid": "of no widget", "updates": {"value": 4}},
        *(update | {"updates": part} for part in inner),
        *(update | {"updates": {"value": value}} for value in values),
        {"type": "FileTransferStartUpload"} | upload | start,
        {"type": "FileTransferPart", "part_index": 0, "content": b"1234"} | upload,
        {"type": "ShareUrlRequest"},
        {"type": "GuiButtonHoldMessage", "uuid": uuid, "frequency": 10.0},
        {"type": "GuiFormSubmitMessage", "uuid": uuid},
        {"type": "GuiRemoveMessage", "uuid": uuid},
    ]


def test_messages_that_no_page_sends_are_dropped_without_a_word(visitor: Visitor, silent: None) -> None:
    state = vars(visitor.panel.n._impl).copy()
    for frame in frames(visitor.panel):
        visitor.send(frame)
    visitor.press("sample")
    visitor.hears("3 grasps sampled")
    assert vars(visitor.panel.n._impl) == state


def read_on(socket: ClientConnection) -> None:
    while True:
        socket.recv(PATIENCE_S)


def test_a_message_too_large_ends_the_connection(port: int, silent: None) -> None:
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[VISER], max_size=None) as socket:
        socket.send(bytes(200_000))
        with pytest.raises(ConnectionClosedError, match="exceeds limit"):
            read_on(socket)
    assert handshake(port) == 101


def test_many_changes_at_once_end_in_the_last_and_few_are_worked_on(
    visitor: Visitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[int] = []
    look = Page._look

    def counted(page: Page) -> None:
        looked.append(page.session.index)
        look(page)

    monkeypatch.setattr(Page, "_look", counted)
    with visitor.page.lock:  # as if a trial took its time
        for number in range(120):
            visitor.change("grasp", (0, 2, 1)[number % 3])
        visitor.change("object", "teapot")  # what comes behind them all is answered without waiting for a turn
        visitor.hears("unknown object")
        assert looked == []
    visitor.wait(lambda _: visitor.page.session.index == 1, "the last grasp asked for")
    visitor.press("sample")
    visitor.hears("3 grasps sampled")
    assert 1 in looked
    assert len(looked) < 10


def test_fast_clicks_on_next_all_count(visitor: Visitor) -> None:
    with visitor.page.lock:
        for _ in range(5):
            visitor.change("flip", "next")
        visitor.change("object", "teapot")
        visitor.hears("unknown object")
    visitor.wait(lambda _: visitor.page.session.index == 5 % 3, "the grasp five further")


def test_a_browser_that_floods_is_read_no_faster_than_a_page_sends(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, taken = [100.0], list[str]()

    async def recv(*_: object) -> bytes:
        message = {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": True}}
        return msgspec.msgpack.encode(message)

    async def sleep(seconds: float) -> None:
        clock[0] += seconds

    def takes(uuid: str, value: object) -> bool:
        taken.append(uuid)
        return len(taken) % 2 == 0

    async def read(visitor: guard._Visitor, count: int) -> None:
        for _ in range(count):
            await visitor.recv()

    monkeypatch.setattr(ServerConnection, "recv", recv)
    monkeypatch.setattr("graspcascade.viewer.guard.asyncio.sleep", sleep)
    monkeypatch.setattr("graspcascade.viewer.guard.time.monotonic", lambda: clock[0])
    visitor = guard._Visitor.__new__(guard._Visitor)
    visitor._takes, visitor._due_s = takes, 0.0
    asyncio.run(read(visitor, 40))
    assert clock[0] == 100.0, "a moment's burst is read at once"
    asyncio.run(read(visitor, 960))
    assert len(taken) == 2_000, "what is refused counts as well"
    assert clock[0] == pytest.approx(100.0 + 2_000 * 0.01 - 1.0)


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


# --- objects of any size, and chances


@pytest.fixture
def visit(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[Start], Visitor]]:
    """Serve pages of one's own and speak to them."""
    monkeypatch.setattr(server_module, "Page", Watched)
    with contextlib.ExitStack() as opened:

        def begin(start: Start) -> Visitor:
            server = serve(start, port=0)
            opened.callback(close_server, server)
            Watched.written.queue.clear()
            address = f"ws://127.0.0.1:{server.get_port()}"
            return Visitor(opened.enter_context(connect(address, subprotocols=[VISER], max_size=None)))

        yield begin


class Guess(Scorer):
    """Call every grasp as likely to succeed as the friction is high."""

    seen: ClassVar[dict[str, tuple[float, float]]] = {}

    def __init__(self) -> None:
        pass

    def chances(self, grasps: Grasps, conditions: Conditions | None = None, *, is_exact: bool = False) -> Chances:
        assert conditions is not None
        return Chances(conditions.friction - 0.1, conditions.friction - 0.1)

    def fingerprint(self) -> str:
        return "guess"


def started(proposal: Proposal, **asked: Any) -> Start:
    request = SampleRequest.of(**asked)
    return Start(proposal, proposal.hand, request, PAPER, sample_batch(proposal, proposal.hand, request))


def test_a_size_set_by_sliders_is_sampled_and_shown(
    hand: Hand, prior: PosturePrior, visit: Callable[[Start], Visitor]
) -> None:
    visitor = visit(started(Screened(Heuristic(hand, prior)), n=1))
    panel = visitor.panel
    assert panel.object.options == (*CATALOGUE, "box, own size", "cylinder, own size", "sphere, own size")
    assert not any(slider.visible for slider in panel.size_sliders)
    for kind, sizes in (("cylinder", 2), ("sphere", 1), ("box", 3)):
        visitor.change("object", f"{kind}, own size")
        own = panel.sizes[f"{kind}, own size"].sliders
        assert len(own) == sizes
        visitor.wait(lambda _, own=own: [s for s in panel.size_sliders if s.visible] == own, f"sliders of a {kind}")
    visitor.move(own[2], 80)
    visitor.wait(lambda _: panel.side.options == ("any", "x = 3 cm", "y = 4.5 cm"), "its sides")
    assert "has not been measured" in panel.measured.content
    visitor.change("side", "y = 4.5 cm")
    visitor.press("sample")
    visitor.hears("1 grasps sampled")
    assert visitor.page.session.grasp.side_axis.tolist() == ["y"]
    assert visitor.page.session.grasp.object_name.tolist() == ["box:30x45x80mm"]
    visitor.change("object", "box_medium")
    visitor.wait(lambda _: not any(slider.visible for slider in panel.size_sliders), "no sliders")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0, 0.0, 14.9, 90.1, 1e300, "40", True])
def test_a_size_that_its_slider_does_not_reach_is_refused(
    hand: Hand, prior: PosturePrior, visit: Callable[[Start], Visitor], value: object, silent: None
) -> None:
    visitor = visit(started(Screened(Heuristic(hand, prior)), n=1, object="box:30x30x30mm"))
    slider = visitor.panel.size_sliders[0]
    visitor.move(slider, value)
    visitor.hears("x mm must be a number" if isinstance(value, str | bool) else "x mm must be between 15 and 90, got")
    assert slider.value == 30.0


def test_a_size_that_the_hand_cannot_hold_is_told_before_it_is_sampled(
    hand: Hand, prior: PosturePrior, visit: Callable[[Start], Visitor]
) -> None:
    visitor = visit(started(Screened(Heuristic(hand, prior)), n=1, object="box:60x70x80mm"))
    visitor.move(visitor.panel.size_sliders[0], 66)
    words = "no side of box:66x70x80mm is within the hand's reach of 6.5 cm"
    visitor.wait(lambda _: html.escape(words) in visitor.panel.measured.content, "a word")
    visitor.press("sample")
    visitor.hears(words)


@pytest.mark.parametrize("size", ["cylinder:12x140mm", "box:32.5x41x60mm", "sphere:19.75mm", "box:16x20x150mm"])
def test_a_page_begins_with_any_size_that_it_was_started_with(
    hand: Hand, prior: PosturePrior, visit: Callable[[Start], Visitor], size: str
) -> None:
    panel = visit(started(Screened(Heuristic(hand, prior)), n=1, object=size, side_axis="x")).panel
    assert panel.object.value == f"{size.partition(':')[0]}, own size"
    assert panel.request().object == as_object(size)
    assert [slider.visible for slider in panel.sizes[panel.object.value].sliders] == [True] * (size.count("x", 3) + 1)


def test_a_model_that_knows_objects_by_name_offers_these_and_says_so(visitor: Visitor) -> None:
    assert visitor.panel.object.options == tuple(CATALOGUE)
    assert visitor.panel.size_sliders == []
    assert "model3 knows these 9 objects by name and no other size" in visitor.panel.known.content
    visitor.change("object", "box, own size")
    visitor.hears("unknown object 'box, own size'")


def test_a_ranked_model_is_asked_for_grasps_that_hold_at_a_friction_and_says_how_likely(
    hand: Hand, prior: PosturePrior, visit: Callable[[Start], Visitor]
) -> None:
    visitor = visit(started(Ranked(Screened(Heuristic(hand, prior)), Guess(), most_draws=1), n=2))
    panel = visitor.panel
    assert "each grasp's chance is estimated" in panel.measured.content
    assert "chance of success 70 %" in panel.about.content
    assert "chance of success at friction 0.8: 70 % on average" in panel.table.content
    visitor.change("assumed", 0.55)
    visitor.press("sample")
    visitor.hears("2 grasps sampled. ")  # and what the model has to say of them
    assert "chance below 50" in panel.message.content
    assert "chance of success 45 %: <b>likely to fail</b>" in panel.about.content
    assert "at friction 0.55: 45 % on average. <b>Most such grasps are expected to fail.</b>" in panel.table.content
    asked = visitor.page.session.batch.metadata
    assert (asked["asked"]["friction"], asked["ranking"]["friction"]) == (0.55, 0.55)
    assert visitor.page.session.protocol is PAPER
    for beyond in (0.4, 1.1, float("nan")):
        visitor.change("assumed", beyond)
        visitor.hears("assumed must be between 0.5 and 1, got")


def test_only_a_ranked_model_has_a_friction_to_assume(visitor: Visitor) -> None:
    assert visitor.panel.assumed is None
    assert "chance" not in visitor.panel.about.content + visitor.panel.table.content


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


def asked(port: int, *headers: str, upgrade: bool) -> int:
    """Ask for the page, or to connect to it, and read the status."""
    lines = ["GET / HTTP/1.1", *headers]
    if upgrade:
        lines += ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
        lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", f"Sec-WebSocket-Protocol: {VISER}"]
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as plain:
        plain.sendall("".join(f"{line}\r\n" for line in (*lines, "")).encode())
        return int(plain.recv(4_096).split()[1])


@pytest.mark.parametrize("upgrade", [False, True])
def test_the_page_and_its_connection_are_for_its_own_names_alone(port: int, upgrade: bool, silent: None) -> None:
    allowed = 101 if upgrade else 200
    for host in (f"127.0.0.1:{port}", f"localhost:{port}", f"[::1]:{port}", "lab.localhost"):
        assert asked(port, f"Host: {host}", upgrade=upgrade) == allowed
        assert asked(port, f"Host: {host}", f"Origin: http://{host}", upgrade=upgrade) == allowed
        for origin in ("http://evil.example", "null", "", "http://[", f"http://{host}.evil.example", f"file://{host}"):
            assert asked(port, f"Host: {host}", f"Origin: {origin}", upgrade=upgrade) == 403
    for host in (f"rebound.example:{port}", "192.168.0.7", "", "[::1", "a@localhost", "localhost:x", "localhost\xa0"):
        assert asked(port, f"Host: {host}", upgrade=upgrade) == 403
        assert asked(port, f"Host: {host}", f"Origin: http://{host}", upgrade=upgrade) == 403
    own = f"Origin: http://localhost:{port}"
    assert asked(port, upgrade=upgrade) == 403
    assert asked(port, "Host: localhost", "Host: evil.example", upgrade=upgrade) == 403
    assert asked(port, f"Host: localhost:{port}", own, "Origin: http://evil.example", upgrade=upgrade) == 403


def test_hosts_that_were_allowed_are_answered(hand: Hand) -> None:
    server = open_server("127.0.0.1", 0, hand, ["Lab.example"])
    port = server.get_port()
    for host, status in (("lab.example", 200), ("LAB.example:443", 200), ("lab.example.evil", 403)):
        assert asked(port, f"Host: {host}", upgrade=False) == status
    assert asked(port, "Host: lab.example", "Origin: https://lab.example", upgrade=True) == 101
    assert asked(port, "Host: lab.example", "Origin: https://evil.example", upgrade=True) == 403
    close_server(server)
    for name in ("http://lab.example", "lab.example:80", "", "*"):
        with pytest.raises(InputError, match="a host to allow is a name"):
            open_server("127.0.0.1", 0, hand, [name])


def test_what_is_no_request_is_answered_without_a_word(port: int, silent: None) -> None:
    for nonsense in (
        b"GARBAGE\r\n\r\n",
        b"\x16\x03\x01" * 100,
        b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"\r\n\r\n",
    ):
        with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as plain:
            plain.sendall(nonsense)
            plain.shutdown(socket.SHUT_WR)
            while plain.recv(4_096):
                pass
    assert handshake(port) == 101


def test_another_sites_page_cannot_show_this_one_under_its_own(port: int) -> None:
    connection = HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    for packed in ("identity", "gzip"):
        connection.request("GET", "/", headers={"Accept-Encoding": packed})
        answer = connection.getresponse()
        assert answer.headers["X-Frame-Options"] == "DENY"
        page = answer.read()
        assert b"<title>graspcascade</title>" in (gzip.decompress(page) if packed == "gzip" else page)
        connection.close()


def test_more_browsers_than_can_be_served_are_turned_away(
    visitor: Visitor, port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guard, "MAX_BROWSERS", 1)
    assert handshake(port) == 503
    visitor.press("sample")
    visitor.hears("3 grasps sampled")


def test_only_the_servers_own_page_may_connect(port: int) -> None:
    own = f"http://127.0.0.1:{port}"
    assert handshake(port) == 101
    assert handshake(port, origin=own) == 101
    for foreign in ("http://evil.example", f"http://127.0.0.1:{port + 1}", f"http://localhost:{port}", "null"):
        assert handshake(port, origin=foreign) == 403


@pytest.mark.parametrize(
    ("listens", "asked", "own"),
    [
        ("127.0.0.1", "LOCALHOST:8080", True),
        ("127.0.0.1", "127.0.0.2:8080", True),
        ("127.0.0.1", "192.168.0.7:8080", False),
        ("127.0.0.1", "rebound.example:8080", False),
        ("127.0.0.1", "127.0.0.1.rebound.example", False),
        ("127.0.0.1", socket.gethostname(), False),
        ("lab.example", "lab.example:8080", True),
        ("lab.example", "lab.example.:8080", True),
        ("lab.example", "lab.example.org", False),
        ("192.168.0.7", "192.168.0.7:8080", True),
        ("192.168.0.7", "192.168.0.8:8080", False),
        ("fe80::1", "[FE80::1]:8080", True),
        ("0.0.0.0", "192.168.0.7:8080", True),
        ("0.0.0.0", f"{socket.gethostname()}:8080", True),
        ("0.0.0.0", "rebound.example:8080", False),
        ("::", "[2001:db8::7]:8080", True),
        ("", "192.168.0.7", True),
    ],
)
def test_a_server_knows_its_names_by_where_it_listens(listens: str, asked: str, own: bool) -> None:
    assert guard.is_own_page(Headers(Host=asked), listens) is own
    assert guard.is_own_page(Headers(Host=asked, Origin=f"http://{asked}"), listens) is own
    assert not guard.is_own_page(Headers(Host=asked, Origin="http://evil.example"), listens)


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

"""One browser's page: its panel, scene and session, and what each click does."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass, fields
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

import viser

from ..core.errors import InputError, check_name, shortened
from ..core.families import FAMILIES
from ..core.objects import CATALOGUE, SHAPES, Box, Cylinder, GraspObject, Shape, Sphere
from ..core.protocols import Protocol
from ..core.taxonomy import GRASP_TYPES, as_type
from ..formats import FORMATS_BY_NAME
from ..hands import Hand
from ..proposals import Proposal
from ..proposals.ranked import Ranked
from .guard import Value
from .recording import Frame, Recording
from .session import VIEWS, Batch, SampleRequest, Session, measured, pack, sample_batch, with_friction
from .shapes import SceneNodes
from .words import grasp_html, hint_html, measured_html, message_html, table_html

P = ParamSpec("P")
T = TypeVar("T")
ANY_SIDE = "any"
TRIAL = "trial"
SPEEDS = {"0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0, "4 x": 4.0, "8 x": 8.0}
THIS, ALL = "this grasp", "all grasps"
PREVIOUS, NEXT = "previous", "next"
_FRAME_S = 0.04
"""Least time between two frames sent while a trial plays."""
_VIEW_HINT = (
    "settled: where closing ended in physics; pregrasp: before closing; target: the joint angles commanded, which "
    "reach into the object and so squeeze it; trial: the moment below"
)
_BY_NAME = (
    "{} knows these {} objects by name and no other size. Started with --model screened, the page takes any size."
)
_ASSUMED = "Friction that sampled grasps should hold at; their chances are estimated for it"
_FRICTION = (0.5, 1.0)
"""What protocol `varied` draws, for scorers that do not say what they saw."""
_FIRST_SHAPES: tuple[Shape, ...] = (Box(0.032, 0.041, 0.06), Cylinder(0.027, 0.08), Sphere(0.04))


@dataclass(frozen=True)
class Start:
    """What every browser begins with: the panel set to a request, the first grasps and a message.

    The proposal is None for a hand that there is no model of, to look at a file alone.
    """

    proposal: Proposal | None
    hand: Hand
    request: SampleRequest
    protocol: Protocol
    batch: Batch
    note: str = ""


def own_size(shape: Shape | type[Shape]) -> str:
    """Word the choice of a shape whose sizes are chosen by sliders."""
    return f"{shape.kind}, own size"


class SizeSliders:
    """A slider for each size of a shape, millimetres, as far as its family goes and at least to a size given."""

    def __init__(self, gui: viser.GuiApi, shape: Shape, *, visible: bool) -> None:
        (family,) = (family for family in FAMILIES.values() if family.shape is type(shape))
        self._shape = type(shape)
        self.sliders = []
        for field, size_m, (low_m, high_m) in zip(fields(shape), astuple(shape), family.ranges_m, strict=True):
            low, value, high = (round(1000 * each, 3) for each in (min(low_m, size_m), size_m, max(high_m, size_m)))
            label = f"{field.name.removesuffix('_m')} mm"
            self.sliders.append(gui.add_slider(label, low, high, 1.0, value, visible=visible))

    def chosen(self) -> GraspObject:
        """Make the object of the sizes chosen."""
        # To the micrometre: a browser may send any number of digits.
        shape = self._shape(*(round(slider.value / 1000, 6) for slider in self.sliders))
        return GraspObject(shape.spelling(), shape)

    def show(self, visible: bool) -> None:
        """Show or hide the sliders."""
        for slider in self.sliders:
            slider.visible = visible


class Panel:
    """The widgets of one browser; values that it sends must be of their kind, and are checked where they are used."""

    def __init__(self, gui: viser.GuiApi, start: Start) -> None:
        request, physics, schedule = start.request, start.protocol.physics, start.protocol.schedule
        self.reach_m, proposal, obj = start.hand.reach_m, start.proposal, request.object
        known = CATALOGUE.values() if proposal is None else proposal.objects
        self.objects = {one.name: one for one in known}
        self.sizes: dict[str, SizeSliders] = {}
        any_size = proposal is not None and proposal.takes_any_size
        own = own_size(obj.shape) if any_size else next(iter(self.objects))
        first = obj.name if self.objects.get(obj.name) == obj else own
        with gui.add_folder("Sample"):
            types = tuple(kind.name for kind in start.hand.grasp_types) or tuple(GRASP_TYPES)
            begin = request.grasp_type.name if request.grasp_type.name in types else types[0]
            self.grasp_type = gui.add_dropdown("type", types, initial_value=begin)
            choices = (*self.objects, *(map(own_size, SHAPES.values()) if any_size else ()))
            self.object = gui.add_dropdown("object", choices, initial_value=first)
            if any_size:
                for shape in {type(one): one for one in (*_FIRST_SHAPES, obj.shape)}.values():
                    choice = own_size(shape)
                    self.sizes[choice] = SizeSliders(gui, shape, visible=choice == first)
            elif proposal is not None:
                self.known = gui.add_html(hint_html(_BY_NAME.format(proposal.name, len(self.objects))))
            sides = side_choices(self.chosen_object(), self.reach_m)
            self.side = gui.add_dropdown("held by", sides, hint="Side that the opposing digits span")
            self.assumed = None
            if isinstance(proposal, Ranked):
                seen = (*proposal.scorer.seen.get("friction", _FRICTION), proposal.friction)
                self.assumed = gui.add_slider("assumed friction", min(seen), max(seen), 0.05, seen[-1], hint=_ASSUMED)
            self.n = gui.add_number("n", float(request.n), step=1, hint="How many grasps")
            self.seed = gui.add_number("seed", float(request.seed), step=1, hint="The same seed gives the same grasps")
            self.measured = gui.add_html("")
            self.sample = gui.add_button("Sample", color="blue")
        with gui.add_folder("Grasp"):
            self.about = gui.add_html("")
            self.grasp = gui.add_slider("grasp", 0.0, max(request.n - 1.0, 1.0), 1.0, 0.0)
            self.flip = gui.add_button_group("flip", (PREVIOUS, NEXT))
            self.view = gui.add_dropdown("show", (*VIEWS, TRIAL), hint=_VIEW_HINT)
        with gui.add_folder("Physics trial"):
            self.friction = gui.add_number(
                "friction", float(physics.friction), step=0.1, hint="Sliding, of hand and object"
            )
            self.play = gui.add_button("Play trial", color="teal")
            self.stop = gui.add_button("Stop", color="gray", disabled=True)
            self.speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 x")
            duration = round(schedule.total_steps * physics.time_step_s, 2)
            self.time = gui.add_slider("time s", 0.0, duration, 0.02, 0.0, hint="Of the trial of this grasp")
            self.try_all = gui.add_button("Try all", hint="Execute every grasp that was not tried yet")
        tables = gui.add_panel()
        with tables.add_tab("Samples"):
            # Here a message is in sight wherever the controls are scrolled to.
            self.message = gui.add_html(message_html(""))
            self.table = gui.add_html("")
            with gui.add_folder("Download"):
                self.scope = gui.add_dropdown("what", (THIS, ALL), initial_value=ALL)
                self.file_format = gui.add_dropdown("format", tuple(FORMATS_BY_NAME))
                self.download = gui.add_button("Download")
        tables.float(x=15, y=-15, width=330)
        put(self.side, same_side(sides, request.side_axis))
        inputs = [(name.replace("_", " "), part) for name, part in vars(self).items() if hasattr(part, "value")]
        inputs += [(slider.label, slider) for slider in self.size_sliders]
        self.inputs = {part._impl.uuid: (name, part) for name, part in inputs if part.value is not None}

    @property
    def size_sliders(self) -> list[viser.GuiSliderHandle[float]]:
        """Sliders of all shapes."""
        return [slider for size in self.sizes.values() for slider in size.sliders]

    def check(self, uuid: str, value: Value) -> None:
        """Check that a value can be that of the widget of an id, or raise `InputError`."""
        name, widget = self.inputs[uuid]
        if type(value) is not type(widget.value):
            kinds = {float: "a number", str: "text", bool: "true or false"}
            raise InputError(f"{name} must be {kinds[type(widget.value)]}, got {shortened(repr(value))}")
        if isinstance(widget, viser.GuiSliderHandle) and not widget.min <= float(value) <= widget.max:
            raise InputError(f"{name} must be between {widget.min:g} and {widget.max:g}, got {value:g}")
        if options := getattr(widget, "options", None):
            check_name(name, str(value), options)

    def chosen_object(self) -> GraspObject:
        """Read the object chosen."""
        choice = self.object.value
        return self.objects[choice] if choice in self.objects else self.sizes[choice].chosen()

    def request(self) -> SampleRequest:
        """Read what is asked for, or raise `InputError`."""
        axis, friction = side_axis(self.side.value), None if self.assumed is None else self.assumed.value
        kind, obj = self.grasp_type.value, self.chosen_object()
        return SampleRequest.of(kind, obj, axis, self.n.value, self.seed.value, friction)


def put(widget: Any, value: Any) -> None:
    """Write a value into a widget; a type checker does not find viser's setter."""
    widget.value = value


def side_choices(obj: GraspObject, reach_m: float) -> tuple[str, ...]:
    """Word the sides an object can be held by, and the choice to draw among them."""
    return (ANY_SIDE, *(f"{axis} = {site.width_m * 100:g} cm" for axis, site in obj.sites(reach_m).items()))


def side_axis(choice: str) -> str | None:
    """Read the axis off a choice of `side_choices`."""
    return None if choice == ANY_SIDE else choice.partition(" ")[0]


def same_side(choices: Iterable[str], axis: str | None) -> str:
    """Find the choice of an axis among another object's, or any side where it has none such."""
    return next((choice for choice in choices if side_axis(choice) == axis), ANY_SIDE)


def _reported(method: Callable[Concatenate[Page, P], T]) -> Callable[Concatenate[Page, P], T | None]:
    """Make of input that a method cannot use a message on the page; it then returns None."""

    @wraps(method)
    def act(page: Page, /, *args: P.args, **options: P.kwargs) -> T | None:
        try:
            return method(page, *args, **options)
        except InputError as error:
            page.say(str(error), error=True)
            page.write()
            return None

    return act


def _action(method: Callable[Concatenate[Page, P], T]) -> Callable[Concatenate[Page, P], T | None]:
    """Let a method do what a click asks for alone, ending what plays; what cannot be done becomes a message.

    It is left out while another call of it waits for its turn: that one will read what the widgets say then.
    """
    reported, name = _reported(method), method.__name__

    @wraps(method)
    def act(page: Page, /, *args: P.args, **options: P.kwargs) -> T | None:
        page.close()
        if name in page.waiting:
            return None
        page.waiting.add(name)
        with page.lock:
            page.waiting.discard(name)
            page.close()  # whoever had the lock may have begun to play
            page.panel.stop.disabled = True
            return reported(page, *args, **options)

    return act


class Page:
    """Wire the widgets of one browser to its session.

    Clicks arrive on several threads; a lock lets one at a time change session and scene. A trial that plays gives the
    lock back between frames and ends as soon as anything else is asked for.
    """

    def __init__(self, client: viser.ClientHandle, start: Start) -> None:
        self.lock, self.waiting, self._summing = threading.RLock(), set[str](), threading.Lock()
        self.session = Session(start.batch, start.hand, start.protocol)
        self._client, self._start = client, start
        self._halt = threading.Event()
        self._shown = ""  # words for what the scene shows; the panel never says anything else
        with client.atomic():
            self._nodes = SceneNodes(client.scene, start.hand)
            self.panel = Panel(client.gui, start)
            self._describe_choice()
            self._show_new(start.note)
        self._connect()

    @property
    def _proposal(self) -> Proposal:
        if self._start.proposal is None:
            raise InputError(f"no model for {self._start.hand.name} to sample from: give one by --model")
        return self._start.proposal

    def close(self) -> None:
        """End what still plays."""
        self._halt.set()

    def takes(self, uuid: str, value: Value) -> bool:
        """Tell whether a value that a browser sent is for a widget of this page that can take it, or say why not."""
        if uuid not in self.panel.inputs:
            return False
        try:
            self.panel.check(uuid, value)
        except InputError as error:
            self.say(str(error), error=True)
            return False
        return True

    def say(self, text: str, *, error: bool = False) -> None:
        """Put a message on the page."""
        self.panel.message.content = message_html(text, error=error)

    def _connect(self) -> None:
        c = self.panel

        def by_hand(widget: Any, act: Callable[[], None]) -> None:
            """Act when a person changed a widget, not when the page itself wrote into it."""
            widget.on_update(lambda event: None if event.client is None else act())

        for choice in (c.grasp_type, c.object, *c.size_sliders):
            by_hand(choice, self._choose)
        by_hand(c.grasp, self._go)
        by_hand(c.view, lambda: _action(Page._look)(self))
        by_hand(c.time, self._scrub)
        by_hand(c.friction, self._choose_friction)
        c.sample.on_click(lambda _: self._sample())
        c.flip.on_click(lambda _: self._flip(1 if c.flip.value == NEXT else -1))
        c.play.on_click(lambda _: self._play())
        c.stop.on_click(lambda _: _action(Page.write)(self))
        c.try_all.on_click(lambda _: self._try_all())
        c.download.on_click(lambda _: self._download())

    @_action
    def _choose(self) -> None:
        for choice, size in self.panel.sizes.items():
            size.show(choice == self.panel.object.value)
        self._describe_choice()
        self.write()

    def _describe_choice(self) -> None:
        """Offer the sides of the object chosen, and say how often such grasps hold."""
        c, axis = self.panel, side_axis(self.panel.side.value)
        choices: tuple[str, ...] = (ANY_SIDE,)
        try:
            kind, obj = as_type(c.grasp_type.value), c.chosen_object()
            choices = side_choices(obj, c.reach_m)
            if choices == (ANY_SIDE,):
                raise InputError(f"no side of {obj.name} is within the hand's reach of {c.reach_m * 100:g} cm")
            rate, estimated = measured(self._proposal, kind, obj), c.assumed is not None
            c.measured.content = measured_html(rate, estimated=estimated)
        except InputError as error:
            c.measured.content = measured_html(None, str(error))
        if c.side.options != choices:
            c.side.options = choices
            put(c.side, same_side(choices, axis))

    @_action
    def _sample(self) -> None:
        self.session.show(sample_batch(self._proposal, self._start.hand, self.panel.request()))
        if self.panel.view.value == TRIAL:
            put(self.panel.view, VIEWS[0])
        self._show_new(f"{len(self.session)} grasps sampled")

    @_action
    def _choose_friction(self) -> None:
        self._apply_friction()
        self._look()
        self.say(f"trials under protocol {self.session.protocol.name}")

    def _flip(self, by: int) -> None:
        # Summed up at once: of fast clicks each counts, though one move is made for all that wait.
        with self._summing:
            put(self.panel.grasp, (self.panel.grasp.value + by) % len(self.session))
        self._go()

    @_action
    def _go(self) -> None:
        self.session.go(round(self.panel.grasp.value))
        put(self.panel.grasp, float(self.session.index))
        self._look()

    def _look(self) -> None:
        """Show the present grasp in the view chosen."""
        self.say("")
        view = self.panel.view.value
        if view == TRIAL:
            recording = self.session.recording()
            self._show_moment(recording, recording.row_at(self.panel.time.value))
        else:
            frame = self.session.frame(view)
            closed = view != "settled" or self.session.closed
            self._display(frame, view if closed else "where its trial ended, before the hand had closed")
        self.write()

    @_action
    def _scrub(self) -> None:
        put(self.panel.view, TRIAL)
        self._look()

    def _play(self) -> None:
        """Show frames at the pace of the clock, leaving out those that a slow machine comes too late for."""
        prepared = self._prepare_trial()
        if prepared is None:
            return
        (recording, speed, halt), began, row = prepared, time.monotonic(), 0
        while row < len(recording) - 1 and not halt.wait(_FRAME_S):
            with self.lock:
                if halt.is_set():
                    return
                row = recording.row_at((time.monotonic() - began) * speed)
                self._show_moment(recording, row, playing=row < len(recording) - 1)
        with self.lock:
            if not halt.is_set():
                self.panel.stop.disabled = True
                self.write()

    @_action
    def _prepare_trial(self) -> tuple[Recording, float, threading.Event]:
        c = self.panel
        check_name("speed", c.speed.value, SPEEDS)
        self._apply_friction()
        recording = self.session.recording()
        put(c.view, TRIAL)
        self._show_moment(recording, 0, playing=len(recording) > 1)
        self.say("")
        return recording, SPEEDS[c.speed.value], self._begin()

    def _begin(self) -> threading.Event:
        """Start something that the next click ends."""
        self._halt = threading.Event()
        self.panel.stop.disabled = False
        return self._halt

    def _show_moment(self, recording: Recording, row: int, *, playing: bool = False) -> None:
        put(self.panel.time, round(float(recording.time_s[row]), 2))
        words = f"trial at {recording.time_s[row]:.1f} s: {recording.phase(row)[1]}"
        self._display(recording.frame(row), words, playing=playing)

    def _display(self, frame: Frame, words: str, *, playing: bool = False) -> None:
        with self._client.atomic():
            self._nodes.show(frame)
            self._shown = words
            about = grasp_html(self.session, words, playing=playing)
            if about != self.panel.about.content:
                self.panel.about.content = about

    def _try_all(self) -> None:
        halt = self._prepare_tries()
        while halt is not None and self._try_some(halt):
            pass

    @_action
    def _prepare_tries(self) -> threading.Event:
        before = self.session.protocol
        self._apply_friction()
        if self.session.protocol != before:
            self._look()
        return self._begin()

    @_reported
    def _try_some(self, halt: threading.Event) -> bool:
        """Try some more grasps, and tell whether any are left to try."""
        with self.lock:
            if halt.is_set():
                return False
            left = self.session.try_some()
            self.say(f"tried {len(self.session) - left} of {len(self.session)}")
            self.panel.stop.disabled = not left
            self.write()
            return left > 0

    @_action
    def _download(self) -> None:
        c = self.panel
        rows = [self.session.index] if c.scope.value == THIS else list(range(len(self.session)))
        packed = pack(self.session, c.file_format.value, rows)
        self._client.send_file_download(packed.name, packed.content, save_immediately=True)
        self.say(f"{packed.name} sent")
        self.write()

    def _apply_friction(self) -> None:
        # It may be one that was refused when it was typed.
        self.session.use(with_friction(self.panel.friction.value))

    @_reported
    def _show_new(self, note: str) -> None:
        c, count = self.panel, len(self.session)
        put(c.grasp, 0.0)
        c.grasp.max, c.grasp.disabled = max(count - 1.0, 1.0), count == 1
        put(c.time, 0.0)
        self._look()
        self.say(". ".join(filter(None, (note, *self.session.batch.notes))))

    def write(self) -> None:
        """Write what is known of the grasps on the panel."""
        self.panel.about.content = grasp_html(self.session, self._shown)
        self.panel.table.content = table_html(self.session)

"""What commands share: options, reading models, hands and numbers; printing JSON, tables and progress bars."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import FlagCreatePairsOff, UseAppendAction, arg

from .. import hands
from ..core.errors import InputError, check_whole, unknown
from ..core.families import read_objects
from ..core.poses import Pose
from ..core.protocols import PROTOCOLS
from ..core.taxonomy import GRASP_TYPES

if TYPE_CHECKING:
    from rich.progress import Progress

    from ..core.objects import GraspObject
    from ..hands import Hand
    from ..proposals import Proposal
    from ..proposals.prior import PosturePrior
    from ..proposals.ranked import Ranked
    from ..studies.rounds import Pair

Flag = FlagCreatePairsOff[bool]
Json = Annotated[Flag, arg(help="Print JSON.")]
Trust = Annotated[Flag, arg(help="Unpickle .npy files, which can run any code: only for files you trust.")]
HandName = Annotated[str, arg(metavar="NAME|FILE", help="Hand: a shipped one's name or a hand file (hand.yaml).")]
_OWN_HAND = "Hand: a shipped one's name or a hand file; by default the model's."
OwnHand = Annotated[str | None, arg(metavar="NAME|FILE", help=_OWN_HAND)]
_MODEL = """A shipped model's name, the folder of a trained one, 'heuristic' (the paper's), or 'screened': the heuristic
that draws again where the digits cannot touch. These two take any size. A scorer in the folder ranks the grasps."""
ModelName = Annotated[str, arg(metavar="NAME|FOLDER", help=_MODEL)]
_PRIOR = "Posture prior of the heuristic (.safetensors); the shipped one without it."
PriorFile = Annotated[Path | None, arg(metavar="FILE", help=_PRIOR)]
_PROTOCOL = f"Trial protocol ({', '.join(PROTOCOLS)}); every rate is quoted with its name."
ProtocolName = Annotated[str, arg(metavar="NAME", help=_PROTOCOL)]
EngineName = Annotated[str, arg(metavar="NAME", help="Physics engine: mujoco, or physx (extra 'physx').")]
Threads = Annotated[int, arg(help="Simulation threads, 0 for all processors.")]
_WORKERS = "Processes to try in, each with one thread, 0 for as many as processors; 1 stays in this one."
Workers = Annotated[int, arg(help=_WORKERS)]
_OBJECTS = """Object to try, by name or size; or any:box, any:cylinder or any:sphere, of which each trial draws a size,
or any for all three. Give the option again for more. Without it, the catalogue's nine or those that a model knows."""
Objects = Annotated[UseAppendAction[tuple[str, ...]], arg(name="object", metavar="NAME|SIZE", help=_OBJECTS)]
Raw = Annotated[Flag, arg(help="Take the cascade's grasps as they are drawn, where a scorer would rank them.")]
_FRICTION = "Sliding friction for which grasps are ranked, where the model has a scorer; without it, protocol hold's."
Friction = Annotated[float | None, arg(help=_FRICTION)]
MassG = Annotated[float | None, arg(help="Mass of the object in grams; without it, what 600 kg/m3 make.")]
PoseNumbers = tuple[float, float, float, float, float, float, float]
_POSE = "Object pose in the world, metres and a unit quaternion; it gives the hand's pose in the world."
ObjectPose = Annotated[PoseNumbers | None, arg(metavar="X Y Z QW QX QY QZ", help=_POSE)]

MAX_THREADS = 4096
_FARTHEST_M = 10.0
"""An object farther from the world's origin was probably meant in millimetres."""
_PIPE_WIDTH = 200
"""Columns of a table that goes to a file or a pipe, where nothing should be wrapped."""
_SAY_EVERY_S = 60.0


def print_json(data: object) -> None:
    """Print data as JSON, not-a-number as null."""
    print(json.dumps(plain(data), indent=1, allow_nan=False))


def plain(value: Any) -> Any:
    """Replace numbers that JSON cannot hold by None, in nested lists and mappings."""
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]], *, left: Sequence[int] = (0,)) -> None:
    """Print a table whose cells stay whole, except in a last text column, which may go on below.

    A line break in a heading keeps its column narrow; `left` numbers the text columns, figures are set to the right.
    """
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE, padding=(0, 1, 0, 0), pad_edge=False, header_style="bold")
    for number, column in enumerate(columns):
        text, last = number in left, number == len(columns) - 1
        table.add_column(column, justify="left" if text else "right", no_wrap=not (text and last))
    for row in rows:
        table.add_row(*row)
    # Names and figures are printed as they are: rich would take [..] in them for markup.
    Console(width=None if sys.stdout.isatty() else _PIPE_WIDTH, markup=False, highlight=False).print(table)


def numbers(values: Iterable[float], form: str) -> str:
    """Word a vector, each number in the same form, such as ``6.1f``."""
    return " ".join(format(float(value), form) for value in values)


def percent(rate: float | None) -> str:
    """Word a rate in percent."""
    return "-" if rate is None or math.isnan(rate) else f"{100 * rate:.1f} %"


def interval(rate: Mapping[str, float | None]) -> str:
    """Word a rate with its 95 % interval, from ``{"rate", "low", "high"}``."""
    return f"{percent(rate['rate'])} (95 %: {percent(rate['low'])} to {percent(rate['high'])})"


def check_threads(**counts: int) -> None:
    """Refuse counts of threads or processes, by their names, that no machine has."""
    for name, value in counts.items():
        check_whole(name, value, most=MAX_THREADS)


def need(package: str, extra: str = "train") -> None:
    """Refuse long work that would end for want of a package of an extra."""
    if find_spec(package) is None:
        raise InputError(f"this needs {package}, of the extra {extra!r}: pip install '.[{extra}]' in a checkout")


def check_out(path: Path, suffix: str, what: str) -> None:
    """Refuse a file that could not be written, before the work rather than after it."""
    from ..formats import check_file_place

    if path.suffix.lower() != suffix:
        raise InputError(f"{what} is a {suffix} file, got {path.name!r}")
    check_file_place(path)


def check_exists(path: Path) -> None:
    """Refuse a file or folder that does not exist, before its name is read as that of a format."""
    if not path.exists():
        raise InputError(f"there is no file or folder {path}")


def say(verb: str, *lines: str) -> None:
    """Say on standard error, a line each, what the user of a command should know."""
    for line in lines:
        print(f"graspcascade {verb}: {line}", file=sys.stderr)


def possible_cells(proposal: Proposal, hand: Hand, verb: str, objects: Sequence[str] = ()) -> list[Pair]:
    """List cells of types that proposal and hand can make; say on standard error what is left out.

    Objects, if none are named, are the catalogue's or, of a proposal that knows others by name, those.
    """
    possible = hand.possible(proposal.grasp_types)
    left_out = [name for name in GRASP_TYPES if name not in {kind.name for kind in possible}]
    if left_out:
        why = f"{hand.name} lacks digits or places for them, or {proposal.name} has not seen them"
        say(verb, f"left out {', '.join(left_out)}: {why}")
    tried = [obj for name in objects for obj in read_objects(name)] or proposal.objects
    return [(obj, kind) for obj in tried for kind in possible]


def object_pose(given: PoseNumbers | None) -> Pose | None:
    """Read an object's pose in the world, and refuse one whose metres look like millimetres."""
    if given is None:
        return None
    pose = Pose.of(given[:3], given[3:])
    if max(map(abs, given[:3])) > _FARTHEST_M:
        raise InputError(f"an object's position is in metres, got {given[:3]}; were millimetres meant?")
    return pose


def load_prior(path: Path | None) -> PosturePrior:
    """Load a posture prior, the shipped one without a path."""
    from ..proposals.prior import PosturePrior

    return PosturePrior.pretrained() if path is None else PosturePrior.load(path)


def weighed(obj: GraspObject, mass_g: float | None) -> GraspObject:
    """Give an object the mass that was asked for, if any."""
    return obj if mass_g is None else obj.weighing(mass_g / 1000)


def with_friction(proposal: Proposal, friction: float | None, model: str) -> Proposal:
    """Rank the grasps of what `--model` names for a friction, if one was asked for.

    Raises:
        InputError: grasps are not ranked, or the friction is out of range.
    """
    return proposal if friction is None else replace(as_ranked(proposal, model, "--friction"), friction=friction)


def as_ranked(proposal: Proposal, model: str, what: str) -> Ranked:
    """Take what `--model` names as ranked grasps; where it has no scorer, an InputError says which models have one."""
    from ..proposals.cascade.sampler import shipped_folders
    from ..proposals.ranked import Ranked
    from ..proposals.scorer import SCORER_FILE

    if isinstance(proposal, Ranked):
        return proposal
    scored = [name for name, folder in shipped_folders().items() if (folder / SCORER_FILE).is_file()]
    others = f"of the shipped models {', '.join(scored) or 'none'} has one, and `graspcascade build` makes one"
    raise InputError(f"{what} needs a model with a scorer, and --model {model} has none; {others}")


def load_proposal(model: str, hand: str | None, prior: Path | None = None, *, raw: bool = False) -> Proposal:
    """Load what `--model` names, ranked by the scorer beside it unless `raw`.

    A folder that has the name of a shipped cascade is given as ``./name``.

    Raises:
        InputError: no such model or hand, a prior with a cascade, or a hand of other joints than the cascade's.
    """
    from ..proposals.cascade.sampler import GraspSampler, shipped_folders
    from ..proposals.heuristic import Heuristic, Screened
    from ..proposals.ranked import Ranked
    from ..proposals.scorer import SCORER_FILE

    untrained = Heuristic.name, Screened.name
    if model in untrained:
        heuristic = Heuristic(hands.load_hand("shadow" if hand is None else hand), load_prior(prior))
        return Screened(heuristic) if model == Screened.name else heuristic
    if prior is not None:
        raise InputError(f"a prior is the heuristic's; give --model heuristic or screened with it, got --model {model}")
    shipped, is_path = shipped_folders(), os.sep in model or Path(model).exists()
    if not is_path and model not in shipped:
        raise InputError(f"{unknown('model', model, [*untrained, *shipped])} Or a trained cascade's folder.")
    folder = Path(model) if is_path and model != "default" else shipped[model]
    is_ranked = (folder / SCORER_FILE).is_file() and not raw
    proposal: Proposal = Ranked.load(folder) if is_ranked else GraspSampler.load(folder)
    if hand is not None and set((own := hands.load_hand(hand)).joint_names) != set(proposal.hand.joint_names):
        shared = set(own.joint_names) <= set(load_prior(None).joint_names)
        raise InputError(
            f"model {model!r} is for {proposal.hand.name}; {own.name} has other joints. Train a model for it, or "
            f"give --model screened{'' if shared else ' with a --prior of its own'}"
        )
    return proposal


class Bar:
    """Report progress: a bar on a terminal; elsewhere, as in a log, a line each minute."""

    def __init__(
        self, progress: Progress | None, total: int | None, title: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._progress, self._clock, self._said_at = progress, clock, clock()
        self._title, self._done, self._total, self._note = title, 0, total, ""
        self._task = None if progress is None else progress.add_task(title, total=total, note="")

    def advance(self, steps: int) -> None:
        """Move on by some steps."""
        self.show(self._done + steps)

    def show(self, done: int, total: int | None = None, note: str | None = None) -> None:
        """Set what is done, and where given the total and the note beside the bar."""
        self._done = done
        self._total = self._total if total is None else total
        self._note = self._note if note is None else note
        if self._progress is not None and self._task is not None:
            self._progress.update(self._task, completed=done, total=self._total, note=self._note)
        elif self._clock() - self._said_at >= _SAY_EVERY_S:
            self._said_at = self._clock()
            of_all = "" if self._total is None else f" of {self._total}"
            note = f", {self._note}" if self._note else ""
            print(f"{self._title}: {self._done}{of_all}{note}", file=sys.stderr, flush=True)


@contextmanager
def bar(title: str, total: int | None = None) -> Iterator[Bar]:
    """Show a progress bar on standard error while the block runs (see `Bar`)."""
    if not sys.stderr.isatty():
        yield Bar(None, total, title)
        return
    from rich import progress as rich
    from rich.console import Console

    title_and_done = rich.TextColumn("{task.description}"), rich.BarColumn(), rich.MofNCompleteColumn()
    note_and_time = rich.TextColumn("{task.fields[note]}"), rich.TimeElapsedColumn(), rich.TimeRemainingColumn()
    with rich.Progress(*title_and_done, *note_and_time, console=Console(stderr=True)) as progress:
        yield Bar(progress, total, title)

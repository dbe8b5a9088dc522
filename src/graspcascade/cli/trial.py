"""``graspcascade trial``: execute a grasp file in physics."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ..errors import InputError
from ..files import write_json
from ..formats import check_file_place, load_executable
from ..grasps import Grasps
from ..hands import SHADOW_HAND
from ..intervals import wilson
from ..trials import TOUCH_COLUMNS, VERDICTS, Outcomes, protocol, run
from .console import at_least, bar, interval, plain, print_json, print_table


@dataclass(frozen=True)
class Trial:
    """Execute every grasp of a file in physics and print what became of it."""

    grasps: Annotated[Positional[Path], arg(metavar="GRASPS")]
    """Grasp file in any format that can be read, such as .json or .parquet."""
    trust_pickle: bool = False
    """Unpickle .npy files, which can run any code: only for files you trust."""
    protocol: str = "paper"
    """Trial protocol; every rate is quoted with its name."""
    out: Path | None = None
    """Also write the report to this .json file."""
    threads: int = 0
    """Simulation threads, 0 for all processors."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Execute, then print and write."""
        at_least("threads", self.threads, 0)
        chosen = protocol(self.protocol)
        if self.out is not None:
            if self.out.suffix.lower() != ".json":
                raise InputError(f"a trial report is a .json file, got {self.out.name!r}")
            check_file_place(self.out)
            if self.out.exists() and self.grasps.exists() and self.out.samefile(self.grasps):
                raise InputError(f"{self.out} holds the grasps; give the report another name")
        document = load_executable(self.grasps, SHADOW_HAND, trust_pickle=self.trust_pickle)
        grasps = document.grasps
        with bar("trials", len(grasps)) as progress:
            outcomes = run(grasps, chosen, n_threads=self.threads, progress=progress.advance)
        report = plain(_report(grasps, outcomes, chosen.name, document.metadata.get("model")))
        if self.out is not None:
            write_json(self.out, report, allow_nan=False)
        if self.json:
            print_json(report)
        else:
            _print_report(report)


def _report(grasps: Grasps, outcomes: Outcomes, protocol_name: str, model: object) -> dict[str, Any]:
    held, faithful, n = outcomes.held, outcomes.faithful(grasps), len(grasps)
    rows = [
        {
            "grasp_type": str(grasps.grasp_type[i]),
            "object": str(grasps.object_label[i]),
            "side_axis": str(grasps.side_axis[i]),
            "verdict": str(outcomes.verdict[i]),
            "held": bool(held[i]),
            "faithful": bool(faithful[i]),
            "touching_closed": _touching(outcomes.touching_closed[i].tolist()),
            "touching_end": _touching(outcomes.touching_end[i].tolist()),
            "object_size_m": float(outcomes.object_size_m[i]),
            "displacement_m": float(outcomes.displacement_m[i]),
            "duration_s": float(outcomes.duration_s[i]),
        }
        for i in range(n)
    ]
    return {
        "protocol": protocol_name,
        "model": model,
        "n": n,
        "held": wilson(int(held.sum()), n).to_json(),
        "faithful": wilson(int(faithful.sum()), n).to_json(),
        "verdicts": {verdict: int((outcomes.verdict == verdict).sum()) for verdict in VERDICTS},
        "grasps": rows,
    }


def _touching(flags: list[bool]) -> list[str]:
    return [place for place, touches in zip(TOUCH_COLUMNS, flags, strict=True) if touches]


def _print_report(report: dict[str, Any]) -> None:
    rows = [
        [
            str(i),
            row["grasp_type"],
            row["object"],
            row["side_axis"],
            row["verdict"] + (", faithful" if row["faithful"] else ""),
            "-" if row["displacement_m"] is None else f"{row['displacement_m'] * 1000:.1f}",
            ", ".join(row["touching_end"] or row["touching_closed"]) or "-",
        ]
        for i, row in enumerate(report["grasps"])
    ]
    print_table(["#", "type", "object", "side", "verdict", "moved\nmm", "touching"], rows, left=(0, 1, 2, 3, 4, 6))
    print(", ".join(f"{count} {verdict}" for verdict, count in report["verdicts"].items() if count))
    print(f"protocol {report['protocol']}, {report['n']} trials: held {interval(report['held'])}")
    print(f"held and type-faithful {interval(report['faithful'])}")

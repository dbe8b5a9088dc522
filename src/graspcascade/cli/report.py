"""``graspcascade report``: the results page from committed JSON, and the project's figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..taxonomy import GRASP_TYPES
from .console import print_json

_FRAMES_OBJECT, _FRAMES_PER_TYPE = "box_medium", 40


@dataclass(frozen=True)
class Report:
    """Write the results page from a folder of evaluations, and with --figures every picture beside it."""

    results: Path = Path("docs/results")
    """Folder of JSON files, such as the evaluation.json of `graspcascade evaluate --out`."""
    out: Path = Path("docs/results.md")
    """Page to write, .md. Tables of a performance.md beside it are made from the folder `performance`, those of a
    model_card.md from the shipped cascade."""
    figures: Path | None = None
    """Folder for heat maps, training curves, grasps of each type, the objects and sampled hand frames, all .png."""
    model: str = "default"
    """Name of a shipped cascade, or the folder of a trained one, that the pictures are sampled from."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Write the page, then draw."""
        if self.out.suffix.lower() != ".md":
            raise InputError(f"a results page is a .md file, got {self.out.name!r}")
        if not self.results.is_dir():
            raise InputError(f"there is no folder {self.results}")
        if self.figures is not None:
            from ..pictures import need_matplotlib, need_renderer

            need_matplotlib()
            need_renderer()
        # Reports load the physics engine, which a wrong setting of the renderer stops from loading at all.
        from ..report import write_report

        write_report(self.results, self.out, self.figures)
        written = [self.out, *self._fill_performance(), *self._fill_model_card()]
        written += [] if self.figures is None else self._draw(self.figures)
        if self.json:
            print_json({"written": [str(path) for path in written]})
        else:
            print("\n".join(f"wrote {path}" for path in written))

    def _fill_performance(self) -> list[Path]:
        page, folder = self.out.with_name("performance.md"), self.results / "performance"
        if not (page.is_file() and folder.is_dir()):
            return []
        from ..bench.page import fill_page

        fill_page(page, folder)
        return [page]

    def _fill_model_card(self) -> list[Path]:
        page = self.out.with_name("model_card.md")
        if not page.is_file():
            return []
        from ..report.model_card import fill_model_card

        fill_model_card(page)
        return [page]

    def _draw(self, folder: Path) -> list[Path]:
        from ..report.figures import heat_maps, paper_figures

        return [
            *heat_maps(self.results, folder),
            *paper_figures(self.results, folder),
            *draw_pictures(folder, self.model),
        ]


def draw_pictures(folder: Path, model: str = "default") -> list[Path]:
    """Draw the grasp types, the objects and the sampled hand frames into a folder.

    Raises:
        InputError: matplotlib or an offscreen renderer is missing, or no such model.
    """
    from ..pictures import Studio, grasp_types_sheet, objects_sheet, pose_frames, save_png
    from .models import load_sampler

    sampler = load_sampler(model)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / name for name in ("grasp_types.png", "objects.png", "pose_frames.png")]
    with Studio() as studio:
        types = grasp_types_sheet(studio, lambda kind, label, n, seed: sampler.sample(kind, label, None, n, seed))
        save_png(types, paths[0])
        save_png(objects_sheet(studio), paths[1])
    batches = [sampler.sample(kind, _FRAMES_OBJECT, None, _FRAMES_PER_TYPE) for kind in GRASP_TYPES]
    save_png(pose_frames(batches), paths[2])
    return paths

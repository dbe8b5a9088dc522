"""The model card: its generated blocks say what the shipped cascade's own files say."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.paper.markdown import fill_blocks, rate
from benchmarks.paper.model_card import card_blocks, fill_model_card
from graspcascade.core.errors import InputError
from graspcascade.proposals.cascade.sampler import EVALUATION_FILE, GraspSampler, shipped_folder
from graspcascade.studies.record import Evaluation

CARD = Path(__file__).parents[2] / "docs/model_card.md"
LINES = st.lists(st.text("abc |*", max_size=8), max_size=4).map("\n".join)


@given(LINES, LINES, LINES)
def test_filling_blocks_keeps_what_is_outside_and_repeats_itself(before: str, old: str, after: str) -> None:
    page = f"{before}\n<!-- generated: one -->\n{old}\n<!-- end -->{after}"
    filled = fill_blocks(page, {"one": lambda: "made"})
    assert filled == f"{before}\n<!-- generated: one -->\n\nmade\n\n<!-- end -->{after}"
    assert fill_blocks(filled, {"one": lambda: "made"}) == filled


def test_a_block_that_nothing_is_made_for_is_refused() -> None:
    with pytest.raises(InputError, match="Did you mean 'rates'"):
        fill_blocks("<!-- generated: raets -->\n<!-- end -->", {"rates": str})


def test_the_committed_card_is_of_the_shipped_cascade(tmp_path: Path) -> None:
    page = tmp_path / "model_card.md"
    page.write_text(CARD.read_text())
    fill_model_card(page)
    assert page.read_text() == CARD.read_text(), "run `python -m benchmarks.paper.report`"


def test_limits_list_every_weak_cell_and_no_other() -> None:
    result = Evaluation.load(shipped_folder() / EVALUATION_FILE)
    limits = card_blocks(GraspSampler.pretrained(), result)["limits"]()
    for cell in result.cells:
        listed = f"| {cell.object_label} | {cell.grasp_type} | {rate(cell.held_rate)}" in limits
        assert listed == (cell.held < 0.9 * cell.n)

"""Pictures of the documentation: small files, and what is said where none can be drawn."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.paper.pictures import TYPES_ON, grasp_types_sheet, objects_sheet, pose_frames
from benchmarks.tests.support import MAX_BYTES, needs_drawing
from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.poses import Pose
from graspcascade.core.protocols import Protocol
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.hands import Hand
from graspcascade.proposals import Proposal
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.viewer.pictures import Renderer, save_png


def test_every_type_has_its_place_on_the_sheet() -> None:
    assert [kind for kind, _ in TYPES_ON] == list(GRASP_TYPES)


@needs_drawing
def test_pictures_are_small_png_files(hand: Hand, tmp_path: Path) -> None:
    sampler = GraspSampler.pretrained()
    batches = [sampler.sample(kind, "box_medium", "x", n=3) for kind in GRASP_TYPES]
    with Renderer(hand, width=70, height=84) as renderer:
        drawn = {"objects.png": objects_sheet(renderer), "frames.png": pose_frames(batches, hand)}
    for name, figure in drawn.items():
        save_png(figure, tmp_path / name)
        assert (tmp_path / name).stat().st_size < MAX_BYTES


@needs_drawing
def test_a_type_none_of_whose_samples_is_faithful_is_named(hand: Hand, drawn: Grasps, short: Protocol) -> None:
    class Missing(Proposal):
        name = "missing"

        def propose(self, *_: object) -> Grasps:
            pose = drawn.X_hand_object
            return replace(drawn, X_hand_object=Pose(pose.position_m + 0.3, pose.quat_wxyz))[:1]

    proposal = Missing()
    proposal.hand = hand
    with Renderer(hand, width=70, height=84) as renderer, pytest.raises(InputError, match="none of 1 tripod grasps"):
        grasp_types_sheet(renderer, proposal, short, tries=1)

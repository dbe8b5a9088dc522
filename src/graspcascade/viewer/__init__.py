"""The web page: sample grasps, see them in 3-D, play their trials, take them away as files.

`session` is what one browser looks at, `recording` what a trial looked like, `words` and `shapes` how both are worded
and drawn; none of them needs a browser or viser. `page` and `server` put them on the screen, `pictures` on paper.
"""

from .recording import Frame, Recording, record
from .session import Batch, SampleRequest, Session, file_batch, sample_batch, with_friction

__all__ = ["Batch", "Frame", "Recording", "SampleRequest", "Session"]
__all__ += ["file_batch", "record", "sample_batch", "with_friction"]

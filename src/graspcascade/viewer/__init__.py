"""The web page: sample grasps, see them in 3-D, play their trials, take them away as files.

`shapes` turns hand and objects into triangles, `recording` keeps what the trial runner shows, `session` is what one
browser looks at, `tables` and `downloads` word it and pack it. None of these needs a browser or viser; `scene`,
`controls`, `page`, `server` and `standalone` put them on the screen and are loaded when a page is asked for.
"""

from .recording import Frame, Recording, record
from .session import MAX_GRASPS, VIEWS, Batch, SampleRequest, Session, file_batch, sample_batch, with_friction

__all__ = [
    "MAX_GRASPS",
    "VIEWS",
    "Batch",
    "Frame",
    "Recording",
    "SampleRequest",
    "Session",
    "file_batch",
    "record",
    "sample_batch",
    "with_friction",
]

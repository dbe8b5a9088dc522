"""Draw docs/figures/frames.svg: the frames that grasp files use, on the hand in a tripod grasp.

Run it as ``python docs/make_frames_figure.py`` when the hand or the frames change.
"""

from pathlib import Path

import numpy as np

from graspcascade.core.objects import CATALOGUE
from graspcascade.core.taxonomy import as_type
from graspcascade.hands import load_hand

OUT = Path(__file__).parent / "figures" / "frames.svg"
WIDTH, HEIGHT, SCALE = 960, 820, 2350.0
LEFT, TOP = 300, 745
SHOWN_BELOW_M = 0.11
"""Where the forearm is drawn below the palm; the rest of its length is cut out."""
POSTURE_RAD = {
    "FF": (0.03, 0.72, 0.62, 0.62),
    "MF": (-0.03, 0.76, 0.70, 0.70),
    "RF": (-0.03, 0.35, 0.30, 0.30),
    "LF": (0.01, -0.15, 0.25, 0.20, 0.20),
    "TH": (0.46, 0.92, 0.12, -0.05, 0.26),
}
"""A tripod grasp, the joints of each digit from the palm outwards: from the one of the highest number to 1."""
BENCH_BASE_M = np.array([0.0, 0.0, -0.034])
"""Where DexGraspBench has the hand's base, in the hand frame."""
CHAINS = {
    "ff": ("knuckle", "proximal", "middle", "distal"),
    "mf": ("knuckle", "proximal", "middle", "distal"),
    "rf": ("knuckle", "proximal", "middle", "distal"),
    "lf": ("metacarpal", "knuckle", "proximal", "middle", "distal"),
    "th": ("base", "proximal", "hub", "middle", "distal"),
}
OBJECT_NOTE = (
    "object",
    "its centre; a cylinder's axis is z",
    "isaac_grasp, DexGraspNet and, with no object",
    "pose given, MoveIt state the hand in it",
)
HAND_NOTE = (
    "hand = palm body",
    "z along the straight fingers,",
    "-y out of the palm, x towards the thumb",
    "native files, isaac_grasp, DexGraspNet",
)
BASE_NOTE = ("DexGraspBench base", "34 mm below the palm, same axes", "qpos[0:7]: xyz, quaternion wxyz")
FOREARM_NOTE = ("10 mm towards its back, wrist at zero", "MoveIt's parent link (grasp_pose)")
AXES = (("x", "#c62828"), ("y", "#2e7d32"), ("z", "#1565c0"))
AZIMUTH, ELEVATION = np.radians(58.0), np.radians(12.0)


def project(points):
    """Map points ``(..., 3)`` of the hand frame, metres, to the page, and give their depth (larger is nearer)."""
    points = np.asarray(points, dtype=float)
    ca, sa, ce, se = np.cos(AZIMUTH), np.sin(AZIMUTH), np.cos(ELEVATION), np.sin(ELEVATION)
    right, towards = np.array([ca, sa, 0.0]), np.array([sa * ce, -ca * ce, se])
    up = np.cross(towards, right)
    origin = np.array([0.0, 0.0, -SHOWN_BELOW_M])
    x, y = (points - origin) @ right, (points - origin) @ up
    return np.stack([LEFT + SCALE * x, TOP - SCALE * y], axis=-1), points @ towards


def path(points, style, closed=False):
    page, _ = project(points)
    steps = " L ".join(f"{x:.1f} {y:.1f}" for x, y in page)
    return f'<path d="M {steps}{" Z" if closed else ""}" {style}/>'


def limb(points, width_m, colour):
    join = 'fill="none" stroke-linecap="round" stroke-linejoin="round"'
    rim = path(points, f'{join} stroke="#7d8590" stroke-width="{SCALE * width_m + 3:.1f}"')
    return rim + path(points, f'{join} stroke="{colour}" stroke-width="{SCALE * width_m:.1f}"')


def triad(rotation, origin, length_m):
    """Draw a frame's three axes, the farthest first."""
    rows = []
    tips = origin + length_m * np.asarray(rotation).T
    for i in np.argsort(project(tips)[1]):
        name, colour = AXES[i]
        rows.append(path([origin, tips[i]], f'stroke="{colour}" stroke-width="3.2" marker-end="url(#{name})"'))
        (x, y), _ = project(origin + 1.22 * length_m * np.asarray(rotation).T[i])
        rows.append(f'<text x="{x:.1f}" y="{y + 5:.1f}" class="axis" fill="{colour}">{name}</text>')
    (x, y), _ = project(origin)
    rows.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4.5" fill="#111"/>')
    return rows


def box(rotation, origin, extents):
    """Draw the faces of the object, the farthest first."""
    faces = []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        for sign in (-0.5, 0.5):
            corners = np.zeros((4, 3))
            corners[:, axis] = sign
            corners[:, others] = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
            faces.append(origin + (corners * extents) @ np.asarray(rotation).T)
    faces.sort(key=lambda face: project(face.mean(axis=0))[1])
    style = 'fill="#f4b942" fill-opacity="0.42" stroke="#a8700a" stroke-width="1.4" stroke-linejoin="round"'
    return [path(face, style, closed=True) for face in faces]


def label(point, at, title, *lines):
    (x, y), _ = project(point)
    tx, ty = at
    rows = [f'<path d="M {x:.1f} {y:.1f} L {tx - 10:.1f} {ty - 5:.1f}" stroke="#777" stroke-width="1" fill="none"/>']
    rows.append(f'<text x="{tx}" y="{ty}" class="title">{title}</text>')
    rows += [f'<text x="{tx}" y="{ty + 19 * (i + 1)}" class="note">{line}</text>' for i, line in enumerate(lines)]
    return rows


def main():
    hand, obj = load_hand("shadow"), CATALOGUE["box_medium"]
    posture = np.array([[POSTURE_RAD[name[:2]][-int(name[3:])] for name in hand.joint_names]])
    frames = hand.frames(posture)
    thumb, finger = (place[0] for place in hand.opposition(posture, as_type("tripod")))
    along = (finger - thumb) / np.linalg.norm(finger - thumb)
    across = np.cross(along, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    X_object = np.stack([along, across, np.cross(along, across)], axis=1)
    centre = (thumb + finger) / 2

    forearm = -hand.X_base_hand.position_m
    shown = np.array([forearm[0], forearm[1], -SHOWN_BELOW_M])
    wrist = BENCH_BASE_M
    drawn = [limb([shown, wrist], 0.046, "#e3e6ea"), limb([wrist, (0, 0, 0.01)], 0.03, "#d3d7dc")]
    (cx, cy), _ = project((shown + 1.3 * wrist) / 2.3)
    zigzag = " ".join(f"L {cx + dx:.0f} {cy + dy:.0f}" for dx, dy in ((-24, 8), (-8, -8), (8, 8), (24, -8), (75, 0)))
    for shift in (-5, 5):
        gap = f'stroke="#7d8590" stroke-width="1.5" fill="none" transform="translate(0 {shift})"'
        drawn.append(f'<path d="M {cx - 75:.0f} {cy:.0f} {zigzag}" {gap}/>')
    tips = {"th": "thumb", "ff": "index", "mf": "middle", "rf": "ring", "lf": "little"}
    drawn += [digit(hand, frames, posture, name, tips, "#c3c9d0") for name in ("lf", "rf", "mf")]
    outline = [(-0.034, 0, 0.005), (-0.034, 0, 0.086), (-0.011, 0, 0.093), (0.011, 0, 0.096), (0.033, 0, 0.09)]
    outline += [(0.036, 0, 0.03), (0.026, 0, 0.005)]
    for colour, extra in (("#7d8590", 3), ("#d3d7dc", 0)):
        rim = f'stroke="{colour}" stroke-width="{SCALE * 0.018 + extra:.0f}" stroke-linejoin="round" fill="{colour}"'
        drawn.append(path(outline, rim, closed=True))
    drawn.append(digit(hand, frames, posture, "ff", tips, "#aab3bd"))
    drawn += box(X_object, centre, np.array(obj.extents_m))
    drawn.append(digit(hand, frames, posture, "th", tips, "#aab3bd"))

    dashed = 'stroke="#6a1b9a" stroke-width="2.2" stroke-dasharray="7 5" fill="none"'
    drawn.append(path([(0, 0, 0), centre], dashed))
    for rotation, origin, length in (
        (np.eye(3), shown, 0.026),
        (np.eye(3), wrist, 0.018),
        (np.eye(3), np.zeros(3), 0.026),
        (X_object, centre, 0.028),
    ):
        drawn += triad(rotation, origin, length)
    (hx, hy), _ = project(np.array(centre) * 0.55)
    drawn.append(f'<text x="{hx - 128:.0f}" y="{hy + 6:.0f}" class="pose">X_hand_object</text>')

    x = 590
    drawn += label(centre, (x, 110), *OBJECT_NOTE)
    drawn += label(np.zeros(3), (x, 330), *HAND_NOTE)
    drawn += label(wrist, (x, 510), *BASE_NOTE)
    drawn += label(shown, (x, 660), "forearm", f"{-1000 * forearm[2]:.0f} mm below the palm,", *FOREARM_NOTE)
    markers = "".join(
        f'<marker id="{name}" viewBox="0 0 10 10" refX="7" refY="5" markerWidth="5" markerHeight="5" orient="auto">'
        f'<path d="M 0 0 L 10 5 L 0 10 z" fill="{colour}"/></marker>'
        for name, colour in AXES
    )
    style = (
        "text{font-family:Helvetica,Arial,sans-serif;fill:#222}.title{font-size:19px;font-weight:bold}"
        ".note{font-size:14.5px;fill:#444}.axis{font-size:16px;paint-order:stroke;stroke:#fff;stroke-width:3px;font-weight:bold;text-anchor:middle}"
        ".pose{font-size:15px;paint-order:stroke;stroke:#fff;stroke-width:4px;font-family:monospace;fill:#6a1b9a}"
    )
    for _, colour in AXES:
        style += f'.axis[fill="{colour}"]{{fill:{colour}}}'
    OUT.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}">\n'
        "<title>Frames of grasp files: object, hand (palm), DexGraspBench base and forearm</title>\n"
        f'<defs>{markers}</defs><style>{style}</style>\n<rect width="100%" height="100%" fill="#fff"/>\n'
        + "\n".join(drawn)
        + "\n</svg>\n",
        encoding="utf-8",
    )


def digit(hand, frames, posture, name, tips, colour):
    points = [frames[name + part][1][0] for part in CHAINS[name]]
    points.append(hand.tips(posture, [tips[name]])[tips[name]][0])
    return limb(points, 0.0165, colour)


if __name__ == "__main__":
    main()

"""Things held before a face: a ball, a box, a hand of capsules; drawn by seed.

Notation: canonical head frame until the end; `towards` the unit direction from the face to the camera of the first
view. They hide part of the face in that view and cast their shadow on it; masks and truth leave them out.
"""

import numpy as np

from data_synth.render import Occluder
from sira_assets.mesh.triangle_mesh import TriangleMesh

# Half extents and radii in metres: balls and microphones, phones and books; fingers after Pheasant, Bodyspace: 8 to 9
# mm of half width, a hand 85 mm broad across four of them, fingers of 65 to 80 mm, a palm of 100 mm.
BALL_M, BOX_M = (0.02, 0.045), ((0.03, 0.07), (0.045, 0.1), (0.004, 0.015))
FINGER_M, FINGER_LENGTHS_M, SPACING_M = 0.0085, (0.068, 0.078, 0.072, 0.058), 0.021
GAP_M = (0.015, 0.07)  # between what is held and the foremost point of the face


def sample_occluder(
    rng: np.random.Generator, points_canonical: np.ndarray, face_centre: np.ndarray, towards: np.ndarray
) -> Occluder:
    """Draw something that hides a part of the face, never its middle alone nor all of it.

    Parameters
    ----------
    points_canonical : (N, 3) the head's surface, not to be touched
    face_centre : (3,) about which it is held, up to 9 cm off in the picture
    towards : (3,) unit

    Returns
    -------
    Occluder, in the canonical frame
    """
    kind = rng.choice(["ball", "box", "hand"])
    vertices, faces = {"ball": _ball, "box": _box, "hand": _hand}[kind](rng)
    side = np.cross([0.0, 1.0, 0.0], towards)
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(towards, side), towards], axis=1)
    turn = rng.uniform(-np.pi, np.pi) if kind != "hand" else rng.uniform(-0.9, 0.9)
    roll = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    tilt = rng.uniform(-0.35, 0.35)
    tip = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    vertices = vertices @ (frame @ roll @ tip).T
    angle, radius = rng.uniform(-np.pi, np.pi), rng.uniform(0.03, 0.09)
    centre = face_centre + frame[:, :2] @ (radius * np.array([np.cos(angle), np.sin(angle)]))
    # Before everything that is near the line of sight, by the gap.
    across = (points_canonical - centre) @ frame[:, :2]
    reach = np.linalg.norm(vertices - towards * (vertices @ towards)[:, None], axis=1).max()
    near = np.linalg.norm(across, axis=1) < reach + 0.02
    front = (points_canonical[near] @ towards).max() if near.any() else face_centre @ towards
    lift = front + rng.uniform(*GAP_M) - (centre @ towards + (vertices @ towards).min())
    skin = np.array([0.42, 0.26, 0.18]) * rng.uniform(0.25, 1.4)
    albedo = skin if kind == "hand" else rng.uniform(0.03, 0.7, 3)
    return Occluder(str(kind), TriangleMesh(vertices + centre + lift * towards, faces), np.clip(albedo, 0.0, 0.8))


def _ball(rng):
    import trimesh

    ball = trimesh.creation.icosphere(4, rng.uniform(*BALL_M))
    return np.asarray(ball.vertices), np.asarray(ball.faces)


def _box(rng):
    import trimesh

    box = trimesh.creation.box(2.0 * np.array([rng.uniform(*half) for half in BOX_M]))
    # Vertices of their own for each side, so that normals are flat.
    corners = np.asarray(box.vertices)[box.faces]
    return corners.reshape(-1, 3), np.arange(corners.shape[0] * 3).reshape(-1, 3)


def _hand(rng):
    """Four fingers side by side, spread a little, on a flat palm; +Y along the fingers."""
    import trimesh

    spread, bend = rng.uniform(0.0, 0.12), rng.uniform(0.0, 0.3)
    parts = []
    for k, length in enumerate(FINGER_LENGTHS_M):
        finger = trimesh.creation.capsule(height=length, radius=FINGER_M, count=[16, 16])
        x = np.asarray(finger.vertices)[:, [1, 2, 0]]
        x[:, 2] += bend * np.maximum(x[:, 1], 0.0) ** 2 / length
        turn = -(k - 1.5) * spread
        x[:, :2] = x[:, :2] @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]).T
        parts.append((x + np.array([(k - 1.5) * SPACING_M, 0.0, 0.0]), np.asarray(finger.faces)))
    palm = trimesh.creation.icosphere(3, 1.0)
    parts.append(
        (np.asarray(palm.vertices) * [0.042, 0.052, 0.014] - np.array([0.0, 0.045, 0.0]), np.asarray(palm.faces))
    )
    start = np.cumsum([0, *(len(x) for x, _ in parts)])
    return np.concatenate([x for x, _ in parts]), np.concatenate(
        [f + s for (_, f), s in zip(parts, start, strict=False)]
    )

"""From a `Camera` and a stage to the views of each picture: framing, following, projection; and the key light's view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from keypose.arrays import Floats
from keypose.render.settings import Camera
from keypose.render.stage import Stage

SHADOW_SIZE = 1024  # texels along one side of the key light's depth map
_FOLLOW_TRAVEL = 0.9  # subject sizes of travel from which the camera follows by itself
_FOLLOW_SMOOTHING_S = 0.35
_KEY_AZIMUTH_DEG, _KEY_ELEVATION_DEG = -38.0, 50.0  # of the key light, seen from the camera: from upper left
_FILL_AZIMUTH_DEG, _FILL_ELEVATION_DEG = 62.0, 18.0
_RIM_AZIMUTH_DEG, _RIM_ELEVATION_DEG = 158.0, 38.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Everything about the viewpoint of one picture.

    Shapes and units:
        clip_from_world, light_from_world: (4, 4) float64; clip space is OpenGL's, depth -1..1.
        eye, forward: (3,) metres and unit.
        center, radius: metres, a sphere that holds the subject at this moment (the key light shines on it).
        focus, reach: metres, the floor point in the middle of everything shown, and how far everything reaches.
        key, fill, rim: (3,) unit directions to the lights.
        floor: metres, its height; ``above`` whether it is seen from above: from below it is not there.
        cell: metres between strong grid lines.
    """

    clip_from_world: Floats
    eye: Floats
    forward: Floats
    orthographic: bool
    light_from_world: Floats
    key: Floats
    fill: Floats
    rim: Floats
    center: Floats
    radius: float
    focus: Floats
    reach: float
    floor: float
    above: bool
    cell: float


def direction(azimuth_deg: float, elevation_deg: float) -> Floats:
    """Unit vector towards an azimuth (0 is +Z, positive towards +X) and elevation."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    across = np.cos(elevation)
    return np.array([across * np.sin(azimuth), np.sin(elevation), across * np.cos(azimuth)])


def frame(points: Floats, camera: Camera, aspect: float) -> tuple[Floats, float]:
    """The eye (3,) from which all points (N, 3) just fit, and the height of the view for an orthographic camera.

    Each side plane of the viewing pyramid is pushed against the points; opposite planes meet in two lines, and the
    eye is put where the nearer of the two would cut something off.
    """
    back = direction(camera.azimuth_deg, camera.elevation_deg)
    right, up = _axes(back)
    x, y, z = points @ right, points @ up, points @ back
    free = 1 - 2 * camera.margin
    if camera.orthographic:
        middle_x, middle_y = (x.max() + x.min()) / 2, (y.max() + y.min()) / 2
        height = max(float(np.ptp(y)), float(np.ptp(x)) / aspect, 1e-9) / free
        # far enough for everything to lie in front; the distance changes nothing else
        depth = z.max() + max(height, float(np.ptp(z)))
        return middle_x * right + middle_y * up + depth * back, height
    slope_y = np.tan(np.radians(camera.fov_deg) / 2) * free
    slope_x = slope_y * aspect
    sides: list[tuple[float, float]] = []
    for values, slope in ((x, slope_x), (y, slope_y)):
        high, low = float((values + slope * z).max()), float((-values + slope * z).max())
        sides.append(((high - low) / 2, (high + low) / (2 * slope)))
    depth = max(sides[0][1], sides[1][1])
    nearest = float(z.max())
    depth = max(depth, nearest + 1e-6 * max(1.0, abs(nearest)))
    return sides[0][0] * right + sides[1][0] * up + depth * back, 0.0


class Framing:
    """The views of all pictures of a performance: one fixed camera, or one that travels with the subject.

    With ``turning`` the camera can also go round: the subject fits from every side.
    """

    def __init__(self, stage: Stage, camera: Camera, aspect: float, turning: bool = False) -> None:
        self._stage, self._camera, self._aspect = stage, camera, aspect
        follows = camera.follow
        if follows is None:
            follows = stage.travel > _FOLLOW_TRAVEL * stage.size
        self._track_times, self._track = self._smooth_path() if follows else (np.zeros(1), np.zeros((1, 3)))
        moved = stage.survey_points.astype(np.float64) - self._track_at(stage.survey_times)[:, None]
        points = moved.reshape(-1, 3)
        if turning:
            points = _turned(points, (points.min(axis=0) + points.max(axis=0)) / 2)
        eye, self._view_height = frame(points, camera, aspect)
        right, up = _axes(direction(camera.azimuth_deg, camera.elevation_deg))
        # of the subject as the camera sees it: width over height
        self.aspect = float(np.ptp(points @ right)) / max(float(np.ptp(points @ up)), 1e-12)
        back = direction(camera.azimuth_deg, camera.elevation_deg)
        low, high = points.min(axis=0), points.max(axis=0)
        if camera.target is not None:
            target = np.asarray(camera.target, np.float64)
            # the target replaces the subject's middle; how far away to stand stays the framing's choice
            distance = camera.distance or float((eye - (low + high) / 2) @ back)
            eye = target + max(distance, 1e-6) * back
        elif camera.distance is not None:
            middle = (low + high) / 2
            eye = eye + (camera.distance - float((eye - middle) @ back)) * back
        self._eye = eye
        self._center = (low + high) / 2
        self._reach = float(np.linalg.norm(high - low)) / 2
        # the key light's box holds the subject wherever it is: measured around the path of its roots
        around = stage.survey_points.astype(np.float64) - stage.path(stage.survey_times)[:, None]
        self._middle = (around.min(axis=(0, 1)) + around.max(axis=(0, 1))) / 2
        self._radius = 1.1 * float(np.linalg.norm(around - self._middle, axis=2).max()) or 1.0

    def views(self, times_s: Floats, angles_deg: Floats | None = None) -> list[View]:
        """The views at T times, the camera gone round by T angles."""
        shifts, middles = self._track_at(times_s), self._stage.path(times_s) + self._middle
        angles = np.zeros(len(times_s)) if angles_deg is None else angles_deg
        return [self._view(s, m, float(a)) for s, m, a in zip(shifts, middles, angles, strict=True)]

    def _view(self, shift: Floats, middle: Floats, angle_deg: float) -> View:
        stage = self._stage
        camera = self._camera.turned(angle_deg)
        back = direction(camera.azimuth_deg, camera.elevation_deg)
        center, radius = self._center + shift, self._radius
        eye = center + _turn(angle_deg) @ (self._eye - self._center)
        distance = float((eye - center) @ back)
        # near enough for the floor before the subject, far enough for it to fade out before it ends
        near = 0.02 * max(distance, self._reach)
        far = max(distance, 0.0) + 60 * max(self._reach, distance)
        if camera.orthographic:
            projection = _orthographic(self._view_height * self._aspect, self._view_height, -far, far)
        else:
            projection = _perspective(np.radians(camera.fov_deg), self._aspect, near, far)
        key = direction(camera.azimuth_deg + _KEY_AZIMUTH_DEG, _KEY_ELEVATION_DEG)
        light = _orthographic(2 * radius, 2 * radius, 0.0, 4 * radius) @ _look(middle + key * (2 * radius), key)
        # whole texels, so that shadows of a moving subject do not crawl
        light[:2, 3] = np.round(light[:2, 3] * (SHADOW_SIZE / 2)) / (SHADOW_SIZE / 2)
        return View(
            clip_from_world=projection @ _look(eye, back),
            eye=eye,
            forward=-back,
            orthographic=camera.orthographic,
            light_from_world=light,
            key=key,
            fill=direction(camera.azimuth_deg + _FILL_AZIMUTH_DEG, _FILL_ELEVATION_DEG),
            rim=direction(camera.azimuth_deg + _RIM_AZIMUTH_DEG, _RIM_ELEVATION_DEG),
            center=middle,
            radius=radius,
            focus=np.array([center[0], stage.floor, center[2]]),
            reach=self._reach,
            floor=stage.floor,
            above=bool(back[1] > 0 if camera.orthographic else eye[1] > stage.floor),
            cell=_cell(stage.height),
        )

    def _track_at(self, times_s: Floats) -> Floats:
        return np.stack([np.interp(times_s, self._track_times, self._track[:, c]) for c in range(3)], axis=-1)

    def _smooth_path(self) -> tuple[Floats, Floats]:
        """The horizontal path of the subject without the sway of its steps."""
        stage = self._stage
        span = stage.end_s - stage.start_s
        count = int(np.clip(np.ceil(span * 12), 1, 4000)) + 1
        times = np.linspace(stage.start_s, stage.end_s, count)
        path = stage.path(times)
        path[:, 1] = 0
        path -= path[0]
        step = span / max(count - 1, 1)
        reach = int(np.ceil(3 * _FOLLOW_SMOOTHING_S / step)) if step > 0 else 0
        if reach:
            weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step / _FOLLOW_SMOOTHING_S) ** 2)
            weights /= weights.sum()
            # point reflection at the ends keeps the speed there
            head = 2 * path[0] - path[1 : reach + 1][::-1]
            tail = 2 * path[-1] - path[-reach - 1 : -1][::-1]
            if len(head) == reach and len(tail) == reach:
                padded = np.concatenate([head, path, tail])
                path = np.stack([np.convolve(padded[:, c], weights, "valid") for c in range(3)], axis=1)
        return times, path


def _turn(angle_deg: float) -> Floats:
    """Rotation about the vertical, as azimuths grow."""
    sine, cosine = np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])


def _turned(points: Floats, center: Floats) -> Floats:
    """The points as they are seen from all around."""
    around = points - center
    # what is farthest from the axis at each height says it all
    order = np.argsort(-np.hypot(around[:, 0], around[:, 2]), kind="stable")
    level = np.floor((around[:, 1] - around[:, 1].min()) / max(float(np.ptp(around[:, 1])), 1e-12) * 64)
    _, first = np.unique(level[order], return_index=True)
    kept = np.concatenate([around[order[first]], around[[around[:, 1].argmin(), around[:, 1].argmax()]]])
    return np.concatenate([kept @ _turn(angle).T for angle in range(0, 360, 5)]) + center


def _axes(back: Floats) -> tuple[Floats, Floats]:
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    return right, np.cross(back, right)


def _look(eye: Floats, back: Floats) -> Floats:
    """View-from-world matrix of an eye that looks along -back."""
    right, up = _axes(back)
    view = np.eye(4)
    view[:3, :3] = [right, up, back]
    view[:3, 3] = -view[:3, :3] @ eye
    return view


def _perspective(fov: float, aspect: float, near: float, far: float) -> Floats:
    scale = 1 / np.tan(fov / 2)
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[1, 1] = scale / aspect, scale
    matrix[2, 2], matrix[2, 3] = (far + near) / (near - far), 2 * far * near / (near - far)
    matrix[3, 2] = -1
    return matrix


def _orthographic(width: float, height: float, near: float, far: float) -> Floats:
    matrix = np.diag([2 / width, 2 / height, -2 / (far - near), 1.0])
    matrix[2, 3] = -(far + near) / (far - near)
    return matrix


def _cell(height: float) -> float:
    """A round length (1, 2 or 5 times a power of ten) near half the subject's height."""
    decade = 10.0 ** np.floor(np.log10(0.55 * height))
    return float(decade * max(step for step in (1, 2, 5) if step * decade <= 0.55 * height * (1 + 1e-9)))

"""What a page asks of the server to put a motion on another character, and what it is answered.

Requests are JSON bodies of ``POST api/retarget/...``, answers JSON too; motions travel as scenes (``GET api/scenes/{id}``).
How they become TypeScript is in `keypose.studio.typescript`. Roles map to joint names, as in the files of ``keypose roles``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from keypose.studio.scene_messages import SceneEntry

# ---- browser to server -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RetargetSubjectRequest:
    """Show a scene on this page: one that is open, or a built-in one as ``sample:NAME``."""

    type: Literal["retarget_subject"]
    scene: str


@dataclass(frozen=True, slots=True)
class RetargetRolesRequest:
    """Find the roles of a character anew; ``known`` ones are kept as they are."""

    type: Literal["retarget_roles"]
    scene: str
    character: int
    known: dict[str, str]


@dataclass(frozen=True, slots=True)
class RetargetRequest:
    """Put a scene's animation on another scene's character.

    ``source_roles``, ``target_roles``: all roles of the character, or None for what the server finds. References, as of
    ``keypose retarget`` but with ids of scenes for files and seconds for frames: empty for the rest pose or a better stand where that is none,
    ``rest`` for the rest pose whatever it is, ``SECONDS`` of the scene's own motion, ``SCENE:SECONDS`` or ``SCENE:rest`` of
    another of the same rig. ``scale`` None goes by leg length, ``rate_hz`` None keeps the animation's. ``props``: places in metres that
    hands keep to, three numbers each, or six with the place in the target's world. ``against``: a scene with somebody else's
    result, which is compared, or empty.
    """

    type: Literal["retarget"]
    source: str
    source_character: int
    animation: int
    target: str
    target_character: int
    source_roles: dict[str, str] | None
    target_roles: dict[str, str] | None
    source_reference: str
    target_reference: str
    scale: float | None
    plant: bool
    keep_hands: bool
    props: list[list[float]]
    rate_hz: float | None
    against: str


RetargetAsked = RetargetSubjectRequest | RetargetRolesRequest | RetargetRequest


# ---- server to browser -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RetargetRoles:
    """Which joint plays which role, and how sure that is (0..1); ``missing`` are needed and played by none."""

    roles: dict[str, str]
    confidence: dict[str, float]
    missing: list[str]
    all_fours: bool
    notes: list[str]


@dataclass(frozen=True, slots=True)
class RetargetSubject:
    """A scene that the page may show, and the roles of each of its characters."""

    scene: SceneEntry | None
    characters: list[RetargetRoles]
    error: str


@dataclass(frozen=True, slots=True)
class RetargetFoot:
    """The steps of one foot (``left_foot`` ... or, of who goes on four, ``left_hand`` ...): when it is on the ground.

    ``source``, ``target``: the joints of ankle and ball (twice the same where there is one; empty where the body has none).
    ``steps``: first and last frames, in pairs, one after the other; of each the mean speed of the carrying point in cm/s.
    """

    role: str
    source: list[str]
    target: list[str]
    steps: list[int]
    source_slides_cm_s: list[float]
    target_slides_cm_s: list[float]


@dataclass(frozen=True, slots=True)
class RetargetBeside:
    """A retargeted motion beside somebody else's result; ``error`` says why they cannot be compared.

    ``direction_deg``: arms, legs ... -> mean angle between the bones of both, once the result was turned by ``turned_deg`` and
    shifted by ``shift_s``; sliding of its feet in cm/s.
    """

    name: str
    error: str
    direction_deg: dict[str, float]
    mean_direction_deg: float
    turned_deg: float
    shift_s: float
    slide_cm_s: float
    frames: int


@dataclass(frozen=True, slots=True)
class RetargetDone:
    """The motion on the target and its figures; ``error`` says why there is none.

    ``direction_deg``: bone -> mean angle between its directions on both bodies. Sliding of feet in contact in cm/s: of the
    source, of the target before its feet were planted, and after. ``hands_off_cm``: how far hands are from the places
    beside body, head and props that they were to keep, None where they were not. ``props``: three numbers in the source's world
    and three in the target's, for each.
    """

    id: str
    scene: SceneEntry | None
    error: str
    name: str
    frames: int
    rate_hz: float
    took_s: float
    scale: float
    direction_deg: dict[str, float]
    mean_direction_deg: float
    source_slide_cm_s: float
    loose_slide_cm_s: float
    slide_cm_s: float
    worst_slide_cm_s: float
    sink_cm: float
    contact_frames: int
    hands_off_cm: float | None
    props: list[list[float]]
    beside: RetargetBeside | None
    feet: list[RetargetFoot]
    exports: list[str]
    notes: list[str]
